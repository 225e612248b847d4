"""The published article's own measurement, kept as printed: ``method="paper"``.

Imports only images, errors, types and the measurement that it fills. Begin reading at `vision.paper.measure`; the
article's steps from a picture to straight lines are in `vision.paper.lines`.
"""
