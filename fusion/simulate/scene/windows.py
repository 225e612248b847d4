"""A row of windows along a wall, and the sun that shines through it."""

from __future__ import annotations

from math import cos, sin, tan

import numpy as np

from fusion.simulate.render.mesh import SUN_COUNT, Material
from fusion.simulate.scene.builder import Builder, Frame
from fusion.simulate.scene.config import SceneConfig, Side, WindowsConfig
from fusion.simulate.scene.plan import FloatArray, Room
from fusion.simulate.scene.textures import WINDOWS

OUTSIDE_M = 7.0  # width of the outside view in one copy of its picture
FRAME_M = 0.05


def _panes(windows: WindowsConfig, config: SceneConfig) -> tuple[float, int]:
    """Start of the first pane along the corridor, and the number of panes; none beyond a step in the width."""
    last = (config.length_m if config.width_step is None else config.width_step.at_m) - 0.5
    last = last if windows.to_m is None else min(windows.to_m, last)
    pitch = windows.pane_m + windows.pier_m
    return windows.from_m, max(0, int((last - windows.from_m + windows.pier_m) / pitch))


def build_windows(
    builder: Builder, frame: Frame, windows: WindowsConfig, config: SceneConfig, span_m: tuple[float, float]
) -> None:
    """Build the panes within ``span_m`` (along the corridor) in a wall that begins there."""
    first, count = _panes(windows, config)
    pitch, low, high = (
        windows.pane_m + windows.pier_m,
        windows.sill_m,
        min(windows.head_m, config.height_m - 0.1),
    )
    name = str(builder.rng.choice(WINDOWS))
    rim, board = Material(0.55), Material(0.7)
    for k in range(count):
        s = first + k * pitch - span_m[0]
        if s < 0.02 or s + windows.pane_m > span_m[1] - span_m[0] - 0.02:
            continue
        light = Material(
            1.0,
            name,
            (OUTSIDE_M, high - low),
            1.0,
            emission=config.daylight,
            origin_m=(first + k * pitch, 0.0),
        )
        pane = frame.vector(windows.pane_m, 0, 0), frame.vector(0, 0, high - low)
        builder.quad(frame.point(s, 0.003, low), *pane, frame.out, light)
        for edge in (s - FRAME_M, s + windows.pane_m):
            builder.box(
                frame, (edge, edge + FRAME_M), (0, FRAME_M), (low - FRAME_M, high + FRAME_M), rim, "sSD"
            )
        for level in (low - FRAME_M, high):
            ends = (s, s + windows.pane_m)
            builder.box(frame, ends, (0, FRAME_M), (level, level + FRAME_M), rim, "DhH")
        ends = (s - windows.pier_m / 2, s + windows.pane_m + windows.pier_m / 2)
        builder.box(frame, ends, (0, 0.14), (low - FRAME_M - 0.03, low - FRAME_M), board, "sSDhH")


def sun_of(config: SceneConfig, room: Room) -> FloatArray:
    """Return `Mesh.sun` of the first corridor."""
    sun = np.zeros(SUN_COUNT)
    windows = config.windows
    if windows is None or windows.sun == 0:
        return sun
    side = -1.0 if windows.side is Side.LEFT else 1.0
    azimuth, elevation = windows.sun_azimuth_rad, windows.sun_elevation_rad
    first, count = _panes(windows, config)
    pitch = windows.pane_m + windows.pier_m
    level = cos(elevation)
    sun[:] = [
        level * sin(azimuth), side * level * cos(azimuth), -sin(elevation), windows.sun,
        side * room.width_m / 2, first, first + count * pitch, pitch, windows.pane_m,
        windows.sill_m, min(windows.head_m, config.height_m - 0.1), tan(config.slope_rad),
    ]  # fmt: skip
    return sun
