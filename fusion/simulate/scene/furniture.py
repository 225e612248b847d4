"""Objects on the floor along the walls: cupboards, benches, plants, radiators, lockers, people.

Every function builds in the wall's own frame: s along the wall, d out of it into the room, h above the floor.
"""

from __future__ import annotations

import numpy as np

from fusion.simulate.render.mesh import Material
from fusion.simulate.scene.builder import Builder, Frame

ASKEW_RAD = 0.02  # angle between furniture and its wall


def build_furniture(builder: Builder, frame: Frame, s: float, s1: float, room_m: float) -> float:
    """Place a cupboard, a bin or a bench against the wall from s, at most to s1; return its length."""
    rng = builder.rng
    frame = frame.turned(s, 0.03, abs(float(rng.normal(0, ASKEW_RAD))))  # furniture is never exactly aligned
    reach = min(0.55, 0.28 * room_m)
    kind = rng.random()
    if kind < 0.45:  # cabinet or cupboard
        wide = min(float(rng.uniform(0.4, 1.4)), s1 - s - 0.02)
        deep, high = float(rng.uniform(0.25, 1)) * reach, float(rng.choice([0.72, 0.9, 1.2, 1.9]))
        texture = str(rng.choice(["wood", "metal"]))
        body = Material(float(rng.uniform(0.1, 0.7)), texture, (0.9, 0.9), 0.8, (0.45, 0.4), 0.006, 0.05)
        builder.box(frame, (s, s + wide), (0.01, deep), (0, high), body, "sSDH")
        if rng.random() < 0.4:
            top = Material(float(rng.uniform(0.05, 0.8)), "vinyl", (0.5, 0.5), 2.0)
            builder.box(frame, (s + 0.1, s + 0.35), (0.05, deep - 0.03), (high, high + 0.25), top, "sSDH")
        return wide
    if kind < 0.7:  # bin or plant pot
        radius = float(rng.uniform(0.13, 0.2))
        dark = Material(float(rng.uniform(0.04, 0.5)))
        high = float(rng.uniform(0.4, 0.75))
        builder.prism(
            frame, (s + radius, radius + 0.03), (radius, radius), (0, high), dark, 10, Material(0.02)
        )
        if rng.random() < 0.4:
            leaves = Material(0.12, "carpet", (0.5, 0.5), 2.0)
            for k in range(3):
                spread = radius * (1.3 - 0.3 * k)
                level = high + 0.05 + 0.22 * k
                builder.prism(
                    frame, (s + radius, radius + 0.03), (spread, spread), (level, level + 0.25), leaves, 7
                )
        return 2 * radius
    wide, deep = min(float(rng.uniform(0.5, 1.6)), s1 - s - 0.02), reach * 0.8  # bench: seat on legs
    seat = Material(float(rng.uniform(0.1, 0.5)), "wood", (1.0, 0.5))
    builder.box(frame, (s, s + wide), (0.02, deep), (0.42, 0.47), seat)
    for leg in (s + 0.05, s + wide - 0.1):
        builder.box(frame, (leg, leg + 0.04), (0.05, deep - 0.03), (0, 0.42), Material(0.1), "sSdD")
    return wide


def build_radiator(builder: Builder, frame: Frame, s: float, s1: float, room_m: float) -> float:
    """Mount a radiator low on the wall from s; return its length."""
    wide = min(float(builder.rng.uniform(0.8, 1.6)), s1 - s - 0.02)
    ribs = Material(0.75, None, None, 1.0, (0.05, 0.0), 0.012, 0.35)
    builder.box(frame, (s, s + wide), (0.03, 0.12), (0.12, 0.68), ribs)
    return wide


def build_boxes(builder: Builder, frame: Frame, s: float, s1: float, room_m: float) -> float:
    """Pile cardboard boxes against the wall from s, none aligned; return the pile's length."""
    rng = builder.rng
    wide, deep = min(float(rng.uniform(0.35, 0.75)), s1 - s - 0.05), min(0.5, 0.22 * room_m)
    level = 0.0
    for _ in range(int(rng.integers(1, 5))):
        high = float(rng.uniform(0.2, 0.4))
        turned = frame.turned(s + wide / 2, deep / 2, float(rng.normal(0, 0.08)))
        shrunk = float(rng.uniform(0.75, 1.0))
        gap = (1 - shrunk) * wide / 2
        card = Material(float(rng.uniform(0.25, 0.45)), "vinyl", (0.5, 0.5), 0.8)
        span, front = (s + gap, s + wide - gap), 0.05 + deep * shrunk
        builder.box(turned, span, (0.05, front), (level, level + high), card, "sSdDH")
        middle = (span[0] + span[1]) / 2
        tape = card.but(albedo=card.albedo * 1.4)
        band = (middle - 0.025, middle + 0.025)
        builder.box(turned, band, (0.05, front + 0.001), (level, level + high + 0.001), tape, "DH")
        level += high
    return wide


def build_plant(builder: Builder, frame: Frame, s: float, s1: float, room_m: float) -> float:
    """Place a plant in a pot against the wall; return its length."""
    rng = builder.rng
    radius, high = float(rng.uniform(0.12, 0.2)), float(rng.uniform(0.2, 0.4))
    middle = s + radius, radius + 0.05
    pot = Material(float(rng.uniform(0.1, 0.5)))
    builder.prism(frame, middle, (radius, radius), (0, high), pot, 10, Material(0.03))
    leaf = Material(float(rng.uniform(0.05, 0.18)))
    tall = float(rng.uniform(0.4, 1.0))
    for k in range(int(rng.integers(7, 14))):
        turn, lean = 2.4 * k, float(rng.uniform(0.1, 0.8))
        ds, dd = float(np.cos(turn)), float(np.sin(turn))
        foot = frame.point(middle[0] + 0.3 * radius * ds, middle[1] + 0.3 * radius * dd, high)
        reach = min(lean * tall * 0.6, (0.6 * radius) / max(-dd, 0.1))
        blade = frame.vector(reach * ds, reach * dd, tall * float(rng.uniform(0.6, 1.0)))
        across = frame.vector(-0.05 * dd, 0.05 * ds, 0)
        facing = np.cross(blade, across)
        for side in (facing, -facing):
            builder.quad(foot - across / 2, blade, across, side, leaf)
    return 2 * radius


def build_lockers(builder: Builder, frame: Frame, s0: float, s1: float) -> None:
    """Build a row of lockers: strong upright and transverse lines."""
    rng = builder.rng
    pitch, high = float(rng.uniform(0.28, 0.42)), float(rng.choice([1.2, 1.8, 2.0]))
    rows = float(rng.choice([0.0, high / 2, high / 3]))
    steel = Material(float(rng.uniform(0.15, 0.6)), "metal", (1.0, 1.0), 0.6, (pitch, rows), 0.012, 0.03)
    builder.box(
        frame, (s0, s0 + max(1, int((s1 - s0) / pitch)) * pitch), (0.01, 0.35), (0.06, high), steel, "sSDhH"
    )


def build_person(builder: Builder, frame: Frame, s: float, d: float) -> None:
    """Build a standing figure of rounded blocks."""
    rng = builder.rng
    tall, stance = float(rng.uniform(0.9, 1.08)), float(rng.uniform(0.07, 0.13))
    frame = frame.turned(s, d, float(rng.uniform(-1.2, 1.2)))
    trousers = Material(float(rng.uniform(0.03, 0.25)))
    shirt = Material(float(rng.uniform(0.05, 0.7)), "vinyl", (0.4, 0.4), 2.0)
    skin, hair = Material(float(rng.uniform(0.15, 0.45))), Material(float(rng.uniform(0.02, 0.2)))

    def block(
        ds: float, dd: float, radius: tuple[float, float], low: float, high: float, stuff: Material
    ) -> None:
        builder.prism(frame, (s + ds, d + dd), radius, (low * tall, high * tall), stuff, 9)

    for side in (-1, 1):
        step = side * 0.5 * stance
        block(step, side * stance, (0.065, 0.06), 0.0, 0.45, trousers)
        block(step * 0.8, side * stance, (0.085, 0.08), 0.45, 0.86, trousers)
        block(-step, side * 0.22, (0.05, 0.045), 1.12, 1.40, shirt)
        block(-step * 1.5, side * 0.24, (0.042, 0.038), 0.82, 1.12, shirt)
    for low, high, wide in ((0.82, 0.95, 0.165), (0.95, 1.15, 0.15), (1.15, 1.38, 0.18), (1.38, 1.45, 0.13)):
        block(0.0, 0.0, (0.12, wide), low, high, shirt)
    block(0.0, 0.0, (0.05, 0.05), 1.45, 1.52, skin)
    for low, high, wide in ((1.51, 1.56, 0.065), (1.56, 1.66, 0.082)):
        block(0.01, 0.0, (wide * 1.15, wide), low, high, skin)
    for low, high, wide in ((1.66, 1.72, 0.082), (1.72, 1.755, 0.06)):
        block(0.0, 0.0, (wide * 1.15, wide), low, high, hair)
