"""Whether frames are stamped early or late: takes their headings and the gyroscope's angle, returns the offset.

A frame that is stamped late by c shows a turn later than the gyroscope: its heading is less than the gyroscope's by c
times the rate. So c is the slope of a line through the differences of the two over the rate. The gyroscope's scale
and the camera's focal length make differences in proportion to the angle instead. That is fitted besides: over few
turns angle and rate are correlated. All are less their means over the last `LEVEL_S`, which leaves out the
gyroscope's bias and its wander.

In one span of seconds the offset does not stand out from the frames' noise
(`fusion.estimator.frame_drift.Slope.stamp_s`). Here it is summed up over `MEMORY_BLOCKS`: a clock that runs wrong by
a fraction of a per cent shows as well. Its sigma follows from the residuals, as in `fusion.estimator.running_slope`.
"""

from __future__ import annotations

from math import expm1, inf, pi, remainder, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import FloatArray
from fusion.estimator.running_slope import MIN_STD, is_surely_beyond

LEVEL_S = (
    0.5  # time constant of the means: slower, and the gyroscope's wander passes for stamps in slow turns
)
BLOCK_NS = 500_000_000
WINDOW = 3  # blocks: errors that last for longer pass for the slope
MEMORY_BLOCKS = 20
MIN_BLOCKS = 8
PRIOR_WINDOWS = 3.0
ALIKE_FRAMES = 10.0  # that have about the same error, by what is stated
MAX_STEP_S = 0.5  # between frames
MAX_JUMP_RAD = 0.35  # of the difference from frame to frame: another axis
# What differs by more than this, times rate and angle, is a gross error.
MAX_OFFSET_S, MAX_SCALE = 0.3, 0.2
MIN_RATE_RAD_S = 0.03  # rms, less the mean; with less, frames show nothing
MIN_REPORTED_S = 0.025  # an offset that is smaller does no harm worth a word
N_TERMS = 3  # of a line over rate and angle

Sums = tuple[float, ...]
"""Of weights times the products of (1, rate, angle, difference) with one another, by rows of the lower triangle."""


class FrameTiming(NamedTuple):
    """What frames have shown of their stamps so far.

    Parameters
    ----------
    last
        Time of the last frame, ns, the gyroscope's angle there, and the difference; None before the first.
    level
        Means of rate, angle and difference.
    since_ns, block
        The block that is being filled: its first frame, and its sums.
    blocks
        Sums of the last full blocks.
    late_s, std_s
        By how much frames are stamped late, and its sigma; infinite while nothing is known.
    """

    last: tuple[int, float, float] | None = None
    level: tuple[float, float, float] | None = None
    since_ns: int | None = None
    block: Sums = (0.0,) * 10
    blocks: tuple[Sums, ...] = ()
    late_s: float = 0.0
    std_s: float = inf

    @property
    def is_off(self) -> bool:
        """Whether frames are surely stamped early or late by more than matters."""
        n = PRIOR_WINDOWS + len(self.blocks) / WINDOW
        return is_surely_beyond(self.late_s, self.std_s, MIN_REPORTED_S, n)

    @property
    def text(self) -> str:
        """The offset in words, to 10 ms: finer, and the words would change twice a second."""
        side = "late" if self.late_s > 0.0 else "early"
        late_ms = round(1e3 * abs(self.late_s), -1)
        return f"frames are stamped {late_ms:.0f} ms {side}: set camera_delay_s, or synchronise the clocks"

    def interrupted(self) -> FrameTiming:
        """Compare no frame to come with those before; what they have shown stays."""
        return self if self.last is None else self._replace(last=None, level=None, since_ns=None)

    def with_frame(self, t_ns: int, heading_rad: float, gyro_rad: float, std_rad: float) -> FrameTiming:
        """Add a frame's heading, its sigma, and the angle that the gyroscope has turned by then (bias included)."""
        difference = heading_rad - gyro_rad
        if self.last is None:
            return self._replace(last=(t_ns, gyro_rad, difference))
        then_ns, then_gyro, then_difference = self.last
        dt_s = (t_ns - then_ns) * 1e-9
        difference = then_difference + remainder(difference - then_difference, pi)
        if not 0.0 < dt_s < MAX_STEP_S or abs(difference - then_difference) > MAX_JUMP_RAD:
            return self.interrupted()._replace(last=(t_ns, gyro_rad, difference))
        last, rate = (t_ns, gyro_rad, difference), (gyro_rad - then_gyro) / dt_s
        if self.level is None:
            return self._replace(last=last, level=(rate, gyro_rad, difference))
        share = -expm1(-dt_s / LEVEL_S)
        mean_rate, mean_angle, mean_difference = self.level
        x, z = rate - mean_rate, gyro_rad - mean_angle
        reach = 5.0 * std_rad + MAX_OFFSET_S * abs(x) + MAX_SCALE * abs(z)
        y = min(max(difference - mean_difference, -reach), reach)
        level = (mean_rate + share * x, mean_angle + share * z, mean_difference + share * y)
        full = self._replace(last=last, level=level)
        if full.since_ns is None or t_ns - full.since_ns >= BLOCK_NS:
            full = full._with_block()._replace(since_ns=t_ns, block=(0.0,) * 10)
        w = max(std_rad, MIN_STD) ** -2
        products = (w, w * x, w * x * x, w * z, w * z * x, w * z * z, w * y, w * y * x, w * y * z, w * y * y)
        return full._replace(block=tuple(a + b for a, b in zip(full.block, products, strict=True)))

    def _with_block(self) -> FrameTiming:
        """Add the block, and fit."""
        if self.since_ns is None:
            return self
        blocks = (*self.blocks, self.block)[-MEMORY_BLOCKS:]
        late_s, std_s = _fitted(blocks)
        return self._replace(blocks=blocks, late_s=late_s, std_s=std_s)


def _fitted(blocks: tuple[Sums, ...]) -> tuple[float, float]:
    """Return by how much frames are stamped late, s, and its sigma; (0, inf) where blocks do not show it."""
    n = len(blocks)
    if n < MIN_BLOCKS:
        return 0.0, inf
    rows, columns = np.tril_indices(N_TERMS + 1)
    each: FloatArray = np.zeros((n, N_TERMS + 1, N_TERMS + 1))
    each[:, rows, columns] = each[:, columns, rows] = blocks
    whole = each.sum(axis=0)
    if whole[1, 1] - whole[0, 1] ** 2 / whole[0, 0] < MIN_RATE_RAD_S**2 * whole[0, 0]:
        return 0.0, inf
    information = whole[:N_TERMS, :N_TERMS]
    try:
        cov = np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return 0.0, inf
    fitted = cov @ whole[:N_TERMS, N_TERMS]
    # What a block's residuals add to the slope over the rate, summed over windows of blocks.
    by_block = (each[:, :N_TERMS, N_TERMS] - each[:, :N_TERMS, :N_TERMS] @ fitted) @ cov[1]
    by_window = np.convolve(by_block, np.ones(WINDOW)) / sqrt(WINDOW)
    stated, squares = ALIKE_FRAMES * cov[1, 1], n * float(by_window @ by_window)
    variance = (PRIOR_WINDOWS * stated + squares) / (PRIOR_WINDOWS + n - N_TERMS)
    return -float(fitted[1]), sqrt(max(float(variance), 0.0))
