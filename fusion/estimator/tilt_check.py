"""Check of the attitude's roll and pitch against the gyroscope.

Over spans of half a second, the change y of gravity's direction by the attitude is regressed on the change x by the
gyroscope, for each of its two horizontal components: ``y = a + m x``. A slope m near -1 is a wrong sign, one near 0 a
frozen or swapped axis, one near 2 a wrong scale; constant errors of the attitude and the gyroscope's bias only change
a. Sums fade with `MEMORY`, and `STEP_STD_RAD` counts as `PRIOR_SPANS` spans beside the residuals. An attitude that
does not follow the gyroscope is not used: accelerometer and gyroscope give the tilt instead.
"""

from __future__ import annotations

from math import nan, radians, sqrt
from typing import NamedTuple

from fusion.estimator.kernels import Vector
from fusion.estimator.records import new_record

SPAN_NS, MAX_SPAN_NS = 500_000_000, 1_000_000_000
MEMORY = 1.0 - 1 / 8  # forgetting factor per span
MIN_SPANS, PRIOR_SPANS = 5.0, 4.0
STEP_STD_RAD = radians(0.5)  # stated error of a change
SURE_SIGMA = 4.0
WRONG, AGREEING = 0.5, 0.4  # difference of the slope from one at which the fault begins and ends

UNKNOWN_DOWN: Vector = (nan, nan, nan)
Sums = tuple[float, float, float, float, float, float]
NO_SUMS: Sums = (0.0,) * 6


class TiltCheck(NamedTuple):
    """State of the check.

    Parameters
    ----------
    since_ns, down
        Start of the span, and the attitude's direction of gravity then; None before the first attitude.
    sums
        Sums of weight, x, y, xx, xy and yy for the components ahead and to the right.
    is_wrong
        Whether the attitude does not follow the gyroscope.
    """

    since_ns: int | None = None
    down: Vector = UNKNOWN_DOWN
    sums: tuple[Sums, Sums] = (NO_SUMS, NO_SUMS)
    is_wrong: bool = False

    def ends_span(self, t_ns: int) -> bool:
        """Whether an attitude at this time ends the present span."""
        return self.since_ns is None or not 0 <= t_ns - self.since_ns < SPAN_NS

    def with_span(self, t_ns: int, down: Vector, turned: Vector) -> TiltCheck:
        """End a span; ``turned`` is its first direction turned by the gyroscope up to now, NaN if unknown."""
        lasted = None if self.since_ns is None else t_ns - self.since_ns
        if lasted is None or not SPAN_NS <= lasted <= MAX_SPAN_NS or turned[0] != turned[0]:
            return self._replace(since_ns=t_ns, down=down)
        ahead, right = (
            _with_change(sums, turned[i] - self.down[i], down[i] - self.down[i])
            for i, sums in enumerate(self.sums)
        )
        found = [differs for sums in (ahead, right) if (differs := _difference(sums)) is not None]
        if self.is_wrong:  # until every component that moves agrees
            is_wrong = not found or any(abs(slope) + std > AGREEING for slope, std in found)
        else:
            is_wrong = any(abs(slope) - SURE_SIGMA * std > WRONG for slope, std in found)
        return new_record(TiltCheck, (t_ns, down, (ahead, right), is_wrong))


def _with_change(sums: Sums, x: float, y: float) -> Sums:
    n, sx, sy, sxx, sxy, syy = (MEMORY * value for value in sums)
    return n + 1.0, sx + x, sy + y, sxx + x * x, sxy + x * y, syy + y * y


def _difference(sums: Sums) -> tuple[float, float] | None:
    """Return slope less one and its sigma; None while they are unknown."""
    n, sx, sy, sxx, sxy, syy = sums
    if n < MIN_SPANS:
        return None
    vxx, vxy, vyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
    if not vxx > STEP_STD_RAD**2:
        return None
    slope = vxy / vxx
    scatter = max(vyy - slope * vxy, 0.0) + PRIOR_SPANS * STEP_STD_RAD**2
    return slope - 1.0, sqrt(scatter / (n - 2.0 + PRIOR_SPANS) / vxx)
