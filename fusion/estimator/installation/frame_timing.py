"""Time-stamp error of the frames, estimated from their headings and the gyroscope's angle.

A frame that is stamped late by c shows a turn later than the gyroscope. The difference d of heading minus gyroscope's
angle alpha is modelled as::

    d = d_0 - c omega + k alpha + noise

with omega the turn rate. The term k contains the scale error of the gyroscope and the error of the focal length; it
is fitted too, because angle and rate are correlated over few turns. Means over the last `LEVEL_S` are subtracted from
all variables, which removes the gyroscope's bias and its random walk. They start again after a step of d, as of a
camera that is knocked in its mount: it would correlate with the turn made meanwhile.

The error is small against the frames' noise in a span of seconds (`fusion.estimator.frame_drift.Slope.stamp_s`). Here
the normal equations are summed over `MEMORY_BLOCKS` blocks, 10 s: short enough to follow a clock whose rate is wrong.
Its sigma follows from the residuals, as in `running_slope`. It is reported if it is significant
(`running_slope.is_surely_beyond`) and larger than `MIN_REPORTED_S`.
"""

from __future__ import annotations

from math import expm1, inf, pi, remainder, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.installation.running_slope import MIN_STD, is_surely_beyond
from fusion.estimator.kernels import FloatArray

# Time constant of the means; with a longer one the gyroscope's random walk biases c in slow turns.
LEVEL_S = 0.5
BLOCK_NS = 500_000_000
WINDOW = 3  # blocks; errors with a longer correlation time are not covered by the sigma
MEMORY_BLOCKS = 20
MIN_BLOCKS = 8
PRIOR_WINDOWS = 3.0
CORRELATED_FRAMES = 10.0  # correlated frames per independent one, in the prior of the variance
MAX_STEP_S = 0.5  # longest time between frames
MAX_JUMP_RAD = 0.35  # a larger change of the difference from frame to frame is another axis
# Differences are clipped at these values times rate and angle, plus five sigmas.
MAX_OFFSET_S, MAX_SCALE = 0.3, 0.2
STEP_FRAMES = 3  # clipped on the same side in a row; gross errors have either side
MIN_RATE_RAD_S = 0.03  # rms of the rate about its mean; with less, c is not observable
MIN_REPORTED_S = 0.025  # smaller errors have no relevant effect
N_TERMS = 3  # constant, rate and angle

Sums = tuple[float, ...]
"""Of weights times the products of (1, rate, angle, difference) with one another, by rows of the lower triangle."""


class FrameTiming(NamedTuple):
    """Estimate of the frames' time-stamp error.

    Parameters
    ----------
    last
        Time of the last frame, ns, the gyroscope's angle there, and the difference; None before the first.
    level
        Means of rate, angle and difference.
    clipped
        Number of frames in a row whose difference was clipped since it stepped, negative below the mean.
    since_ns, block
        The block that is being filled: time of its first frame, and its sums.
    blocks
        Sums of the last full blocks.
    late_s, std_s
        Time c by which frames are stamped late, and its sigma; infinite while unknown.
    """

    last: tuple[int, float, float] | None = None
    level: tuple[float, float, float] | None = None
    clipped: int = 0
    since_ns: int | None = None
    block: Sums = (0.0,) * 10
    blocks: tuple[Sums, ...] = ()
    late_s: float = 0.0
    std_s: float = inf

    @property
    def is_off(self) -> bool:
        """Whether frames are stamped early or late by a significant and relevant time."""
        n = PRIOR_WINDOWS + len(self.blocks) / WINDOW
        return is_surely_beyond(self.late_s, self.std_s, MIN_REPORTED_S, n)

    @property
    def text(self) -> str:
        """The fault's text, rounded to 10 ms so that it does not change twice a second."""
        side = "late" if self.late_s > 0.0 else "early"
        late_ms = round(1e3 * abs(self.late_s), -1)
        return f"frames are stamped {late_ms:.0f} ms {side}: set camera_delay_s, or synchronise the clocks"

    def interrupted(self) -> FrameTiming:
        """Restart the means; keep the blocks and the estimate."""
        return self if self.last is None else self._replace(last=None, level=None, since_ns=None)

    def with_frame(self, t_ns: int, heading_rad: float, gyro_rad: float, std_rad: float) -> FrameTiming:
        """Add a frame's heading and its sigma, with the gyroscope's angle at its time (bias included)."""
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
        beyond = difference - mean_difference
        y = min(max(beyond, -reach), reach)
        clipped, side = 0, 1 if y > 0.0 else -1
        if y != beyond and self.clipped * side > 0:
            clipped = self.clipped + side
        elif y != beyond and abs(difference - then_difference) > 5.0 * std_rad + 0.5 * abs(
            gyro_rad - then_gyro
        ):
            clipped = side
        if abs(clipped) >= STEP_FRAMES:
            return self._replace(last=last, level=(mean_rate, mean_angle, difference), clipped=0)
        level = (mean_rate + share * x, mean_angle + share * z, mean_difference + share * y)
        full = self._replace(last=last, level=level, clipped=clipped)
        if full.since_ns is None or t_ns - full.since_ns >= BLOCK_NS:
            full = full._with_block()._replace(since_ns=t_ns, block=(0.0,) * 10)
        w = max(std_rad, MIN_STD) ** -2
        products = (w, w * x, w * x * x, w * z, w * z * x, w * z * z, w * y, w * y * x, w * y * z, w * y * y)
        return full._replace(block=tuple(a + b for a, b in zip(full.block, products, strict=True)))

    def _with_block(self) -> FrameTiming:
        """Append the full block, and fit."""
        if self.since_ns is None:
            return self
        blocks = (*self.blocks, self.block)[-MEMORY_BLOCKS:]
        late_s, std_s = _fitted(blocks)
        return self._replace(blocks=blocks, late_s=late_s, std_s=std_s)


def _fitted(blocks: tuple[Sums, ...]) -> tuple[float, float]:
    """Return the time by which frames are stamped late, s, and its sigma; (0, inf) if it is not observable."""
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
    # Contribution of each block's residuals to the coefficient of the rate, summed over windows of blocks.
    by_block = (each[:, :N_TERMS, N_TERMS] - each[:, :N_TERMS, :N_TERMS] @ fitted) @ cov[1]
    by_window = np.convolve(by_block, np.ones(WINDOW)) / sqrt(WINDOW)
    stated, squares = CORRELATED_FRAMES * cov[1, 1], n * float(by_window @ by_window)
    variance = (PRIOR_WINDOWS * stated + squares) / (PRIOR_WINDOWS + n - N_TERMS)
    return -float(fitted[1]), sqrt(max(float(variance), 0.0))
