"""Straight line segments in one picture.

Imports `vision.cameras`, and images and types. Begin reading at `vision.lines.segments`: `extract_lines` turns a
picture into a `LineSet`. `vision.lines.preparation` chooses size and blur, `vision.lines.edges` contains the pixel
loops, `vision.lines.fitting` fits and joins lines. `vision.lines.rolling_shutter` corrects lines for the readout, and
`vision.lines.straightness` measures how much a lens bends straight lines.
"""
