"""The result of fusion: tables, summary and conventions, as values and as files.

May import `fusion.estimator` (its configuration and the tables' columns) and the packages below it. Begin reading at
`fusion.result.result`, then `fusion.result.summary`.
"""
