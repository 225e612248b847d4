"""What a simulated corridor looks like: every number with its unit in the name, unknown keys refused."""

from __future__ import annotations

from enum import StrEnum
from math import pi, radians
from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class Section(BaseModel):
    """Base of every part of a configuration: frozen, unknown names refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class End(StrEnum):
    """What closes a corridor's far end."""

    WALL = "wall"
    WINDOW = "window"
    STAIRS = "stairs"
    DOORS = "doors"


class Floor(StrEnum):
    """Floor covering."""

    TILES = "tiles"
    CARPET = "carpet"
    CARPET_TILES = "carpet_tiles"
    VINYL = "vinyl"
    TERRAZZO = "terrazzo"


class WallFinish(StrEnum):
    """What the walls are made of."""

    PLASTER = "plaster"
    TWO_TONE = "two_tone"
    BRICK = "brick"
    PANELS = "panels"


class Ceiling(StrEnum):
    """What the ceiling is made of."""

    PLASTER = "plaster"
    BOARDS = "boards"
    OPEN = "open"


class JunctionConfig(Section):
    """A corridor that leaves another one."""

    from_corridor: int = Field(
        default=1, ge=1, description="Number of the corridor it leaves; the first is 1."
    )
    at_m: Positive = Field(
        description="Where the centre lines meet, from where that corridor begins or leaves another."
    )
    angle_rad: float = Field(
        default=-pi / 2, description="Its direction from that corridor's, positive right."
    )
    width_m: float = Field(default=2.0, gt=0.5, le=20)
    length_m: float = Field(default=15.0, gt=1, le=500)
    crossing: bool = Field(default=False, description="It goes on beyond the other corridor too, as far.")

    @model_validator(mode="after")
    def _check_angle(self) -> Self:
        if not radians(30) - 1e-9 <= abs(self.angle_rad) <= radians(150) + 1e-9:
            raise ValueError(
                f"angle_rad = {self.angle_rad:g} must be 0.5236 to 2.618 (30 to 150 degrees) either way"
            )
        return self


class SceneConfig(Section):
    """A corridor and what stands in it. Shares are 0 to 1; a spacing is a mean distance on one wall, 0 for none."""

    length_m: float = Field(default=40.0, gt=4, le=1000, description="Of the first corridor.")
    width_m: float = Field(default=2.2, gt=0.8, le=20)
    height_m: float = Field(default=2.6, gt=1.5, le=20)
    junctions: tuple[JunctionConfig, ...] = ()
    open_hall_m: tuple[float, float] | None = Field(
        default=None, description="From where to where a wall of the first corridor is missing."
    )
    open_hall_right: bool = Field(default=True, description="The right wall is missing there, else the left.")
    end: End = End.WALL
    wall: WallFinish = WallFinish.PLASTER
    wall_albedo: Share = 0.7
    floor: Floor = Floor.TILES
    floor_albedo: Share = 0.35
    floor_gloss: Share = Field(default=0.06, description="Mirror reflection of the floor seen from above.")
    floor_roughness_rad: NotNegative = Field(default=0.015, description="Blurs the floor's reflections.")
    ceiling: Ceiling = Ceiling.PLASTER
    ceiling_albedo: Share = 0.75
    skirting_height_m: NotNegative = 0.09
    skirting_albedo: Share = 0.12
    door_spacing_m: NotNegative = 4.0
    door_recess_m: NotNegative = 0.12
    door_frame_albedo: Share = 0.3
    open_door_share: Share = 0.12
    poster_spacing_m: NotNegative = 4.0
    sign_spacing_m: NotNegative = 3.0
    furniture_spacing_m: NotNegative = 7.0
    radiator_spacing_m: NotNegative = 0.0
    lockers_share: Share = Field(default=0.0, description="Of the wall between doors.")
    people: int = Field(default=0, ge=0, le=50, description="Standing in the first corridor.")
    pipes: int = Field(default=0, ge=0, le=8)
    cable_tray: bool = False
    handrail: bool = False
    parallel_std_rad: NotNegative = Field(
        default=0.002, description="How far walls, joints, pipes and rails deviate from parallel."
    )
    lamp_spacing_m: Positive = 2.4
    lamp_size_m: tuple[Positive, Positive] = Field(default=(1.2, 0.6), description="Across and along.")
    lamp_off_share: Share = 0.05
    lamp_radiance: Positive = 8.0
    daylight: NotNegative = Field(default=6.0, description="Radiance of windows.")
    ambient: NotNegative = Field(default=0.01, description="Light that is everywhere.")

    @model_validator(mode="after")
    def _check_plan(self) -> Self:
        lengths = [self.length_m]
        for number, junction in enumerate(self.junctions, start=2):
            if junction.from_corridor >= number:
                raise ValueError(
                    f"corridor {number} cannot leave corridor {junction.from_corridor}, which comes later"
                )
            limit = lengths[junction.from_corridor - 1]
            if junction.at_m > limit:
                raise ValueError(
                    f"junction at_m = {junction.at_m:g} lies beyond the end of corridor "
                    f"{junction.from_corridor}, {limit:g} m"
                )
            lengths.append(junction.length_m)
        if (
            self.open_hall_m is not None
            and not 0 <= self.open_hall_m[0] < self.open_hall_m[1] <= self.length_m
        ):
            raise ValueError(
                f"open_hall_m = {self.open_hall_m} must rise and lie within length_m = {self.length_m:g}"
            )
        return self

    @classmethod
    def random(cls, seed: int, **fixed: object) -> SceneConfig:
        """Draw a corridor as buildings have them; keyword arguments stay as given."""
        rng = np.random.default_rng((seed, 1))
        pick = rng.choice
        floor = Floor(str(pick(list(Floor), p=[0.3, 0.15, 0.1, 0.3, 0.15])))
        glossy = floor in (Floor.TILES, Floor.VINYL, Floor.TERRAZZO)
        lamps = ((1.2, 0.6), (0.6, 0.6), (0.3, 1.2), (1.4, 0.15), (0.12, 1.4))
        drawn: dict[str, object] = {
            "length_m": float(rng.uniform(16, 40)),
            "width_m": float(rng.uniform(1.5, 3.2)),
            "height_m": float(rng.uniform(2.3, 3.2)),
            "end": End(str(pick(list(End), p=[0.4, 0.3, 0.1, 0.2]))),
            "wall": WallFinish(str(pick(list(WallFinish), p=[0.6, 0.2, 0.1, 0.1]))),
            "wall_albedo": float(rng.uniform(0.45, 0.85)),
            "floor": floor,
            "floor_albedo": float(rng.uniform(0.12, 0.55)),
            "floor_gloss": float(rng.uniform(0.01, 0.10)) if glossy else 0.0,
            "floor_roughness_rad": float(rng.uniform(0.004, 0.05)),
            "ceiling": Ceiling(str(pick(list(Ceiling), p=[0.4, 0.5, 0.1]))),
            "ceiling_albedo": float(rng.uniform(0.55, 0.9)),
            "skirting_height_m": float(pick([0.0, rng.uniform(0.05, 0.16)], p=[0.15, 0.85])),
            "skirting_albedo": float(pick([rng.uniform(0.03, 0.2), rng.uniform(0.3, 0.8)], p=[0.7, 0.3])),
            "door_spacing_m": float(rng.uniform(2.2, 7.0)),
            "door_recess_m": float(pick([0.03, rng.uniform(0.05, 0.3)])),
            "door_frame_albedo": float(rng.uniform(0.08, 0.8)),
            "open_door_share": float(rng.uniform(0.0, 0.25)),
            "poster_spacing_m": float(rng.uniform(2.0, 9.0)),
            "sign_spacing_m": float(rng.uniform(2.0, 6.0)),
            "furniture_spacing_m": float(pick([0.0, rng.uniform(3.0, 12.0)], p=[0.2, 0.8])),
            "people": int(pick([0, 1, 2, 3], p=[0.6, 0.2, 0.1, 0.1])),
            "lockers_share": float(pick([0.0, rng.uniform(0.2, 0.8)], p=[0.85, 0.15])),
            "radiator_spacing_m": float(pick([0.0, rng.uniform(4.0, 9.0)], p=[0.7, 0.3])),
            "pipes": int(pick([0, 1, 2, 4], p=[0.7, 0.1, 0.1, 0.1])),
            "cable_tray": bool(rng.random() < 0.15),
            "handrail": bool(rng.random() < 0.12),
            "lamp_spacing_m": float(rng.uniform(1.8, 4.5)),
            "lamp_size_m": lamps[int(rng.integers(len(lamps)))],
            "lamp_off_share": float(pick([0.0, rng.uniform(0.0, 0.5)])),
            "daylight": float(rng.uniform(1.0, 12.0)),
            "ambient": float(rng.uniform(0.005, 0.05)),
        }
        return cls.model_validate(drawn | fixed)
