"""The corridor's axis in one picture: level, vanishing point, field of view.

Imports `vision.lines` and `vision.cameras`. Begin reading at `vision.axis.vanishing_point`.
"""
