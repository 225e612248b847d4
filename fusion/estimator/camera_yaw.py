"""Yaw error of the camera's calibration, estimated from the axis's elevations and the vehicle's roll.

A camera whose yaw or principal point differs from the calibration makes every heading wrong by that angle, and no
turn shows it; but when the vehicle rolls, the axis seems to rise or sink by the angle times the roll's sine. The
angle is the slope of a line through elevations over the roll's sine, both less their means over the last `LEVEL_S`:
a ramp, or an attitude that is off for long, changes the elevations too, and a slow roll by chance in the same way.

The slope's variance depends on the correlation time of the errors, which is not known: those of an attitude may
follow the motion for seconds, those of frames are hardly correlated. It is therefore estimated from the residuals,
summed over windows of `WINDOW` blocks that overlap: correlated errors make the sums large (W. K. Newey, K. D. West,
"A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix", Econometrica
55, 1987). What is stated counts as some windows besides, and as few windows say little, the limits are those of
Student's t.
"""

from __future__ import annotations

from math import expm1, inf, radians, sin, sqrt
from typing import NamedTuple

LEVEL_S = 2.0  # time constant of those means
BLOCK_NS = 500_000_000
WINDOW = 3  # blocks: errors that last for longer pass for the level or the slope
MEMORY = 1.0 - 1 / 240  # of each block, when the next ends: two minutes
PRIOR_WINDOWS, MIN_BLOCKS = 3.0, 2.9  # the oldest have faded
ALIKE_FRAMES = 10.0  # that have about the same error, by what is stated
MAX_ELEVATION_RAD = 0.3  # more is no axis of a corridor
MIN_ROLL_STD = 0.02  # rad; with less, elevations show nothing
SURE_SIGMA = 4.0  # were sigma known
MAX_CAMERA_YAW_RAD = radians(3)

Sums = tuple[float, float, float, float, float]
"""Of weights, and of weights times x, y, x^2 and x y: x is the roll's sine, y an elevation, a weight one over its
variance."""
NO_SUMS: Sums = (0.0,) * 5


def surely(size: float, std: float, n: float) -> bool:
    """Whether a number is surely not zero, where its sigma is known by n degrees of freedom only."""
    z = SURE_SIGMA  # Student's t, by the expansion of Cornish and Fisher
    return size > std * (z + (z**3 + z) / (4.0 * n) + (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * n**2))


class CameraYaw(NamedTuple):
    """What elevations have shown so far.

    Parameters
    ----------
    level
        Time of the last frame, and means of the roll's sine and the elevation until then; None before the first.
    since_ns, block
        The block that is being filled: its first frame, and its sums.
    n_blocks, sums
        How many blocks are full, and their sums.
    products
        Sums over windows of the products of their sums with one another, by rows of the lower triangle.
    recent
        Sums of the blocks of the present window.
    angle_rad, std_rad
        By how much the camera points to the right of what is told, and its sigma; infinite while nothing is known.
    """

    level: tuple[int, float, float] | None = None
    since_ns: int | None = None
    block: Sums = NO_SUMS
    n_blocks: float = 0.0
    sums: Sums = NO_SUMS
    products: tuple[float, ...] = (0.0,) * 15
    recent: tuple[Sums, ...] = ()
    angle_rad: float = 0.0
    std_rad: float = inf

    @property
    def is_off(self) -> bool:
        """Whether it surely points to one side by more than an installation may."""
        size, n = abs(self.angle_rad), PRIOR_WINDOWS + self.n_blocks / WINDOW
        return size - self.std_rad > MAX_CAMERA_YAW_RAD and surely(size, self.std_rad, n)

    def with_elevation(self, t_ns: int, elevation_rad: float, std_rad: float, roll_rad: float) -> CameraYaw:
        """Take the elevation of a frame's axis above the IMU's horizon, its sigma, and the vehicle's roll.

        The sigma is that of both, frame and attitude.
        """
        # NaN fails too.
        if not (abs(elevation_rad) < MAX_ELEVATION_RAD and 1e-4 < std_rad < MAX_ELEVATION_RAD):
            return self
        x, y, w = sin(roll_rad), elevation_rad, std_rad**-2
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

    def _with_block(self) -> CameraYaw:
        """Take the block in, and fit."""
        b = self.block
        n = MEMORY * self.n_blocks + 1.0
        sw, sx, sy, sxx, sxy = tuple(MEMORY * s + new for s, new in zip(self.sums, b, strict=True))
        recent = (*self.recent, b)[-WINDOW:]
        window = [sum(column) / sqrt(WINDOW) for column in zip(*recent, strict=True)]
        pairs = (window[i] * window[j] for i in range(5) for j in range(i + 1))
        products = tuple(MEMORY * s + new for s, new in zip(self.products, pairs, strict=True))
        known = self._replace(n_blocks=n, sums=(sw, sx, sy, sxx, sxy), products=products, recent=recent)
        x, y = sx / sw, sy / sw
        spread = sxx - sx * x  # of the roll's sine, weighted
        if n < MIN_BLOCKS or spread < MIN_ROLL_STD**2 * sw:
            return known._replace(angle_rad=0.0, std_rad=inf)
        slope = (sxy - sx * y) / spread
        level = y - slope * x
        # A window's sum of (x - mean) times residual is these factors times its sums.
        factors = (x * level, slope * x - level, -x, -slope, 1.0)
        squares = sum(
            (1.0 if i == j else 2.0) * factors[i] * factors[j] * products[i * (i + 1) // 2 + j]
            for i in range(5)
            for j in range(i + 1)
        )
        stated = ALIKE_FRAMES * spread
        # Of two numbers that are fitted, residuals know nothing.
        variance = (PRIOR_WINDOWS * stated + n * max(squares, 0.0)) / (PRIOR_WINDOWS + n - 2.0) / spread**2
        return known._replace(angle_rad=slope, std_rad=sqrt(variance))
