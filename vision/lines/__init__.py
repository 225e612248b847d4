"""Straight line segments in one picture.

Imports `vision.cameras`, and images and types. Begin reading at `vision.lines.segments`: `extract_lines` turns a
picture into a `LineSet`. The pixel loops it calls are in `vision.lines.edges`, the fit of lines in
`vision.lines.fitting`.
"""
