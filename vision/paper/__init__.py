"""The published article's own method, implemented as printed: ``method="paper"``.

Imports only images, errors, types and measurements. Begin reading at `vision.paper.measure`; the article's steps from
a picture to straight lines are in `vision.paper.lines`.
"""
