"""The tables of a fused flight: one list of columns defines their types, documentation and rows.

A table is a numpy structured array whose field names are the CSV's columns, so ``table["heading_rad"]`` and
``pandas.DataFrame(table)`` work. Unknown numbers are NaN in memory and empty in the file.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from vision.measurement import Position

if TYPE_CHECKING:
    from fusion.estimator.config import FusionConfig
    from fusion.estimator.estimate import Estimate

if TYPE_CHECKING:

    class Table(Protocol):
        """A structured array whose columns are `Any`: numpy's type for them takes mypy a second a line."""

        @property
        def dtype(self) -> np.dtype[np.void]: ...  # noqa: D102
        def __array__(self) -> npt.NDArray[np.void]: ...
        def __getitem__(self, key: Any, /) -> Any: ...
        def __setitem__(self, key: Any, value: Any, /) -> None: ...
        def __len__(self) -> int: ...
        def __iter__(self) -> Any: ...
        def copy(self) -> Table: ...  # noqa: D102
        def tobytes(self) -> bytes: ...  # noqa: D102

else:
    Table = npt.NDArray[np.void]


class Column(NamedTuple):
    """One column.

    Parameters
    ----------
    name
        Name in the table and the file.
    type
        numpy's type code.
    unit
        ``1`` for a pure number, empty for a word or a flag.
    meaning
        Description in one line; ``{side}`` is replaced by the positive side.
    frame
        Reference frame or axis; empty if not applicable.
    flips
        Whether its sign is positive to the right, and changes with the sign convention.
    """

    name: str
    type: str
    unit: str
    meaning: str
    frame: str = ""
    flips: bool = False


_AXIS = "corridor's axis to body x"
_SECTION = "corridor's cross-section"
_VERTICAL = "vertical axis"
_PICTURE = "original picture"

_TIME = Column(
    "timestamp_ns",
    "i8",
    "ns",
    "Time of the row. For frames: the recorded time stamp, before camera_delay_s is subtracted",
    "clock of the log",
)
_HEADING = (
    Column(
        "heading_rad", "f8", "rad", "Angle from the axis to the vehicle's nose, positive {side}", _AXIS, True
    ),
    Column("heading_std_rad", "f8", "rad", "Standard deviation of heading_rad", _AXIS),
)
_OFFSET_NORM = (
    Column(
        "lateral_offset_norm",
        "f8",
        "1",
        "Offset over half the corridor's width, positive {side}",
        _SECTION,
        True,
    ),
    Column("lateral_offset_norm_std", "f8", "1", "Standard deviation of lateral_offset_norm", _SECTION),
    Column(
        "position",
        "U6",
        "",
        "Side of the centre line as seen along the axis: left, centre or right",
        _SECTION,
    ),
)

ESTIMATE_COLUMNS = (
    _TIME,
    *_HEADING,
    Column(
        "lateral_offset_m",
        "f8",
        "m",
        "Distance from the centre line, positive {side}",
        _SECTION,
        True,
    ),
    Column("lateral_offset_std_m", "f8", "m", "Standard deviation of lateral_offset_m", _SECTION),
    *_OFFSET_NORM,
    Column(
        "yaw_rate_rad_s", "f8", "rad/s", "Rate of the heading, bias removed, positive {side}", _VERTICAL, True
    ),
    Column("gyro_bias_rad_s", "f8", "rad/s", "Bias of the yaw rate, positive {side}", _VERTICAL, True),
    Column(
        "imu_yaw_offset_rad",
        "f8",
        "rad",
        "IMU's yaw less the heading from the first axis",
        "first corridor's axis to yaw of the log",
        True,
    ),
    Column("corridor_index", "i4", "", "Number of the corridor being flown, from 0"),
    Column(
        "corridor_turn_rad",
        "f8",
        "rad",
        "Angle from the first corridor's axis to the present one's, positive {side}",
        "first corridor's axis to the present one's",
        True,
    ),
    Column("status", "U12", "", "initialising, tracking, coasting or lost"),
    Column("vision_age_s", "f8", "s", "Time since the last frame that was used"),
    Column(
        "lateral_status", "U8", "", "unknown, known or coasting: how far the lateral offset can be relied on"
    ),
    Column("lateral_age_s", "f8", "s", "Time since the last frame that confirmed the lateral offset"),
    Column("lateral_reason", "U12", "", "Why lateral_status is not known; empty while it is"),
)
"""Of ``estimates.csv`` and ``smoothed.csv``; each is a field of `fusion.estimator.estimate.Estimate`."""

FRAME_COLUMNS = (
    _TIME,
    Column("accepted", "?", "", "Whether the filter used the frame"),
    Column("reason", "U16", "", "Reason for rejection; ok if the frame was used"),
    Column("n_lines", "i4", "1", "Line segments found"),
    Column("n_inliers", "i4", "1", "Segments that meet in the vanishing point"),
    Column("vp_x_px", "f8", "px", "Vanishing point; (0, 0) is the centre of the top-left pixel", _PICTURE),
    Column("vp_y_px", "f8", "px", "Vanishing point, positive down", _PICTURE),
    *_HEADING,
    *_OFFSET_NORM,
    Column("paper_yaw_rad", "f8", "rad", "The article's equation (8), without sign", "picture"),
    Column(
        "innovation_rad",
        "f8",
        "rad",
        "Heading of the frame less its prediction, positive {side}",
        _AXIS,
        True,
    ),
    Column("test_ratio", "f8", "1", "Innovation squared over gate squared; above 1 the frame is rejected"),
    Column("vision_ms", "f8", "ms", "Time that measuring the frame took"),
)
"""Of ``frames.csv``."""

HYPOTHESIS_COLUMNS = (
    _TIME,
    *_OFFSET_NORM[:2],
    Column("probability", "f8", "1", "Of this hypothesis"),
)
"""The hypotheses of the lateral offset, one per row; not written to a file."""

HYPOTHESIS_DTYPE = np.dtype([(c.name, c.type) for c in HYPOTHESIS_COLUMNS])
ESTIMATE_DTYPE = np.dtype([(c.name, c.type) for c in ESTIMATE_COLUMNS])
FRAME_DTYPE = np.dtype([(c.name, c.type) for c in FRAME_COLUMNS])

_estimate_row = attrgetter(*(c.name for c in ESTIMATE_COLUMNS))


def estimate_row(estimate: Estimate) -> tuple[Any, ...]:
    """Convert an estimate to a row of `ESTIMATE_DTYPE`."""
    row: tuple[Any, ...] = _estimate_row(estimate)
    return row


def position_names(offset_norm: npt.NDArray[np.float64], config: FusionConfig) -> npt.NDArray[np.str_]:
    """Return the side of the centre line of offsets (n,), half widths; empty for NaN."""
    names = np.full(len(offset_norm), "", "U6")  # filled in place to save time
    names[offset_norm > 0.0], names[offset_norm < 0.0] = Position.RIGHT, Position.LEFT
    names[np.abs(offset_norm) <= config.position_dead_band_norm] = Position.CENTRE
    return names
