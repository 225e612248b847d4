"""Scores of lateral offset mixtures against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.lateral.mixture import OffsetMixture

FloatArray = npt.NDArray[np.float64]

CORRECT_NORM = 0.10  # half widths: largest error of a correct estimate
SURE = 0.9  # probability within `CORRECT_NORM` of the likeliest offset
GRID: FloatArray = np.linspace(-0.995, 0.995, 200)


def density_of(mixture: OffsetMixture) -> FloatArray:
    """Return the probability (n,) of the offset at each point of `GRID`."""
    z = (GRID[:, None] - mixture.offset_norm) / mixture.std_norm
    peaks = np.exp(-0.5 * z * z) / (mixture.std_norm * np.sqrt(2.0 * np.pi))
    density = (1.0 - mixture.weight.sum()) / 2.0 + peaks @ mixture.weight
    return np.asarray(density / density.sum(), dtype=float)


@dataclass(frozen=True, slots=True)
class OffsetScores:
    """Scores over a set of frames; offsets and errors in half widths.

    Parameters
    ----------
    n
        Frames.
    within
        Share whose likeliest offset is within `CORRECT_NORM` of the truth.
    sure, sure_wrong
        Share with more than `SURE` of the probability within `CORRECT_NORM` of the likeliest offset, and the share of
        these whose likeliest offset is not within `CORRECT_NORM` of the truth.
    median, sure_median
        Median error of all frames and of the sure ones.
    ratio_p90
        90th percentile of error over standard deviation, sure frames.
    nll
        Mean negative log-likelihood of the truth relative to the uniform density: 0 without information, lower is
        better.
    """

    n: int
    within: float
    sure: float
    sure_wrong: float
    median: float
    sure_median: float
    ratio_p90: float
    nll: float

    @classmethod
    def of(cls, mixtures: Sequence[OffsetMixture], offsets: npt.ArrayLike) -> OffsetScores:
        """Score mixtures against true offsets (n,)."""
        truth = np.asarray(offsets, dtype=float)
        p = np.stack([density_of(mixture) for mixture in mixtures])
        near = (np.abs(GRID[:, None] - GRID) < CORRECT_NORM).astype(float)
        mass = p @ near
        best = mass.argmax(axis=1)
        window = p * near[best]
        window /= window.sum(axis=1, keepdims=True)
        mean = window @ GRID
        std = np.sqrt(np.maximum(window @ GRID**2 - mean**2, 1e-6))
        error, sure = np.abs(mean - truth), mass.max(axis=1) > SURE
        at = np.array([np.interp(t, GRID, row) for t, row in zip(truth, p, strict=True)]) * len(GRID)
        some = sure if sure.any() else np.ones(len(sure), bool)
        return cls(
            n=len(truth),
            within=float((error < CORRECT_NORM).mean()),
            sure=float(sure.mean()),
            sure_wrong=float((error[sure] >= CORRECT_NORM).mean()) if sure.any() else 0.0,
            median=float(np.median(error)),
            sure_median=float(np.median(error[some])),
            ratio_p90=float(np.quantile(error[some] / std[some], 0.9)),
            nll=float(-np.log(np.maximum(at, 1e-9)).mean()),
        )

    def line(self) -> str:
        """Return the scores as one line of text."""
        return (
            f"n {self.n:4d}  within {self.within:.3f}  sure {self.sure:.3f}  wrong of these {self.sure_wrong:.4f}"
            f"  median {self.median:.4f} (sure {self.sure_median:.4f})  error/sigma p90 {self.ratio_p90:.2f}"
            f"  nll {self.nll:.2f}"
        )
