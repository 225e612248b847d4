"""Objects along a corridor: painted lines, stripes, rails, ducts, pipes, trays, gutters, and rounded corners."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fusion.simulate.render.mesh import Material
from fusion.simulate.scene.builder import Builder, Frame
from fusion.simulate.scene.config import StripConfig, Surface

PIECE_M = 6.0  # long surfaces slow down ray casting
PAINT_M = 0.0008  # height of paint above its surface
PIPE_SIDES = 10
COVING_FACETS = 6


def strip_material(strip: StripConfig) -> Material:
    """Return the material of a strip."""
    material = Material(strip.albedo, strip.texture, (0.9, 0.7), 1.0, gloss=strip.gloss)
    if strip.slot_spacing_m > 0:
        return material.but(
            joint_spacing_m=(strip.slot_spacing_m, 0.0),
            joint_width_m=0.5 * strip.slot_spacing_m,
            joint_albedo=0.25 * strip.albedo,
        )
    return material


def build_strip(
    builder: Builder,
    frame: Frame,
    s: tuple[float, float],
    strip: StripConfig,
    height_m: float,
    layer: int = 0,
) -> None:
    """Build a strip from s[0] to s[1] in a wall's frame, or in a room's (d right of its centre line).

    ``height_m`` is that of the ceiling; ``layer`` separates overlapping painted strips.
    """
    if strip.dash_m > 0.0:
        pieces = [
            (x, min(x + strip.dash_m, s[1])) for x in np.arange(s[0], s[1], 2.0 * strip.dash_m).tolist()
        ]
    else:
        count = max(1, int(np.ceil((s[1] - s[0]) / PIECE_M)))
        pieces = list(pairwise(np.linspace(s[0], s[1], count + 1).tolist()))
    for piece in pieces:
        if strip.round:
            _build_pipe(builder, frame, piece, strip, height_m)
        elif strip.depth_m > 0:
            _build_box(builder, frame, piece, strip, height_m)
        else:
            _build_paint(builder, frame, piece, strip, height_m, layer)


def _build_paint(
    builder: Builder, frame: Frame, s: tuple[float, float], strip: StripConfig, height_m: float, layer: int
) -> None:
    low, lift = strip.at_m - strip.width_m / 2, max(strip.gap_m, PAINT_M * (1 + layer))
    along = frame.vector(s[1] - s[0], 0, 0)
    if strip.on in (Surface.FLOOR, Surface.CEILING):
        level, up = (lift, 1.0) if strip.on is Surface.FLOOR else (height_m - lift, -1.0)
        corner, across, facing = (
            frame.point(s[0], low, level),
            frame.vector(0, strip.width_m, 0),
            frame.vector(0, 0, up),
        )
    else:
        corner, across, facing = frame.point(s[0], lift, low), frame.vector(0, 0, strip.width_m), frame.out
    builder.quad(corner, along, across, facing, strip_material(strip))


def _build_box(
    builder: Builder, frame: Frame, s: tuple[float, float], strip: StripConfig, height_m: float
) -> None:
    across = strip.at_m - strip.width_m / 2, strip.at_m + strip.width_m / 2
    near, far = strip.gap_m, strip.gap_m + strip.depth_m
    hidden = "" if strip.gap_m > 0 else {Surface.FLOOR: "h", Surface.CEILING: "H"}.get(strip.on, "d")
    if strip.on is Surface.FLOOR:
        d, h = across, (near, far)
    elif strip.on is Surface.CEILING:
        d, h = across, (height_m - far, height_m - near)
    else:
        d, h = (near, far), across
    builder.box(frame, s, d, h, strip_material(strip), "".join(face for face in "sSdDhH" if face != hidden))


def _build_pipe(
    builder: Builder, frame: Frame, s: tuple[float, float], strip: StripConfig, height_m: float
) -> None:
    material, radius = strip_material(strip), strip.width_m / 2
    out = strip.gap_m + radius
    if strip.on is Surface.FLOOR:
        d, h = strip.at_m, out
    elif strip.on is Surface.CEILING:
        d, h = strip.at_m, height_m - out
    else:
        d, h = out, strip.at_m
    angles = (2 * np.pi * np.arange(PIPE_SIDES + 1) / PIPE_SIDES).tolist()
    along = frame.vector(s[1] - s[0], 0, 0)
    for a, b in pairwise(angles):
        first = frame.point(s[0], d + radius * np.cos(a), h + radius * np.sin(a))
        second = frame.point(s[0], d + radius * np.cos(b), h + radius * np.sin(b))
        outward = frame.vector(0, np.cos((a + b) / 2), np.sin((a + b) / 2))
        builder.quad(first, along, second - first, outward, material)


def build_coving(
    builder: Builder,
    frame: Frame,
    s: tuple[float, float],
    radius_m: float,
    material: Material,
    top_m: float = 0.0,
) -> None:
    """Round the corner between a wall and the floor, or the ceiling at ``top_m``, by facets of a quarter cylinder."""
    angles = np.linspace(0.0, np.pi / 2, COVING_FACETS + 1)
    d, rise = radius_m * (1 - np.cos(angles)), radius_m * (1 - np.sin(angles))
    h = top_m - rise if top_m > 0 else rise
    inward = -1.0 if top_m > 0 else 1.0
    along = frame.vector(s[1] - s[0], 0, 0)
    for k in range(COVING_FACETS):
        first, second = frame.point(s[0], d[k], h[k]), frame.point(s[0], d[k + 1], h[k + 1])
        middle = (angles[k] + angles[k + 1]) / 2
        facing = frame.vector(0, np.cos(middle), inward * np.sin(middle))
        builder.quad(first, along, second - first, facing, material)
