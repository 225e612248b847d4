"""The slope of a line through points whose errors may last: takes points one by one, returns the slope and its sigma.

Both coordinates are less their means over the last `LEVEL_S`: what is off for long, and what drifts slowly, changes
no slope.

The slope's variance depends on the correlation time of the errors, which is not known. It is therefore estimated from
the residuals, summed over windows of some blocks that overlap: correlated errors make the sums large (W. K. Newey,
K. D. West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix",
Econometrica 55, 1987). The stated sigmas count as some windows besides. Limits are those of Student's t, since few
windows leave the variance uncertain.
"""

from __future__ import annotations

from math import expm1, inf, sqrt
from typing import NamedTuple

LEVEL_S = 2.0  # time constant of those means
BLOCK_NS = 500_000_000
MEMORY = 1.0 - 1 / 240  # of each block, when the next ends: two minutes
PRIOR_WINDOWS, MIN_BLOCKS = 3.0, 2.9  # the oldest have faded
ALIKE_POINTS = 10.0  # that have about the same error, by what is stated
SURE_SIGMA = 4.0  # were sigma known
MIN_STD = 1e-4  # rad: no frame is more exact, whatever it says

Sums = tuple[float, float, float, float, float]
"""Of weights, and of weights times x, y, x^2 and x y; a weight is one over a variance."""
NO_SUMS: Sums = (0.0,) * 5


def is_surely_beyond(value: float, std: float, limit: float, n: float) -> bool:
    """Whether a number is surely not zero, and beyond a limit to either side; its sigma has n degrees of freedom."""
    # Student's t, by the expansion of Cornish and Fisher.
    z, size = SURE_SIGMA, abs(value)
    sure = z + (z**3 + z) / (4.0 * n) + (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * n**2)
    return size - std > limit and size > sure * std


class RunningSlope(NamedTuple):
    """What points have shown so far.

    Parameters
    ----------
    window
        Length of a window in blocks: errors that last for longer pass for the level or the slope.
    min_x_std
        While x scatters by less, nothing is known.
    level
        Time of the last point, and means of x and y until then; None before the first.
    since_ns, block
        The block that is being filled: its first point, and its sums.
    n_blocks, sums
        How many blocks are full, and their sums.
    products
        Sums over windows of the products of their sums with one another, by rows of the lower triangle.
    recent
        Sums of the blocks of the present window.
    slope, std
        The slope and its sigma; infinite while nothing is known.
    """

    window: int
    min_x_std: float
    level: tuple[int, float, float] | None = None
    since_ns: int | None = None
    block: Sums = NO_SUMS
    n_blocks: float = 0.0
    sums: Sums = NO_SUMS
    products: tuple[float, ...] = (0.0,) * 15
    recent: tuple[Sums, ...] = ()
    slope: float = 0.0
    std: float = inf

    @property
    def windows(self) -> float:
        """How many windows the scatter of x amounts to: few, where it is that of one turn."""
        x2, x4 = self.sums[3], self.products[9]  # of the blocks, and of the windows squared
        return min(x2 * x2 / x4, self.n_blocks / self.window) if x4 > 0.0 else 0.0

    def is_beyond(self, limit: float, windows: float) -> bool:
        """Whether the slope is surely larger than a limit, to either side; its sigma is known by so many windows."""
        return is_surely_beyond(self.slope, self.std, limit, windows)

    def interrupted(self) -> RunningSlope:
        """Start anew with the means; what is known of the slope stays."""
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
        """Add the block, and fit."""
        b = self.block
        n = MEMORY * self.n_blocks + 1.0
        sw, sx, sy, sxx, sxy = tuple(MEMORY * s + new for s, new in zip(self.sums, b, strict=True))
        recent = (*self.recent, b)[-self.window :]
        window = [sum(column) / sqrt(self.window) for column in zip(*recent, strict=True)]
        pairs = (window[i] * window[j] for i in range(5) for j in range(i + 1))
        products = tuple(MEMORY * s + new for s, new in zip(self.products, pairs, strict=True))
        known = self._replace(n_blocks=n, sums=(sw, sx, sy, sxx, sxy), products=products, recent=recent)
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
        stated = ALIKE_POINTS * spread
        # Of two numbers that are fitted, residuals know nothing.
        variance = (PRIOR_WINDOWS * stated + n * max(squares, 0.0)) / (PRIOR_WINDOWS + n - 2.0) / spread**2
        return known._replace(slope=slope, std=sqrt(variance))
