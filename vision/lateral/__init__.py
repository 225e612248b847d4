"""The lateral offset in one picture: corridor corners found among the lines, and the offset they give.

Imports `vision.lines` and `vision.axis`. Begin reading at `vision.lateral.offset`.
"""
