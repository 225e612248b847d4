"""Roll and pitch for single pictures, from a CSV file in one of two forms.

- ``timestamp_ns,qw,qx,qy,qz``, as ``attitude0/data.csv`` of an ASL flight: body to world, FLU with z up (FRD
  with z down if declared in ``body.yaml`` in the parent folder). A picture whose name is a time in
  nanoseconds takes the nearest row, at most 0.1 s away.
- ``image,roll_rad,pitch_rad``, with these names in the first line: a row per picture, by file name; roll
  positive right side down, pitch positive nose up.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import isfinite, pi
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.logs.csv.stamped_table import read_table
from vision import Attitude, InputError
from vision.cameras.calibration import read_body_frame
from vision.limits import check_is_file

MAX_GAP_NS = 100_000_000
LENGTH_TOLERANCE = 0.05

_BY_NAME = ("image", "roll_rad", "pitch_rad")
_BY_TIME = ("qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeFile:
    """Attitudes by picture name or by time, depending on the file.

    Parameters
    ----------
    by_name
        Attitude by the picture's file name, without folders.
    t_ns, q_world_body
        Times (n,), strictly increasing, and unit quaternions (n, 4), w x y z, body FRD to world z down.
    problems
        Rows dropped on reading, one sentence each.
    """

    by_name: Mapping[str, Attitude] = field(default_factory=dict)
    t_ns: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    q_world_body: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))
    problems: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path) -> AttitudeFile:
        """Read a file of either form.

        Raises
        ------
        InputError
            If it is missing, has another form, or has no usable row.
        """
        try:
            check_is_file(path)
            with path.open(encoding="utf-8-sig", newline="") as file:
                names = tuple(name.strip() for name in next(csv.reader(file), []))
                if names[:1] == ("image",):
                    return cls(by_name=_read_by_name(path, names, csv.reader(file)))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise InputError(f"cannot be read: {reason}", file=path, remedy="check --attitude") from error
        return _read_by_time(path)

    def of(self, picture: Path, t_ns: int | None) -> Attitude | None:
        """Attitude at a picture, None if the file has none for it."""
        named = self.by_name.get(picture.name)
        if named is not None or t_ns is None or len(self.t_ns) == 0:
            return named
        after = min(int(np.searchsorted(self.t_ns, t_ns)), len(self.t_ns) - 1)
        nearest = min((max(after - 1, 0), after), key=lambda row: abs(int(self.t_ns[row]) - t_ns))
        if abs(int(self.t_ns[nearest]) - t_ns) > MAX_GAP_NS:
            return None
        return Attitude.from_quaternion(self.q_world_body[nearest])


def _read_by_name(path: Path, names: tuple[str, ...], rows: Iterable[list[str]]) -> dict[str, Attitude]:
    if names != _BY_NAME:
        raise InputError(f"columns are {','.join(names)}", file=path, remedy=f"expected {','.join(_BY_NAME)}")
    found: dict[str, Attitude] = {}
    for line, row in enumerate(rows, 2):
        if not row:
            continue
        try:
            name, roll_rad, pitch_rad = row[0].strip(), float(row[1]), float(row[2])
        except (IndexError, ValueError):
            raise InputError(
                f"line {line} is {','.join(row)[:60]!r}", file=path, remedy=f"expected {','.join(_BY_NAME)}"
            ) from None
        if not (isfinite(roll_rad) and abs(roll_rad) <= pi and abs(pitch_rad) <= pi / 2):
            raise InputError(
                f"line {line}: roll_rad {roll_rad:g}, pitch_rad {pitch_rad:g} is not an attitude",
                file=path,
                remedy="give radians: roll within pi, pitch within pi/2",
            )
        found[Path(name).name] = Attitude(roll_rad, pitch_rad)
    if not found:
        raise InputError("has a header but no rows", file=path, remedy="add a row per picture")
    return found


def _read_by_time(path: Path) -> AttitudeFile:
    table, problems = read_table(path, _BY_TIME, label=path.name, roles=("quaternion",))
    length = np.linalg.norm(table.values, axis=1)
    good = np.abs(length - 1.0) <= LENGTH_TOLERANCE  # NaN is rejected, too
    if not good.any():
        raise InputError(
            f"every quaternion is far from unit length (the first has {length[0]:g})",
            file=path,
            remedy=f"the columns are timestamp_ns,{','.join(_BY_TIME)}",
        )
    if not good.all():
        count, first = int((~good).sum()), int(table.t_ns[~good][0])
        problems += (f"{path.name}: {count} rows without a unit quaternion dropped (first at {first})",)
    q = table.values[good] / length[good, None]
    if read_body_frame(path.absolute().parent.parent / "body.yaml") == "flu":
        q = q * np.array([1.0, 1.0, -1.0, -1.0])  # half a turn about x on both sides: y and z change sign
    return AttitudeFile(t_ns=table.t_ns[good], q_world_body=q, problems=problems)
