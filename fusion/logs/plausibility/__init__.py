"""Plausibility checks of a flight's units, axes, clocks and sensors by its data.

Begin reading at `fusion.logs.plausibility.flight`, which both `corridor fuse` and `corridor inspect` use.
"""
