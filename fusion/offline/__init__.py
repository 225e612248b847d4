"""Fuse a whole logged flight: `fuse_flight`, and its summary.

Runs the estimator over a `fusion.flight.Flight`. May import `fusion.evaluation` and the packages below it. Begin
reading at `fusion.offline.fuse`.
"""
