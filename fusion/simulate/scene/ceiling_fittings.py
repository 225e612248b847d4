"""Objects at the ceiling: lamps, beams, pipes, cable trays, smoke detectors, exit signs."""

from __future__ import annotations

import numpy as np

from fusion.simulate.render.mesh import Material
from fusion.simulate.scene.builder import Builder, Frame
from fusion.simulate.scene.config import Ceiling, SceneConfig
from fusion.simulate.scene.plan import Room, room_frame

LAMP_SKEW_RAD = 0.004
LAMP_SHIFT_M = 0.01
TUBE_M = 0.2  # narrower lamps hang below the ceiling
PANEL_DROP_M, TUBE_DROP_M = 0.012, 0.09


def build_lamps(builder: Builder, rooms: list[Room], config: SceneConfig) -> None:
    """Hang a row of lamps in every corridor and several in a hall, some of them off."""
    for number, room in enumerate(rooms):
        frame, half = room_frame(room), room.width_m / 2
        beside = float(np.clip(config.lamp_offset_m, 0.35 - half, half - 0.35))
        columns = [beside] if room.width_m < 4 else np.arange(1.5 - half, half - 1, 2.6).tolist()
        for s in np.arange(0.5 * config.lamp_spacing_m, room.length_m - 0.3, config.lamp_spacing_m).tolist():
            for y in columns:
                if not any(bool(other.contains(room.to_world(s, y), 0.3).any()) for other in rooms[:number]):
                    _build_lamp(builder, frame, s, y, config)


def _build_lamp(builder: Builder, frame: Frame, s: float, y: float, config: SceneConfig) -> None:
    rng = builder.rng
    across, along = config.lamp_size_m
    tube = min(across, along) < TUBE_M
    s, y = s + float(rng.normal(0, LAMP_SHIFT_M)), y + float(rng.normal(0, LAMP_SHIFT_M))
    frame = frame.turned(s, y, float(rng.normal(0, LAMP_SKEW_RAD)))
    off = rng.random() < config.lamp_off_share
    emission = 0.0 if off else config.lamp_radiance * float(rng.uniform(0.85, 1.1))
    level = config.height_m - (TUBE_DROP_M if tube or config.lamp_round else PANEL_DROP_M)
    light = Material(0.5 if off else 1.0, emission=emission)
    if config.lamp_round:
        radius = across / 2
        globe = Material(0.9 if off else 1.0, emission=0.6 * emission)
        builder.prism(frame, (s, y), (radius, radius), (level, config.height_m), globe, 10)
        corner = frame.point(s - radius, y - radius, level - 0.001)
        edges = frame.vector(across, 0, 0), frame.vector(0, across, 0)
        builder.quad(corner, *edges, frame.vector(0, 0, -1), light, True)
        return
    rim = 0.0 if tube else 0.03
    spans = ((s - along / 2 - rim, s + along / 2 + rim), (y - across / 2 - rim, y + across / 2 + rim))
    faces = "sSdD" if tube else "sSdDh"
    builder.box(frame, *spans, (level, config.height_m), Material(0.6), faces)
    corner = frame.point(s - along / 2, y - across / 2, level - 0.001)
    edges = frame.vector(along, 0, 0), frame.vector(0, across, 0)
    builder.quad(corner, *edges, frame.vector(0, 0, -1), light)


def build_beams(builder: Builder, room: Room, config: SceneConfig) -> None:
    """Lay beams across a corridor's ceiling, between the lamps."""
    spacing, (wide, deep) = config.beam_spacing_m, config.beam_m
    if spacing == 0:
        return
    frame, half, pitch = room_frame(room), room.width_m / 2, config.lamp_spacing_m
    concrete = Material(config.beam_albedo, "plaster", (1.1, 1.1))
    clear = config.lamp_size_m[1] / 2 + 0.05 + wide / 2
    for place in np.arange(0.7 * spacing, room.length_m - wide, spacing).tolist():
        lamp = (np.floor(place / pitch) + 0.5) * pitch
        middle = place if abs(place - lamp) > clear else lamp + clear
        spans = (
            (middle - wide / 2, middle + wide / 2),
            (-half, half),
            (config.height_m - deep, config.height_m),
        )
        builder.box(frame, *spans, concrete, "sSh")


def build_ceiling_clutter(builder: Builder, room: Room, config: SceneConfig) -> None:
    """Hang pipes and a cable tray along a corridor, smoke detectors, and an exit sign across it."""
    build_beams(builder, room, config)
    rng, frame = builder.rng, room_frame(room)
    top, half = config.height_m, room.width_m / 2
    crowded = config.ceiling is Ceiling.OPEN
    for _ in range(config.pipes + (3 if crowded else 0)):
        y, size = float(rng.uniform(-half + 0.1, half - 0.15)), float(rng.uniform(0.03, 0.12))
        level = top - float(rng.uniform(0.08, 0.3))
        pipe = Material(float(rng.uniform(0.2, 0.8)), "metal", (1.0, 0.3))
        askew = frame.turned(room.length_m / 2, y, float(rng.normal(0, config.parallel_std_rad)))
        builder.box(askew, (0, room.length_m), (y, y + size), (level - size, level), pipe, "dDhH")
    if config.cable_tray or crowded:
        side = float(rng.choice([-1, 1])) * (half - 0.25)
        tray = Material(0.35, "metal", (0.3, 0.3), 2.0, (0.25, 0.0), 0.03, 0.05)
        askew = frame.turned(room.length_m / 2, side, float(rng.normal(0, config.parallel_std_rad)))
        spans = (0, room.length_m), (side - 0.15, side + 0.15), (top - 0.25, top - 0.2)
        builder.box(askew, *spans, tray, "dDhH")
    for s in np.arange(2.0, room.length_m - 1, float(rng.uniform(4, 9))).tolist():
        builder.prism(frame, (s, 0.35 * half), (0.06, 0.06), (top - 0.05, top), Material(0.8), 8)
        corner = frame.point(s - 0.06, 0.35 * half - 0.06, top - 0.05)
        builder.quad(
            corner,
            frame.vector(0.12, 0, 0),
            frame.vector(0, 0.12, 0),
            frame.vector(0, 0, -1),
            Material(0.8),
            True,
        )
    if rng.random() < 0.5:
        s = float(rng.uniform(5, max(6, room.length_m - 2)))
        builder.box(
            frame, (s, s + 0.05), (-0.2, 0.2), (top - 0.35, top - 0.15), Material(1.0, emission=1.2), "sSdDhH"
        )
