"""Whether a flight is what it claims to be: units, axes, clocks and live sensors, told from its data.

Begin reading at `fusion.logs.plausibility.flight`, which `corridor fuse` and `corridor inspect` both ask.
"""
