"""Statistics over results, and tables of them in plain text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, nan

import numpy as np
import numpy.typing as npt

from .cases import Result

FloatArray = npt.NDArray[np.float64]

GROSS_DEG = 3.0
RIGHT_DEG = 1.5
WRONG_CORNER_PERCENT = 5.0


@dataclass(frozen=True, slots=True)
class HeadingScore:
    """Headings of many frames, degrees; NaN where nothing was accepted.

    Parameters
    ----------
    accepted
        Share of the frames.
    gross
        Accepted errors above 3 degrees.
    across
        Those of them that are right, within 3 degrees, for what runs square to the corridor.
    sigma_p90
        90th percentile of |error| / sigma; for exact truth only, 1.64 for an honest Gaussian one.
    silenced_right
        Share of the rejected frames whose heading was right within 1.5 degrees all the same.
    """

    frames: int
    accepted: float
    rmse: float
    median: float
    worst: float
    gross: int
    across: int
    sigma_p90: float
    silenced_right: float


def heading_score(results: Sequence[Result]) -> HeadingScore:
    """Score the headings of results."""
    accepted = [r for r in results if r.accepted]
    rejected = [r for r in results if not r.accepted]
    error = np.array([degrees(abs(r.error_rad)) for r in accepted])
    ratio = [abs(r.error_rad) / r.std_rad for r in accepted if r.exact]
    right = [degrees(abs(r.error_rad)) <= RIGHT_DEG for r in rejected]  # NaN is not
    return HeadingScore(
        frames=len(results),
        accepted=len(accepted) / len(results) if results else nan,
        rmse=rms(error),
        median=float(np.median(error)) if len(error) else nan,
        worst=float(error.max()) if len(error) else nan,
        gross=int((error > GROSS_DEG).sum()),
        across=int((error > 90.0 - GROSS_DEG).sum()),
        sigma_p90=float(np.percentile(ratio, 90)) if ratio else nan,
        silenced_right=float(np.mean(right)) if right else nan,
    )


@dataclass(frozen=True, slots=True)
class OffsetScore:
    """Lateral offsets of many frames, per cent of the corridor's width.

    Parameters
    ----------
    answered
        Share of all frames that are accepted and have an offset.
    wrong_corner
        Share of these with an error above 5 % of the width.
    """

    frames: int
    answered: float
    rmse: float
    median: float
    worst: float
    wrong_corner: float
    sigma_p90: float


def offset_score(results: Sequence[Result]) -> OffsetScore:
    """Score the lateral offsets of results."""
    answered = [r for r in results if r.accepted and r.offset_error_norm == r.offset_error_norm]
    error = np.array(
        [50.0 * abs(r.offset_error_norm) for r in answered]
    )  # half widths to per cent of the width
    ratio = [abs(r.offset_error_norm) / r.offset_std_norm for r in answered]
    return OffsetScore(
        frames=len(results),
        answered=len(answered) / len(results) if results else nan,
        rmse=rms(error),
        median=float(np.median(error)) if len(error) else nan,
        worst=float(error.max()) if len(error) else nan,
        wrong_corner=float((error > WRONG_CORNER_PERCENT).mean()) if len(error) else nan,
        sigma_p90=float(np.percentile(ratio, 90)) if ratio else nan,
    )


def rms(values: npt.ArrayLike) -> float:
    """Root mean square; NaN of nothing."""
    array = np.asarray(values, dtype=float)
    return float(np.sqrt(np.mean(array**2))) if array.size else nan


def reasons_of(results: Sequence[Result]) -> str:
    """Why frames were rejected, in per cent of all of them, most frequent first."""
    counts = Counter(r.reason for r in results if not r.accepted)
    return ", ".join(f"{word} {100 * n / len(results):.1f}" for word, n in counts.most_common()) or "-"


def number(value: float, digits: int = 2) -> str:
    """Print a number, or a dash for NaN."""
    return "-" if value != value else f"{value:.{digits}f}"


def percent(share: float, digits: int = 1) -> str:
    """Format a share as per cent; - for NaN."""
    return "-" if share != share else f"{100 * share:.{digits}f} %"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> str:
    """Set rows under heads, two blanks apart; columns are right-aligned but for those in ``left``."""
    widths = [max(len(line[k]) for line in [heads, *rows]) for k in range(len(heads))]

    def line(cells: Sequence[str]) -> str:
        set_ = [
            cell.ljust(w) if k in left else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(cells, widths, strict=True))
        ]
        return ("  " + "  ".join(set_)).rstrip()

    return "\n".join(line(cells) for cells in [heads, *rows])
