"""The measurement from one camera frame, and its prior information: attitude and a filter's prediction.

Frames and signs, used throughout the project:

- body: FRD, x forward, y right, z down.
- level: the body frame with roll and pitch removed: z points down along gravity, x along the vehicle's heading in
  the horizontal plane.
- heading: angle from the corridor's axis to the vehicle's x axis, positive when the vehicle is turned right
  (clockwise from above); the vanishing point then lies left of the principal point.
- lateral offset: positive right of the corridor's centre line; scale-free form ``y / (width / 2)``.
- pixels: (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from math import asin, atan2, nan, radians
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vision.errors import InputError
from vision.rotations import down_of_quaternion, rotation_from_angles
from vision.types import FloatArray

if TYPE_CHECKING:
    from vision.lateral.mixture import OffsetMixture


class Reason(StrEnum):
    """Why a frame was used (``ok``) or rejected; values of the ``reason`` column."""

    OK = "ok"
    TOO_FEW_LINES = "too_few_lines"  # too few lines meet in the vanishing point; at least four are needed
    AMBIGUOUS = "ambiguous"  # two directions explain the lines almost equally well
    UNCERTAIN = "uncertain"  # sigma of the heading is too large
    BLUR = "blur"  # turning too fast for the exposure
    GATE = "gate"  # disagrees with the filter
    UNREADABLE = "unreadable"  # the picture could not be decoded
    LATE = "late"  # older than the estimator's buffer
    REPEATED = "repeated"  # same picture as the previous frame: the camera is frozen
    AHEAD = "ahead"  # stamped far ahead of the other sensors' clock


REASON_MEANING: dict[Reason, str] = {
    Reason.OK: "used",
    Reason.TOO_FEW_LINES: "too few lines meet",
    Reason.AMBIGUOUS: "two directions fit equally well",
    Reason.UNCERTAIN: "heading too uncertain to use",
    Reason.BLUR: "turning too fast for the exposure",
    Reason.GATE: "disagrees with the filter",
    Reason.UNREADABLE: "picture could not be decoded",
    Reason.LATE: "arrived too late",
    Reason.REPEATED: "same picture as the previous frame",
    Reason.AHEAD: "stamped ahead of the other sensors",
}
"""Text shown to the user for each reason."""


class Position(StrEnum):
    """Side of the corridor's centre line that the vehicle is on; centre is within 0.1 half widths of the line."""

    LEFT = "left"
    CENTRE = "centre"
    RIGHT = "right"


class LineClass(IntEnum):
    """Class of a line segment; values of `FrameMeasurement.line_class`."""

    REJECTED = 0  # none of the others
    CORRIDOR = 1  # along the corridor: meets the vanishing point
    TRANSVERSE = 2  # horizontal, across the corridor
    VERTICAL = 3


@dataclass(frozen=True, slots=True)
class Attitude:
    """Roll and pitch of the body (FRD) against gravity, with their common standard deviation.

    Parameters
    ----------
    roll_rad, pitch_rad
        Aerospace Z-Y-X Euler angles: roll positive right side down, pitch positive nose up.
    std_rad
        Standard deviation of each, one sigma.
    """

    roll_rad: float
    pitch_rad: float
    std_rad: float = radians(0.5)

    @classmethod
    def from_quaternion(cls, q_world_body: npt.ArrayLike, std_rad: float = radians(0.5)) -> Attitude:
        """Take roll and pitch from a quaternion (w, x, y, z), body FRD to a world whose z points down.

        Raises
        ------
        InputError
            Where these are not four numbers, are not finite, or are far from unit length.
        """
        try:
            w, x, y, z = (float(v) for v in np.asarray(q_world_body, dtype=float).reshape(4))
        except (TypeError, ValueError):
            raise InputError(
                f"attitude quaternion {q_world_body!r} is not four numbers",
                remedy="give a unit quaternion w, x, y, z",
            ) from None
        norm = (w * w + x * x + y * y + z * z) ** 0.5
        if not 0.9 < norm < 1.1:  # NaN fails too
            raise InputError(
                f"attitude quaternion ({w:g}, {x:g}, {y:g}, {z:g}) has length {norm:g}",
                remedy="give a unit quaternion w, x, y, z",
            )
        down = down_of_quaternion((w / norm, x / norm, y / norm, z / norm))
        return cls(
            roll_rad=atan2(down[1], down[2]), pitch_rad=asin(max(-1.0, min(1.0, -down[0]))), std_rad=std_rad
        )

    def R_level_body(self) -> FloatArray:
        """Rotation (3, 3) that takes body vectors to the level frame."""
        return rotation_from_angles(0.0, self.pitch_rad, self.roll_rad)


@dataclass(frozen=True, slots=True)
class Prior:
    """A filter's prediction at the time of a frame; it selects between hypotheses and is never averaged in.

    Parameters
    ----------
    heading_rad, heading_std_rad
        Predicted heading, radians, positive turned right, and its standard deviation. With 30 degrees or more it is
        ignored.
    lateral_offset_norm, lateral_offset_norm_std
        Predicted lateral offset, half widths, positive right of the centre line; NaN where unknown.
    width_per_height
        Corridor width over the camera's height above the floor, unit 1, from earlier frames; NaN where unknown.
    elevation_rad, elevation_std_rad
        Elevation of the corridor's axis in the level frame from earlier frames, positive up. It is the negative of
        the camera's mounting pitch error; zero where the mount is exact.
    body_rate_rad_s
        Magnitude of the body's angular rate during the exposure, rad/s; NaN where unknown.
    body_rates_rad_s
        Angular rate (3,) of the body, FRD, rad/s, while a rolling shutter reads the picture; None where unknown.
    """

    heading_rad: float = nan
    heading_std_rad: float = nan
    lateral_offset_norm: float = nan
    lateral_offset_norm_std: float = nan
    width_per_height: float = nan
    elevation_rad: float = 0.0
    elevation_std_rad: float = radians(3.0)
    body_rate_rad_s: float = nan
    body_rates_rad_s: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameMeasurement:
    """Measurement from one frame. Numbers that could not be measured are NaN.

    Parameters
    ----------
    accepted, reason
        Whether the heading may be used, and if not, why.
    n_lines, n_inliers
        Line segments found, and those that meet in the vanishing point.
    vp_px, vp_cov_px2
        Vanishing point (2,) in the original, distorted image and its covariance (2, 2). It may lie outside the
        picture; NaN where it is outside the lens model's range.
    heading_rad, heading_std_rad
        Heading relative to the corridor's axis, in (-pi/2, pi/2): both directions of a corridor look alike.
    heading_lasting_std_rad
        Part of ``heading_std_rad`` that successive frames have in common for seconds, because they see the same
        lines: the mean of many frames keeps it. 0 if their errors are independent, also of measurements made
        elsewhere.
    heading_split_std_rad
        Part of both that is due to lines which agree on a second direction a few degrees away: walls that are not
        parallel, or a corridor that bends.
    elevation_rad, elevation_std_rad
        Elevation of the corridor's axis in the level frame, positive up. A value other than zero indicates
        an error of the tilt or of the camera mounting.
    second_heading_rad, second_score
        The second-best hypothesis and its score relative to the best one (0: no rival, 1: a tie).
        If the reason is `ambiguous`, pass ``Prior(heading_rad=..., heading_std_rad=...)`` near the direction that you
        know to be right: it is then reported first, and accepted if it explains the lines about as well as the other.
        In front of a wall the second hypothesis is at right angles to the first.
    lateral_offset_norm, lateral_offset_norm_std
        Offset from the centre line over half the corridor's width.
    width_per_height
        Corridor width over camera height above the floor.
    corridor_aspect, corridor_aspect_std
        Height of the corridor over its width, and its standard deviation, by all four corners. Unlike the corners
        themselves it does not depend on the camera's position.
    position
        Left, centre or right; None where the offset is unknown.
    paper_yaw_rad
        The article's equation (8) at this vanishing point: unsigned, see `vision.paper.measure`.
    vision_ms
        Processing time of this frame, milliseconds: line extraction and measurement, without decoding the picture.
    lines_px, line_class
        The segments (n, 4) as x0, y0, x1, y1 in the original image, and their `LineClass` (n,); None where
        they were dropped to save memory.
    wall_lines_px
        Lines (k, 4) from which the lateral offset follows, in pairs at one height on both walls: corners with floor
        or ceiling, skirting boards, tops of doors; None like `lines_px`.
    offset_evidence
        Likelihood of the lateral offset (half widths) by each kind of evidence, for a filter to accumulate: a tuple
        of `vision.lateral.mixture.OffsetMixture`, Gaussian sums with arrays (k,). It does not depend on a predicted
        offset. Where the heading is not accepted, it is about the predicted axis.
    wall_profiles
        Brightness along both walls over the mean brightness, unit 1, float32 (2, n_along, n_bands), see
        `vision.lateral.parallax.wall_profiles`: a filter compares it with the profiles of an earlier frame. None
        where the heading is not accepted.
    roll_correction_rad, roll_correction_std_rad
        Correction of the attitude's roll by the picture's vertical lines alone; NaN if no vertical line is visible.
    """

    accepted: bool
    reason: Reason
    n_lines: int = 0
    n_inliers: int = 0
    vp_px: tuple[float, float] = (nan, nan)
    vp_cov_px2: tuple[tuple[float, float], tuple[float, float]] = ((nan, nan), (nan, nan))
    heading_rad: float = nan
    heading_std_rad: float = nan
    heading_lasting_std_rad: float = 0.0
    heading_split_std_rad: float = 0.0
    elevation_rad: float = nan
    elevation_std_rad: float = nan
    second_heading_rad: float = nan
    second_score: float = nan
    lateral_offset_norm: float = nan
    lateral_offset_norm_std: float = nan
    width_per_height: float = nan
    corridor_aspect: float = nan
    corridor_aspect_std: float = nan
    position: Position | None = None
    paper_yaw_rad: float = nan
    vision_ms: float = nan
    lines_px: npt.NDArray[np.float32] | None = field(default=None, repr=False)
    line_class: npt.NDArray[np.int8] | None = field(default=None, repr=False)
    wall_lines_px: npt.NDArray[np.float32] | None = field(default=None, repr=False)
    offset_evidence: tuple[OffsetMixture, ...] = field(default=(), repr=False)
    wall_profiles: npt.NDArray[np.float32] | None = field(default=None, repr=False)
    roll_correction_rad: float = nan
    roll_correction_std_rad: float = nan

    def without_lines(self) -> FrameMeasurement:
        """Return a copy without arrays, so that a long flight fits in memory."""
        return replace(
            self,
            lines_px=None,
            line_class=None,
            wall_lines_px=None,
            offset_evidence=(),
            wall_profiles=None,
        )


def position_from_offset(lateral_offset_norm: float, dead_band_norm: float = 0.1) -> Position | None:
    """Return the side of the centre line: centre within ``dead_band_norm``, None for NaN."""
    if lateral_offset_norm != lateral_offset_norm:
        return None
    if abs(lateral_offset_norm) <= dead_band_norm:
        return Position.CENTRE
    return Position.RIGHT if lateral_offset_norm > 0 else Position.LEFT
