"""Steps common to all readers: sort samples by time, drop those that are not numbers, and report them.

Functions that may drop or repair something return it together with the sentences that report it, as `WithProblems`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from fusion.flight import FloatArray, TimeArray
from vision import InputError

BoolArray = npt.NDArray[np.bool_]
IndexArray = npt.NDArray[np.int64]
Problems = tuple[str, ...]
T_co = TypeVar("T_co", covariant=True)


class WithProblems(NamedTuple, Generic[T_co]):
    """A value that was read, and a sentence for each thing that was dropped or repaired."""

    value: T_co
    problems: Problems = ()


MIN_STEP_NS = 500_000  # of cameras and slow streams; faster than 2 kHz means another unit
MIN_IMU_STEP_NS = 50_000

LFS_MAGIC = b"version https://git-lfs.github.com/spec/"
NOT_NANOSECONDS = "the first column must be whole nanoseconds"


def refuse_placeholder(path: Path) -> None:
    """Reject a file that is empty or a placeholder.

    Raises
    ------
    InputError
        If it is empty or a Git LFS pointer; folders are not checked.
    """
    if not path.is_file():
        return
    try:
        with path.open("rb") as file:
            head = file.read(len(LFS_MAGIC))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, remedy="check the file") from error
    if not head:
        raise InputError("is empty", file=path, remedy="the file was not written whole; copy it again")
    if head == LFS_MAGIC:
        raise InputError(
            "is a pointer of Git LFS, not the file itself",
            file=path,
            remedy="fetch it: git lfs pull, in the repository that it is from",
        )


def counted(n: int, noun: str) -> str:
    """Return ``1 row`` or ``2 rows``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def in_order(
    t_ns: TimeArray,
    label: str,
    min_step_ns: int = MIN_STEP_NS,
    *,
    file: Path | None = None,
    remedy: str = NOT_NANOSECONDS,
) -> WithProblems[IndexArray]:
    """Index (m,) that sorts times (n,) and keeps the first of equal ones, checked to be nanoseconds.

    Parameters
    ----------
    t_ns
        As read.
    label
        Name of the stream in problems, such as ``imu0/data.csv``.
    min_step_ns
        A median step below it means that the times are not nanoseconds.
    file, remedy
        For the error.

    Raises
    ------
    InputError
        If the times cannot be nanoseconds.
    """
    index, problems = order_times(t_ns, label)
    check_nanoseconds(t_ns[index], file, min_step_ns, remedy if file is not None else f"{label}: {remedy}")
    return WithProblems(index, problems)


def order_times(t_ns: TimeArray, label: str) -> WithProblems[IndexArray]:
    """Index (m,) that sorts times (n,) and keeps the first of equal ones; ``label`` is their name in problems."""
    steps = np.diff(t_ns)
    if steps.size == 0 or steps.min() > 0:
        return WithProblems(np.arange(len(t_ns)))
    problems: Problems = ()
    backwards = int(np.count_nonzero(steps < 0))
    if backwards:
        first = int(t_ns[1:][steps < 0][0])
        problems += (
            f"{label}: times go backwards in {counted(backwards, 'place')} (first at {first}), rows sorted",
        )
    index = np.argsort(t_ns, kind="stable")
    repeated = np.concatenate([[False], np.diff(t_ns[index]) == 0])
    if repeated.any():
        first = int(t_ns[index][repeated][0])
        problems += (
            f"{label}: {counted(int(repeated.sum()), 'row')} with a repeated time (first {first}) dropped",
        )
    return WithProblems(np.asarray(index[~repeated]), problems)


def check_nanoseconds(
    t_ns: TimeArray, file: Path | None, min_step_ns: int, remedy: str = NOT_NANOSECONDS
) -> None:
    """Reject times that are too close together to be nanoseconds.

    Parameters
    ----------
    t_ns
        Strictly increasing times (n,).
    file, remedy
        For the error.
    min_step_ns
        Smallest plausible median step.

    Raises
    ------
    InputError
        If the median step is smaller.
    """
    if len(t_ns) < 3:
        return
    step = int(np.median(np.diff(t_ns)))
    if step >= min_step_ns:
        return
    if step <= 1:
        guess = "seconds or milliseconds: multiply by 1e9 or 1e6"
    elif step * 1_000 < min_step_ns:
        guess = "milliseconds: multiply by 1e6"
    else:
        guess = "microseconds: multiply by 1000"
    raise InputError(
        f"timestamps are {step} apart, not nanoseconds",
        file=file,
        remedy=f"{remedy}; these look like {guess}",
    )


COUNTERS = (1 << 16, 1 << 32)  # ranges of tick counters


def unwrapped(ticks: IndexArray) -> IndexArray:
    """Unwrap ticks (n,), in the order of the file, of a counter that overflows at 2^16 or 2^32.

    A clock that was set back is left unchanged, because its values do not continue those of an overflowed counter.
    """
    steps = np.diff(ticks)
    if len(steps) == 0 or steps.min() >= 0 or ticks.min() < 0:
        return ticks
    usual = max(float(np.median(np.abs(steps))), 1.0)
    for size in COUNTERS:
        over = (steps < -size // 2).astype(np.int64) - (steps > size // 2)
        rest = np.abs(steps + over * size)
        if ticks.max() < size and over.any() and float(rest[over != 0].max()) <= 100.0 * usual:
            return np.asarray(ticks + size * np.concatenate([[0], np.cumsum(over)]))
    return ticks


def finite(values: FloatArray) -> BoolArray:
    """Rows (n,) of (n, k) that contain only numbers."""
    return np.asarray(np.isfinite(values).all(axis=1))


def report_dropped(
    good: BoolArray,
    t_ns: TimeArray,
    what: str,
    label: str,
    *,
    file: Path | None = None,
    remedy: str = "choose another stream",
) -> Problems:
    """Report the rows that are not good: "2 rows dropped: ``what``"; the caller drops them.

    Parameters
    ----------
    good
        Rows (n,) to keep.
    t_ns
        Their times (n,).
    what
        Fault of the other rows, such as "a gyro value that is not finite".
    label
        Name of the stream.
    file, remedy
        For the error if no row is left.

    Raises
    ------
    InputError
        If no row is good.
    """
    bad = int(np.count_nonzero(~good))
    if bad == len(good):
        which = "every row has" if file is not None else f"{label}: every row has"
        raise InputError(f"{which} {what}", file=file, remedy=remedy)
    if not bad:
        return ()
    first = int(t_ns[~good][0])
    return (f"{label}: {counted(bad, 'row')} dropped: {what} (first at {first})",)


def at_rate(t_ns: TimeArray, rate: float) -> TimeArray:
    """Scale times (n,) of a clock with another rate, relative to the earliest of them."""
    if not len(t_ns):
        return t_ns
    first_ns = int(np.min(t_ns))
    return np.asarray(first_ns + np.rint((t_ns - first_ns) * rate), dtype=np.int64)
