"""Random strips along walls, floor and ceiling: rails, painted lines, pipes, cable trays, cabinets, kerbs."""

from __future__ import annotations

from typing import Any

from fusion.simulate.scene.config import Surface
from fusion.simulate.scene.draw import Draw


def draw_strips(draw: Draw, width_m: float, height_m: float) -> tuple[dict[str, Any], ...]:
    """Draw strips along the walls, the floor and the ceiling."""
    return (
        *_wall_strips(draw),
        *_floor_strips(draw, width_m),
        *_service_runs(draw, width_m, height_m),
    )


def _wall_strips(draw: Draw) -> list[dict[str, Any]]:
    """Draw painted lines and dado rails, handrails, ledges and cable ducts, sometimes at unequal heights."""
    strips: list[dict[str, Any]] = []
    if draw.chance(0.3):
        level, wide = draw.between(0.6, 1.6), draw.between(0.03, 0.25)
        deep, albedo = draw.one_of(0.0, draw.between(0.008, 0.04)), draw.albedo()
        for side in draw.sides():
            at = level + draw.one_of(0.0, draw.between(-0.3, 0.3), p=(0.6, 0.4))
            strips.append({"on": side, "at_m": at, "width_m": wide, "depth_m": deep, "albedo": albedo})
    if draw.chance(0.2):
        rail = {
            "width_m": draw.between(0.03, 0.14), "depth_m": draw.between(0.02, 0.05), "albedo": draw.albedo(),
            "gap_m": draw.between(0.03, 0.06), "texture": draw.one_of("wood", "metal", None),
            "round": draw.chance(0.4),
        }  # fmt: skip
        levels = draw.one_of((0.92,), (0.92, 0.65), (0.95, 0.35), p=(0.6, 0.2, 0.2))
        strips += [{"on": side, "at_m": level, **rail} for side in draw.sides() for level in levels]
    if draw.chance(0.18):
        ledge = {
            "at_m": draw.one_of(draw.between(0.15, 1.3), draw.between(2.1, 2.2)), "width_m": draw.between(0.04, 0.2),
            "depth_m": draw.between(0.04, 0.15), "albedo": draw.albedo(),
        }  # fmt: skip
        strips += [{"on": side, **ledge} for side in draw.sides()]
    return strips


def _floor_strips(draw: Draw, width_m: float) -> list[dict[str, Any]]:
    """Draw painted lines, stripes of carpet and gutters, sometimes on one side only."""
    strips: list[dict[str, Any]] = []
    half = width_m / 2
    hand = draw.one_of((-1, 1), (-1,), (1,), p=(0.45, 0.275, 0.275))
    if draw.chance(0.25):
        inset, wide, albedo = draw.between(0.08, 0.45 * half + 0.1), draw.between(0.04, 0.14), draw.albedo()
        strips += [
            {"on": Surface.FLOOR, "at_m": side * (half - inset), "width_m": wide, "albedo": albedo}
            for side in hand
        ]
        if draw.chance(0.3):
            at = draw.between(-0.3, 0.3) * half
            strips.append({"on": Surface.FLOOR, "at_m": at, "width_m": wide, "albedo": albedo})
    if draw.chance(0.2):
        wide = draw.between(0.08, 0.35 * half)
        inset = draw.one_of(wide / 2, wide / 2 + draw.between(0.05, 0.3 * half))
        stripe = {"width_m": wide, "albedo": draw.albedo(), "texture": draw.one_of("carpet", "vinyl")}
        strips += [{"on": Surface.FLOOR, "at_m": side * (half - inset), **stripe} for side in hand]
    if draw.chance(0.12):
        wide = draw.between(0.08, 0.25)
        at = draw.one_of(-1, 1) * (half - wide / 2 - draw.between(0.0, 0.4))
        grate = {
            "slot_spacing_m": draw.between(0.025, 0.06),
            "texture": "metal",
            "albedo": draw.between(0.1, 0.4),
        }
        strips.append({"on": Surface.FLOOR, "at_m": at, "width_m": wide, **grate})
    return strips


def _service_runs(draw: Draw, width_m: float, height_m: float) -> list[dict[str, Any]]:
    """Draw pipes, cable trays and ducts under the ceiling and on the walls."""
    strips: list[dict[str, Any]] = []
    half, side = width_m / 2, draw.one_of(-1, 1)
    if draw.chance(0.35):
        at = half - draw.between(0.08, 0.2)
        for _ in range(draw.count(1, 5)):
            size = draw.scale(0.02, 0.18)
            at -= size / 2
            pipe = {
                "albedo": draw.albedo(),
                "texture": draw.one_of("metal", None),
                "gap_m": draw.between(0.03, 0.3),
            }
            strips.append({"on": Surface.CEILING, "at_m": side * at, "width_m": size, "round": True, **pipe})
            at -= size / 2 + draw.between(0.02, 0.2)
            if at < -0.8 * half:
                break
    if draw.chance(0.15):
        size = draw.scale(0.02, 0.12)
        wall = draw.one_of(Surface.LEFT, Surface.RIGHT)
        levels = [draw.one_of(draw.between(0.1, 0.5), height_m - draw.between(0.08, 0.4))]
        if draw.chance(0.5):
            levels.append(levels[0] - size - 0.05)
        pipe = {"on": wall, "width_m": size, "gap_m": 0.03, "round": True, "albedo": draw.albedo()}
        strips += [{"at_m": level, **pipe} for level in levels]
    if draw.chance(0.2):
        wide = min(draw.between(0.12, 0.5), 0.4 * width_m)
        tray = {
            "gap_m": draw.between(0.1, 0.4),
            "slot_spacing_m": draw.between(0.05, 0.3),
            "texture": "metal",
        }
        at = draw.one_of(-1, 1) * (half - wide / 2 - draw.between(0.02, 0.3))
        strips.append(
            {"on": Surface.CEILING, "at_m": at, "width_m": wide, "depth_m": 0.06, "albedo": 0.4, **tray}
        )
    if draw.chance(0.15):  # a boxed-in duct along the wall
        wide, deep = min(draw.between(0.15, 0.6), 0.35 * width_m), draw.between(0.1, 0.35)
        at = -side * (half - wide / 2)
        strips.append(
            {
                "on": Surface.CEILING,
                "at_m": at,
                "width_m": wide,
                "depth_m": deep,
                "albedo": draw.between(0.3, 0.85),
            }
        )
    return strips


def draw_wall_linings(seed: int, width_m: float) -> list[dict[str, Any]]:
    """Sometimes line the walls: low cabinets, a raised kerb, pipes near the floor, or a border below a bulkhead.

    Their edges run along the corridor beside the corners of walls, floor and ceiling. Separate random numbers
    leave the rest of a corridor as it is without them.
    """
    draw = Draw(seed, stream=13)
    kind = draw.one_of(None, "cabinets", "kerb", "pipes", "border", p=(0.7, 0.08, 0.06, 0.08, 0.08))
    sides = draw.one_of((-1, 1), (-1,), (1,), p=(0.2, 0.4, 0.4))
    wide = draw.between(0.06, 0.24) * width_m
    strips: list[dict[str, Any]] = []
    for side in sides if kind else ():
        wall = Surface.LEFT if side < 0 else Surface.RIGHT
        beside_wall = {"at_m": side * (width_m - wide) / 2, "width_m": wide}
        if kind == "cabinets":
            high = draw.between(0.4, 1.2)
            cabinet = {"at_m": high / 2, "width_m": high, "depth_m": min(wide, 0.6)}
            texture = draw.one_of("wood", "metal", None)
            strips.append({"on": wall, **cabinet, "albedo": draw.albedo(), "texture": texture})
        elif kind == "kerb":
            high, albedo = draw.between(0.08, 0.35), draw.between(0.15, 0.6)
            strips.append({"on": Surface.FLOOR, **beside_wall, "depth_m": high, "albedo": albedo})
        elif kind == "pipes":
            level = draw.between(0.02, 0.4)
            for _ in range(draw.count(1, 3)):
                size, gap = draw.scale(0.04, 0.22), draw.between(0.01, 0.1)
                pipe = {"at_m": level + size / 2, "width_m": size, "gap_m": gap, "round": True}
                strips.append({"on": wall, **pipe, "albedo": draw.albedo()})
                level += size + draw.between(0.02, 0.15)
        else:
            border = {"albedo": draw.albedo(), "texture": draw.one_of("carpet", "vinyl", None)}
            bulkhead = {"depth_m": draw.between(0.1, 0.6), "albedo": draw.between(0.4, 0.88)}
            strips.append({"on": Surface.FLOOR, **beside_wall, **border})
            if draw.chance(0.6):
                strips.append({"on": Surface.CEILING, **beside_wall, **bulkhead})
    return strips
