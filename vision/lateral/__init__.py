"""Lateral offset from one picture: corner lines of the corridor, a small network, and wall parallax.

Imports `vision.lines` and `vision.axis`. Begin reading at `vision.lateral.offset`.
"""
