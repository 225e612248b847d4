"""Recursive regression slope ``y = a + m x`` with correlated errors: slope, sigma and a significance test.

Points arrive one by one. Running means with time constant `LEVEL_S` are subtracted from both coordinates, so constant
and slowly drifting errors do not change the slope. Weighted sums are gathered in blocks, which fade with `MEMORY`,
or of which only the last count.

The variance of the slope depends on the correlation time of the errors, which is unknown. It is therefore estimated
from ``x`` times residual, summed over overlapping windows of blocks: correlated errors make these sums large (W. K.
Newey, K. D. West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
matrix", Econometrica 55, 1987). The stated sigmas count as `PRIOR_WINDOWS` further windows. The test uses quantiles
of Student's t, since the variance from few windows is uncertain.
"""

from __future__ import annotations

from math import expm1, inf, sqrt
from typing import NamedTuple

LEVEL_S = 2.0  # time constant of the running means
BLOCK_NS = 500_000_000
MEMORY = 1.0 - 1 / 240  # forgetting factor per block: two minutes
PRIOR_WINDOWS, MIN_BLOCKS = 3.0, 2.9  # three blocks, less the fading
CORRELATED_POINTS = 10.0  # correlated points per independent one, in the prior of the variance
SURE_SIGMA = 4.0  # significance for a known sigma
MIN_STD = 1e-4  # rad; lower bound of a point's sigma

Sums = tuple[float, float, float, float, float]
"""Of weights, and of weights times x, y, x^2 and x y; a weight is one over a variance."""
NO_SUMS: Sums = (0.0,) * 5


def is_surely_beyond(value: float, std: float, limit: float, n: float) -> bool:
    """Whether a value is significantly non-zero, and its size above a limit; its sigma has n degrees of freedom."""
    # Quantile of Student's t, by the expansion of Cornish and Fisher.
    z, size = SURE_SIGMA, abs(value)
    sure = z + (z**3 + z) / (4.0 * n) + (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * n**2)
    return size - std > limit and size > sure * std


class RunningSlope(NamedTuple):
    """State of the regression.

    Parameters
    ----------
    window
        Length of a window in blocks; errors with a longer correlation time are not covered by the sigma.
    min_x_std
        Smallest standard deviation of x for which the slope is observable.
    length
        Number of blocks that count; 0: all, fading.
    level
        Time of the last point, and running means of x and y; None before the first.
    since_ns, block
        The block that is being filled: time of its first point, and its sums.
    n_blocks, sums
        Number of full blocks, and their sums; both fade.
    products
        Sums over windows of the products of their sums with one another, by rows of the lower triangle.
    recent
        Sums of the blocks of the present window.
    kept
        Sums and products of each block that counts, if ``length`` is not 0.
    slope, std
        The slope and its sigma; infinite while unknown.
    """

    window: int
    min_x_std: float
    length: int = 0
    level: tuple[int, float, float] | None = None
    since_ns: int | None = None
    block: Sums = NO_SUMS
    n_blocks: float = 0.0
    sums: Sums = NO_SUMS
    products: tuple[float, ...] = (0.0,) * 15
    recent: tuple[Sums, ...] = ()
    kept: tuple[tuple[float, ...], ...] = ()
    slope: float = 0.0
    std: float = inf

    @property
    def windows(self) -> float:
        """Effective number of windows with scatter of x: small if x scatters only in one turn."""
        x2, x4 = self.sums[3], self.products[9]  # sum over blocks, and sum of squares over windows
        return min(x2 * x2 / x4, self.n_blocks / self.window) if x4 > 0.0 else 0.0

    def is_beyond(self, limit: float, windows: float) -> bool:
        """Whether the slope is significant and its size above a limit; ``windows`` are its degrees of freedom."""
        return is_surely_beyond(self.slope, self.std, limit, windows)

    def interrupted(self) -> RunningSlope:
        """Restart the running means; keep the sums and the slope."""
        return self._replace(level=None)

    def with_point(self, t_ns: int, x: float, y: float, std: float) -> RunningSlope:
        """Add a point and the sigma of its y."""
        w = max(std, MIN_STD) ** -2
        then_ns, mean_x, mean_y = self.level or (t_ns, x, y)
        share = -expm1(-max(t_ns - then_ns, 0) * 1e-9 / LEVEL_S)
        x, y = x - mean_x, y - mean_y
        full = self._replace(level=(t_ns, mean_x + share * x, mean_y + share * y))
        if full.since_ns is None:
            full = full._replace(since_ns=t_ns)
        elif not 0 <= t_ns - full.since_ns < BLOCK_NS:
            full = full._with_block()._replace(since_ns=t_ns, block=NO_SUMS)
        sw, sx, sy, sxx, sxy = full.block
        return full._replace(block=(sw + w, sx + w * x, sy + w * y, sxx + w * x * x, sxy + w * x * y))

    def _with_block(self) -> RunningSlope:
        """Add the full block, and fit."""
        b = self.block
        recent = (*self.recent, b)[-self.window :]
        window = [sum(column) / sqrt(self.window) for column in zip(*recent, strict=True)]
        newest = (*b, *(window[i] * window[j] for i in range(5) for j in range(i + 1)))
        kept = (*self.kept, newest)[-self.length :] if self.length else ()
        if kept:
            n, sums = float(len(kept)), tuple(sum(column) for column in zip(*kept, strict=True))
        else:
            n, old = MEMORY * self.n_blocks + 1.0, (*self.sums, *self.products)
            sums = tuple(MEMORY * s + new for s, new in zip(old, newest, strict=True))
        (sw, sx, sy, sxx, sxy), products = sums[:5], sums[5:]
        known = self._replace(
            n_blocks=n, sums=(sw, sx, sy, sxx, sxy), products=products, recent=recent, kept=kept
        )
        x, y = sx / sw, sy / sw
        spread = sxx - sx * x  # weighted
        if n < MIN_BLOCKS or spread < self.min_x_std**2 * sw:
            return known._replace(slope=0.0, std=inf)
        slope = (sxy - sx * y) / spread
        level = y - slope * x
        # A window's sum of (x - mean) times residual is these factors times its sums.
        factors = (x * level, slope * x - level, -x, -slope, 1.0)
        squares = sum(
            (1.0 if i == j else 2.0) * factors[i] * factors[j] * products[i * (i + 1) // 2 + j]
            for i in range(5)
            for j in range(i + 1)
        )
        stated = CORRELATED_POINTS * spread
        # Two fitted parameters reduce the residuals' degrees of freedom.
        variance = (PRIOR_WINDOWS * stated + n * max(squares, 0.0)) / (PRIOR_WINDOWS + n - 2.0) / spread**2
        return known._replace(slope=slope, std=sqrt(variance))
