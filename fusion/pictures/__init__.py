"""Measure pictures without a flight, for `corridor measure`.

May import `fusion.logs`, `fusion.estimator.tables` and the packages below them. Begin reading at
`fusion.pictures.measure`.
"""
