"""Plausibility of a flight: checks units, axes, clocks and live sensors by its data.

Begin reading at `fusion.logs.plausibility.flight`, which `corridor fuse` and `corridor inspect` both ask.
"""
