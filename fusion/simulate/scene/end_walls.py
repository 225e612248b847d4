"""Ends of corridors: a window, doors, stairs, or a bare wall with a poster."""

from __future__ import annotations

import numpy as np

from fusion.simulate.render.mesh import Material
from fusion.simulate.scene.builder import Builder, Frame
from fusion.simulate.scene.config import End, SceneConfig
from fusion.simulate.scene.plan import Wall
from fusion.simulate.scene.textures import POSTERS, WINDOWS
from fusion.simulate.scene.wall_fittings import hang_sheet


def build_end(builder: Builder, frame: Frame, wall: Wall, config: SceneConfig) -> None:
    """Fill the wall across the end of a room: window, doors, stairs or a poster."""
    rng, wide = builder.rng, wall.length_m
    if wide < 1.0:
        return
    kind = config.end if wall.side == "far" else End.DOORS
    if kind is End.WINDOW:
        _build_window(builder, frame, wide, config)
    elif kind is End.DOORS:
        leaf = Material(float(rng.uniform(0.15, 0.6)), "wood", (0.8, 2.2))
        half = min(0.85, 0.4 * wide)
        top = min(2.05, config.height_m - 0.15)
        rim = Material(config.door_frame_albedo)
        middle = wide / 2
        builder.box(
            frame, (middle - half - 0.06, middle + half + 0.06), (0, 0.03), (0, top + 0.06), rim, "sSDH"
        )
        for a, b in ((middle - half, middle - 0.005), (middle + 0.005, middle + half)):
            builder.quad(
                frame.point(a, 0.032, 0), frame.vector(b - a, 0, 0), frame.vector(0, 0, top), frame.out, leaf
            )
            glass = Material(1.0, emission=float(rng.choice([0.02, 0.3, 1.0])))
            pane = frame.point(a + 0.12, 0.034, 1.1)
            builder.quad(pane, frame.vector(b - a - 0.24, 0, 0), frame.vector(0, 0, 0.7), frame.out, glass)
    elif kind is End.STAIRS:
        _build_stairs(builder, frame, wide, config)
    elif rng.random() < 0.6:
        size = (min(0.9, 0.5 * wide), 0.9)
        hang_sheet(builder, frame, wide / 2 - size[0] / 2, 1.1, size, str(rng.choice(POSTERS)))


def _build_window(builder: Builder, frame: Frame, wide: float, config: SceneConfig) -> None:
    rng = builder.rng
    low, high = float(rng.choice([0.05, 0.9])), config.height_m - 0.25
    a, b = 0.12 * wide, 0.88 * wide
    light = Material(1.0, str(rng.choice(WINDOWS)), None, 1.0, emission=config.daylight)
    builder.quad(
        frame.point(a, 0.002, low),
        frame.vector(b - a, 0, 0),
        frame.vector(0, 0, high - low),
        frame.out,
        light,
    )
    bar = Material(0.6)
    count = int(rng.integers(2, 5))
    for s in np.linspace(a, b, count).tolist():
        builder.box(frame, (s - 0.03, s + 0.03), (0, 0.05), (low, high), bar, "sSD")
    for h in (low, float(rng.uniform(0.4, 0.7)) * (high - low) + low, high):
        builder.box(frame, (a, b), (0, 0.05), (h - 0.03, h + 0.03), bar, "DhH")


def _build_stairs(builder: Builder, frame: Frame, wide: float, config: SceneConfig) -> None:
    """Build steps up towards the end wall, with a landing, handrails and doors."""
    steps = int(builder.rng.integers(4, 7))
    rise, going, landing = 0.165, 0.3, 1.2
    tread = Material(float(builder.rng.uniform(0.06, 0.4)), "speckle", (0.8, 0.8))
    riser = tread.but(albedo=tread.albedo * 0.6)
    for k in range(steps):
        near, top = landing + going * (steps - k), rise * (k + 1)
        builder.box(frame, (0, wide), (near - going, near), (top - rise, top), riser, "D")
        deep = going if k < steps - 1 else going + landing
        builder.quad(
            frame.point(0, near - deep, top),
            frame.vector(wide, 0, 0),
            frame.vector(0, deep, 0),
            frame.vector(0, 0, 1),
            tread,
        )
        builder.box(frame, (0, wide), (near - 0.03, near), (top, top + 0.002), Material(0.6), "H")
    top = rise * steps
    slope = frame.vector(0, -going * steps, top)
    for s in (0.08, wide - 0.12):
        corner = frame.point(s, landing + going * (steps + 0.5), 0.9)
        builder.quad(corner, slope, frame.vector(0.05, 0, 0), frame.vector(0, 0, 1), Material(0.1))
        builder.quad(
            corner, slope, frame.vector(0, 0, -0.05), frame.along * (1 if s < 1 else -1), Material(0.08)
        )
    door = Material(float(builder.rng.uniform(0.15, 0.6)), "metal", (1.0, 1.0))
    high = min(2.0, config.height_m - top - 0.1)
    corner = frame.point(wide / 2 - 0.7, 0.01, top)
    builder.quad(corner, frame.vector(1.4, 0, 0), frame.vector(0, 0, high), frame.out, door)
