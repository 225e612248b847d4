"""Configuration of a simulated corridor: every number with its unit in the name, unknown keys rejected."""

from __future__ import annotations

from enum import StrEnum
from math import pi, radians
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fusion.settings.model import Settings
from fusion.settings.toml import build

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


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
    PLANKS = "planks"


class WallFinish(StrEnum):
    """Material of the walls."""

    PLASTER = "plaster"
    TWO_TONE = "two_tone"
    BRICK = "brick"
    PANELS = "panels"
    BLOCKS = "blocks"
    TILES = "tiles"


class Ceiling(StrEnum):
    """Material of the ceiling."""

    PLASTER = "plaster"
    BOARDS = "boards"
    OPEN = "open"


class Side(StrEnum):
    """One wall of a corridor or the other."""

    LEFT = "left"
    RIGHT = "right"


class Sides(StrEnum):
    """One wall of a corridor, the other or both."""

    LEFT = "left"
    RIGHT = "right"
    BOTH = "both"


class Surface(StrEnum):
    """Surface along which a strip runs."""

    FLOOR = "floor"
    CEILING = "ceiling"
    LEFT = "left"
    RIGHT = "right"


class JunctionConfig(Settings):
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
    crossing: bool = Field(
        default=False,
        description="Whether it also continues on the other side of that corridor, for the same length.",
    )

    @model_validator(mode="after")
    def _check_angle(self) -> Self:
        if not radians(30) - 1e-9 <= abs(self.angle_rad) <= radians(150) + 1e-9:
            raise ValueError(
                f"angle_rad = {self.angle_rad:g} must be 0.5236 to 2.618 (30 to 150 degrees) either way"
            )
        return self


class StripConfig(Settings):
    """Something that runs along the first corridor.

    A painted line or a stripe of carpet (depth 0); a rail, ledge or cable duct (a depth, with a gap where it stands
    off); a pipe (round); a cable tray or a gutter's grate (slots).
    """

    on: Surface
    at_m: float = Field(
        description="Place of its middle: right of the centre line on floor and ceiling, above the floor on a wall."
    )
    width_m: float = Field(gt=0, le=10, description="Width across its direction; the diameter of a pipe.")
    depth_m: float = Field(
        default=0.0, ge=0, le=1, description="How far it stands out; 0: painted or laid in."
    )
    gap_m: float = Field(default=0.0, ge=0, le=2, description="Between it and what it runs along.")
    round: bool = Field(default=False, description="A pipe; its depth does not count.")
    albedo: Share = 0.5
    texture: Literal["plaster", "wood", "metal", "carpet", "vinyl"] | None = None
    gloss: Share = 0.0
    slot_spacing_m: NotNegative = Field(default=0.0, description="Between the slots across it; 0: none.")
    dash_m: NotNegative = Field(
        default=0.0, description="Length of the dashes that it consists of, and of the gaps; 0: one piece."
    )
    from_m: NotNegative = Field(default=0.0, description="Where it begins along the corridor.")
    to_m: Positive | None = Field(
        default=None, description="Where it ends; the corridor's end where not given."
    )


class WallConfig(Settings):
    """What one wall looks like."""

    finish: WallFinish = WallFinish.PLASTER
    albedo: Share = 0.7
    lower_height_m: NotNegative = Field(
        default=0.0, description="Height up to which lower_finish and lower_albedo apply; 0: nowhere."
    )
    lower_finish: WallFinish = WallFinish.PLASTER
    lower_albedo: Share = 0.4
    brick_m: tuple[Positive, Positive] = Field(
        default=(0.24, 0.075), description="Length and height of a brick, block or wall tile, with its joint."
    )
    brick_contrast: float = Field(
        default=1.0, ge=-4, le=4, description="Of bricks and their mortar; negative: the mortar is light."
    )
    gloss: Share = Field(default=0.0, description="Mirror reflection of wall tiles seen square on.")
    skirting_height_m: NotNegative = 0.09
    skirting_depth_m: Positive = 0.013
    skirting_albedo: Share = 0.12


class WidthStepConfig(Settings):
    """The first corridor goes on narrower or wider from a place on."""

    at_m: Positive = Field(description="Place along the first corridor.")
    width_m: float = Field(gt=0.8, le=20, description="Width of the corridor beyond at_m.")
    moves: Sides = Field(
        default=Sides.BOTH,
        description="The wall that steps in or out. Where it is one, the centre line moves.",
    )


class WindowsConfig(Settings):
    """A row of windows along one wall of the first corridor, and the sun through them."""

    side: Side = Side.LEFT
    sill_m: NotNegative = Field(default=0.9, description="Above the floor.")
    head_m: Positive = Field(default=2.2, description="Above the floor.")
    pane_m: float = Field(default=1.0, gt=0.1, le=10)
    pier_m: float = Field(default=0.12, ge=0.02, le=10, description="Wall or frame between two panes.")
    from_m: NotNegative = 1.0
    to_m: Positive | None = Field(default=None, description="The corridor's end where not given.")
    sun: NotNegative = Field(
        default=0.0, description="Radiance of a white surface square to the sun; 0: overcast."
    )
    sun_azimuth_rad: float = Field(
        default=0.4, ge=-1.3, le=1.3, description="From square to the wall, positive along the corridor."
    )
    sun_elevation_rad: float = Field(default=0.7, ge=0.1, le=1.4)


class SceneConfig(Settings):
    """A corridor and what stands in it. Shares are 0 to 1; a spacing is a mean distance on one wall, 0 for none."""

    length_m: float = Field(default=40.0, gt=4, le=1000, description="Of the first corridor.")
    width_m: float = Field(default=2.2, gt=0.8, le=20)
    height_m: float = Field(default=2.6, gt=1.5, le=20)
    junctions: tuple[JunctionConfig, ...] = ()
    open_hall_m: tuple[float, float] | None = Field(
        default=None, description="From where to where a wall of the first corridor is missing."
    )
    open_hall_right: bool = Field(default=True, description="The right wall is missing there, else the left.")
    partition_height_m: NotNegative = Field(
        default=0.0, description="A low wall along the open hall; 0: none."
    )
    width_step: WidthStepConfig | None = None
    slope_rad: float = Field(
        default=0.0,
        ge=-0.2,
        le=0.2,
        description="The first corridor climbs (or falls) ahead; upright stays upright.",
    )
    end: End = End.WALL
    wall: WallFinish = WallFinish.PLASTER
    wall_albedo: Share = 0.7
    left_wall: WallConfig | None = Field(
        default=None,
        description="Left wall of the corridors; by default as set by wall, wall_albedo and skirting_*.",
    )
    right_wall: WallConfig | None = None
    floor: Floor = Floor.TILES
    floor_albedo: Share = 0.35
    floor_gloss: Share = Field(default=0.06, description="Mirror reflection of the floor seen from above.")
    floor_roughness_rad: NotNegative = Field(default=0.015, description="Blurs the floor's reflections.")
    floor_tile_m: Positive | None = Field(
        default=None, description="Side of a tile, or width of a plank; by the kind where not given."
    )
    floor_joint_m: Positive | None = Field(
        default=None, description="Width of a joint; by the kind where not given. Half a plank: stripes."
    )
    floor_turn_rad: float = Field(
        default=0.0, description="Tiles or planks are laid at this angle to the corridor, positive right."
    )
    floor_tile_start_m: tuple[NotNegative, NotNegative] = Field(
        default=(0.0, 0.0), description="How much of the first tile is cut off, along and across."
    )
    floor_joint_ratio: NotNegative = Field(
        default=0.45, description="Reflectance of joints over that of tiles."
    )
    floor_coving_m: NotNegative = Field(
        default=0.0,
        description="Radius of the rounded corner of floor and wall; 0: a sharp corner with a skirting.",
    )
    floor_upstand_m: NotNegative = Field(
        default=0.0, description="The floor's covering goes up the wall so far; 0: the coving is the wall's."
    )
    ceiling_coving_m: NotNegative = Field(
        default=0.0, description="Radius of the corner of wall and ceiling."
    )
    ceiling: Ceiling = Ceiling.PLASTER
    ceiling_albedo: Share = 0.75
    skirting_height_m: NotNegative = 0.09
    skirting_albedo: Share = 0.12
    door_spacing_m: NotNegative = 4.0
    door_recess_m: NotNegative = 0.12
    door_frame_albedo: Share = 0.3
    open_door_share: Share = 0.12
    ajar_share: Share = Field(default=0.0, description="Share of the open doors that are ajar.")
    alcove_share: Share = Field(default=0.0, description="Share of the doorways that are alcoves.")
    windows: WindowsConfig | None = Field(
        default=None, description="They take the place of that wall's doors."
    )
    pilaster_spacing_m: NotNegative = Field(
        default=0.0, description="Distance between pillars that stand out of both walls; 0: none."
    )
    pilaster_m: tuple[Positive, Positive] = Field(
        default=(0.3, 0.12), description="Size of a pillar along and out of the wall."
    )
    pilaster_albedo: Share = 0.6
    beam_spacing_m: NotNegative = Field(
        default=0.0, description="Distance between beams across the ceiling; 0: none."
    )
    beam_m: tuple[Positive, Positive] = Field(default=(0.2, 0.2), description="Width and depth of a beam.")
    beam_albedo: Share = 0.4
    strips: tuple[StripConfig, ...] = ()
    poster_spacing_m: NotNegative = 4.0
    sign_spacing_m: NotNegative = 3.0
    furniture_spacing_m: NotNegative = 7.0
    radiator_spacing_m: NotNegative = 0.0
    lockers_share: Share = Field(
        default=0.0, description="Share of the wall between doors that lockers cover."
    )
    boxes_spacing_m: NotNegative = 0.0
    plants_spacing_m: NotNegative = 0.0
    people: int = Field(default=0, ge=0, le=50, description="Standing in the first corridor.")
    clutter_side: Sides = Field(
        default=Sides.BOTH, description="Where furniture, boxes, plants and people stand."
    )
    pipes: int = Field(default=0, ge=0, le=8)
    cable_tray: bool = False
    handrail: bool = False
    parallel_std_rad: NotNegative = Field(
        default=0.002, description="How far walls, joints, pipes and rails deviate from parallel."
    )
    lamp_spacing_m: Positive = 2.4
    lamp_size_m: tuple[Positive, Positive] = Field(default=(1.2, 0.6), description="Across and along.")
    lamp_offset_m: float = Field(default=0.0, description="The row of lamps hangs right of the middle.")
    lamp_round: bool = False
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
        if self.width_step is not None and not 1 <= self.width_step.at_m <= self.length_m - 1:
            raise ValueError(
                f"width_step at_m = {self.width_step.at_m:g} must lie 1 m within length_m = {self.length_m:g}"
            )
        if self.slope_rad != 0 and (self.junctions or self.open_hall_m is not None):
            raise ValueError("slope_rad needs a corridor without junctions and open hall")
        if (
            self.open_hall_m is not None
            and not 0 <= self.open_hall_m[0] < self.open_hall_m[1] <= self.length_m
        ):
            raise ValueError(
                f"open_hall_m = {self.open_hall_m} must rise and lie within length_m = {self.length_m:g}"
            )
        return self

    def wall_of(self, side: str) -> WallConfig:
        """Return the look of the wall on a side of a corridor: ``left``, ``right``, else an end."""
        own = {"left": self.left_wall, "right": self.right_wall}.get(side)
        if own is not None:
            return own
        two_tone = self.wall is WallFinish.TWO_TONE
        return WallConfig(
            finish=WallFinish.PLASTER if two_tone else self.wall,
            albedo=self.wall_albedo,
            lower_height_m=1.1 if two_tone else 0.0,
            lower_albedo=0.55 * self.wall_albedo,
            skirting_height_m=self.skirting_height_m,
            skirting_albedo=self.skirting_albedo,
        )

    @classmethod
    def random(cls, seed: int, **fixed: object) -> SceneConfig:
        """Draw a corridor of any kind of building; keyword arguments stay as given."""
        from fusion.simulate.scene.random_scene import draw_building

        return build(cls, draw_building(seed, fixed) | fixed)

    @classmethod
    def random_office(cls, seed: int, **fixed: object) -> SceneConfig:
        """Draw a plain, well-lit office corridor; keyword arguments stay as given."""
        from fusion.simulate.scene.random_scene import draw_office

        return build(cls, draw_office(seed) | fixed)
