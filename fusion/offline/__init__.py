"""Fuse a whole logged flight: `fuse_flight`, and its summary.

Runs the estimator over a `fusion.flight.Flight`. Begin reading at `fusion.offline.fuse`.
"""
