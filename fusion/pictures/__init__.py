"""Measure pictures without a flight: what `corridor measure` does.

May import `fusion.logs`, `fusion.estimator.tables` and what lies below them. Begin reading at
`fusion.pictures.measure`.
"""
