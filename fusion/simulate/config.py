"""What a simulation is made of: every number with its unit in the name, unknown keys refused."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


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


class JunctionConfig(_Model):
    """A second corridor that leaves the first.

    Parameters
    ----------
    at_m
        Place along the first corridor where the centre lines meet.
    angle_rad
        Direction of the second corridor from the first one's, positive right; 30 to 150 degrees either way.
    width_m, length_m
        Size of the second corridor.
    crossing
        It goes on beyond the first corridor on the other side too.
    """

    at_m: Positive
    angle_rad: float = -np.pi / 2
    width_m: Positive = 2.0
    length_m: Positive = 15.0
    crossing: bool = False


class SceneConfig(_Model):
    """A corridor and what stands in it; shares are 0 to 1.

    ``door_spacing_m`` and the like are mean distances on one wall (0: none).
    """

    length_m: Positive = 30.0
    width_m: Positive = 2.2
    height_m: Positive = 2.6
    junctions: tuple[JunctionConfig, ...] = ()
    open_hall_m: tuple[float, float] | None = None
    open_hall_side: int = 1
    end: End = End.WALL
    wall: WallFinish = WallFinish.PLASTER
    wall_albedo: Share = 0.7
    floor: Floor = Floor.TILES
    floor_albedo: Share = 0.35
    floor_gloss: Share = 0.06
    floor_roughness_rad: NotNegative = 0.015
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
    people: Annotated[int, Field(ge=0, le=50)] = 0
    lockers_share: Share = 0.0
    radiator_spacing_m: NotNegative = 0.0
    pipes: Annotated[int, Field(ge=0, le=8)] = 0
    cable_tray: bool = False
    handrail: bool = False
    lamp_spacing_m: Positive = 2.4
    lamp_size_m: tuple[Positive, Positive] = (0.6, 1.2)
    lamp_off_share: Share = 0.05
    lamp_radiance: Positive = 8.0
    daylight: NotNegative = 6.0
    ambient: NotNegative = 0.01

    @classmethod
    def random(cls, seed: int, **fixed: object) -> SceneConfig:
        """Draw a corridor as buildings have them; keyword arguments stay as given."""
        rng = np.random.default_rng((seed, 1))
        pick = rng.choice
        floor = Floor(str(pick(list(Floor), p=[0.3, 0.15, 0.1, 0.3, 0.15])))
        glossy = floor in (Floor.TILES, Floor.VINYL, Floor.TERRAZZO)
        width = float(rng.uniform(1.5, 3.2))
        drawn: dict[str, object] = {
            "length_m": float(rng.uniform(16, 40)),
            "width_m": width,
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
            "lamp_size_m": ((0.6, 1.2), (0.6, 0.6), (1.2, 0.3), (0.15, 1.4), (1.4, 0.12))[
                int(rng.integers(5))
            ],
            "lamp_off_share": float(pick([0.0, rng.uniform(0.0, 0.5)])),
            "daylight": float(rng.uniform(1.0, 12.0)),
            "ambient": float(rng.uniform(0.005, 0.05)),
        }
        return cls.model_validate(drawn | fixed)


class ImagingConfig(_Model):
    """The camera's picture chain.

    Parameters
    ----------
    brightness
        Share of full scale, in linear light, at which the scene's mean is exposed: 0.2 is well exposed, 0.02 dark.
    noise, full_well_electrons, read_noise_electrons
        Sensor noise: shot noise of the electrons that full scale stands for, and read noise.
    defocus_px
        Standard deviation of the lens blur.
    vignetting
        0 none, 1 the full fourth power of the cosine.
    bloom
        Share of light that the lens spreads widely.
    jpeg_quality
        1 to 100; None writes PNG.
    """

    brightness: Positive = 0.2
    noise: bool = True
    full_well_electrons: Positive = 8000.0
    read_noise_electrons: NotNegative = 6.0
    defocus_px: NotNegative = 0.45
    vignetting: Share = 0.6
    bloom: Share = 0.04
    gamma: Positive = 2.2
    contrast: Positive = 1.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = 85

    @classmethod
    def random(cls, seed: int, **fixed: object) -> ImagingConfig:
        """Draw a camera between good and poor; keyword arguments stay as given."""
        rng = np.random.default_rng((seed, 3))
        drawn: dict[str, object] = {
            "brightness": float(np.exp(rng.uniform(np.log(0.08), np.log(0.35)))),
            "full_well_electrons": float(np.exp(rng.uniform(np.log(2000), np.log(20000)))),
            "read_noise_electrons": float(rng.uniform(2, 15)),
            "defocus_px": float(rng.uniform(0.3, 0.8)),
            "vignetting": float(rng.uniform(0.0, 1.0)),
            "bloom": float(rng.uniform(0.0, 0.10)),
            "jpeg_quality": int(rng.integers(70, 96)),
        }
        return cls.model_validate(drawn | fixed)
