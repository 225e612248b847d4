"""Lens distortion and its inverse, in normalised image coordinates x = X/Z, y = Y/Z with r^2 = x^2 + y^2.

Radial-tangential, with ``q = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)``:

    x_d = x q + 2 p1 x y + p2 (r^2 + 2 x^2),    y_d = y q + p1 (r^2 + 2 y^2) + 2 p2 x y

Equidistant, with the angle a from the optical axis: ``r_d = a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)``.

Both models are OpenCV's (`calib3d`, sections "Detailed Description" and "fisheye"). The inverses here use Newton's
method: OpenCV's fixed-point iteration does not converge for strong distortion, and it returns values beyond the
radius at which a fitted polynomial stops growing, where no ray belongs to a pixel. Here such points are NaN, in both
directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, inf, pi, radians, sqrt, tan

import numpy as np

from vision.types import FloatArray

_TABLE_SIZE = 2048
_WIDEST_RAD = radians(89.9)
_MAX_ITERATIONS = 12
_LAST_STEP = 1e-7  # convergence is quadratic: after such a step the error is about its square


def _first_positive_root(ascending: list[float], largest: float) -> float:
    """Return the smallest positive real root of a polynomial with ascending coefficients; inf if there is none.

    Leading terms that are negligible up to ``largest`` are dropped, as dividing by them would overflow.
    """
    while len(ascending) > 1 and abs(ascending[-1]) * largest ** (len(ascending) - 1) < 1e-12:
        ascending = ascending[:-1]
    roots = np.roots(ascending[::-1])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots.real))) & (roots.real > 0.0)]
    return float(real.min()) if real.size else inf


def _product(a: list[float], b: list[float]) -> list[float]:
    return [float(v) for v in np.convolve(a, b)]


def _derivative(ascending: list[float]) -> list[float]:
    return [i * c for i, c in enumerate(ascending)][1:]


@dataclass(frozen=True, slots=True, eq=False)
class RadialTangential:
    """Radial-tangential distortion of a pinhole camera, ``k1 k2 p1 p2 [k3 [k4 k5 k6]]``.

    Parameters
    ----------
    k
        k1 to k6; zeros where the file gave fewer.
    p1, p2
        Tangential coefficients.
    max_radius
        Undistorted radius at which the radial function stops growing or has its pole; inf: never.
    reach
        Distorted radius beyond which no point has an inverse.
    table_radius, table_distorted
        Samples (m,) of the radial function, for the initial guess of the inverse.
    """

    k: tuple[float, float, float, float, float, float]
    p1: float
    p2: float
    max_radius: float
    reach: float
    table_radius: FloatArray
    table_distorted: FloatArray

    @classmethod
    def from_coefficients(cls, coefficients: tuple[float, ...]) -> RadialTangential:
        """Create the model from 4, 5 or 8 coefficients in OpenCV's order."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *[0.0] * (8 - len(coefficients)))
        numerator, denominator = [1.0, k1, k2, k3], [1.0, k4, k5, k6]
        # With s = r^2, d/dr [r N(s)/D(s)] has the numerator (N + 2 s N') D - 2 s N D'.
        grown = [n + 2.0 * i * n for i, n in enumerate(numerator)]
        left = _product(grown, denominator)
        right = [0.0, *_product(numerator, [2.0 * d for d in _derivative(denominator)])]
        slope = [a - b for a, b in zip(left, [*right, 0.0][: len(left)], strict=True)]
        largest = tan(_WIDEST_RAD) ** 2
        fold, pole = _first_positive_root(slope, largest), _first_positive_root(denominator, largest)
        max_radius = sqrt(min(fold, pole))
        angle = np.linspace(0.0, min(atan(max_radius), _WIDEST_RAD), _TABLE_SIZE)
        radius = np.tan(angle)
        if max_radius < inf:
            radius[-1] = max_radius * (1.0 - 1e-12)  # a pole has no value
        s = radius * radius
        distorted = radius * np.polyval(numerator[::-1], s) / np.polyval(denominator[::-1], s)
        reach = inf
        if max_radius < inf:  # the tangential terms add at most 3 (|p1| + |p2|) r^2
            reach = float(distorted[-1]) + 3.0 * (abs(p1) + abs(p2)) * max_radius**2
        k = (k1, k2, k3, k4, k5, k6)
        return cls(k, p1, p2, max_radius, reach, radius, np.maximum.accumulate(distorted))

    def _radial(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the radial factor and its derivative with respect to s = r^2."""
        k1, k2, k3, k4, k5, k6 = self.k
        factor = 1.0 + s * (k1 + s * (k2 + s * k3))
        slope = k1 + s * (2.0 * k2 + s * (3.0 * k3))
        if k4 == k5 == k6 == 0.0:
            return factor, slope
        inverse = 1.0 / (1.0 + s * (k4 + s * (k5 + s * k6)))
        factor *= inverse
        return factor, (slope - factor * (k4 + s * (2.0 * k5 + s * (3.0 * k6)))) * inverse

    def distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distort undistorted coordinates x/z, y/z (n,); NaN beyond `max_radius`."""
        s = x * x + y * y
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            factor, _ = self._radial(s)
            xy = 2.0 * x * y
            distorted_x = x * factor + self.p1 * xy + self.p2 * (s + 2.0 * x * x)
            distorted_y = y * factor + self.p1 * (s + 2.0 * y * y) + self.p2 * xy
        outside = s >= self.max_radius**2
        distorted_x[outside] = np.nan
        distorted_y[outside] = np.nan
        return distorted_x, distorted_y

    def undistort(self, target_x: FloatArray, target_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Invert `distort` for (n,) by Newton's method; NaN where there is no inverse."""
        p1, p2 = self.p1, self.p2
        target_r = np.hypot(target_x, target_y)
        step_limit = _LAST_STEP * (1.0 + target_r)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            guess = np.interp(target_r, self.table_distorted, self.table_radius) / target_r
            guess[target_r == 0.0] = 1.0
            # Beyond `reach` there is no solution, and a point that never converges delays all others.
            guess[target_r > self.reach] = np.nan
            x, y = target_x * guess, target_y * guess
            for _ in range(_MAX_ITERATIONS):
                xx, yy, xy = x * x, y * y, 2.0 * x * y
                s = xx + yy
                factor, slope = self._radial(s)
                error_x = x * factor + p1 * xy + p2 * (s + 2.0 * xx) - target_x
                error_y = y * factor + p1 * (s + 2.0 * yy) + p2 * xy - target_y
                a = factor + 2.0 * (xx * slope + p1 * y + 3.0 * p2 * x)
                b = xy * slope + 2.0 * (p1 * x + p2 * y)
                c = factor + 2.0 * (yy * slope + 3.0 * p1 * y + p2 * x)
                determinant = a * c - b * b
                step_x = (c * error_x - b * error_y) / determinant
                step_y = (a * error_y - b * error_x) / determinant
                x, y = x - step_x, y - step_y
                step = np.abs(step_x) + np.abs(step_y)
                if not np.any(step > step_limit):  # NaN compares false
                    break
            valid = (step <= step_limit) & (s < self.max_radius**2) & (determinant > 0.0) & (factor > 0.0)
        x[~valid] = np.nan
        y[~valid] = np.nan
        return x, y


@dataclass(frozen=True, slots=True, eq=False)
class Equidistant:
    """Equidistant fisheye: distorted radius ``theta (1 + k1 theta^2 + ... + k4 theta^8)``.

    Parameters
    ----------
    k
        k1 to k4.
    max_angle_rad
        Angle from the optical axis at which the polynomial stops growing; at most pi.
    table_angle, table_distorted
        Samples (m,), for the initial guess of the inverse.
    """

    k: tuple[float, float, float, float]
    max_angle_rad: float
    table_angle: FloatArray
    table_distorted: FloatArray

    @classmethod
    def from_coefficients(cls, coefficients: tuple[float, ...]) -> Equidistant:
        """Create the model from its four coefficients."""
        k1, k2, k3, k4 = coefficients
        turning = sqrt(_first_positive_root([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4], pi**2))
        max_angle = min(pi, turning)
        angle = np.linspace(0.0, max_angle, _TABLE_SIZE)
        s = angle * angle
        distorted = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        return cls((k1, k2, k3, k4), max_angle, angle, np.maximum.accumulate(distorted))

    def distort(self, angle_rad: FloatArray) -> FloatArray:
        """Return the distorted radius (n,) of angles from the optical axis; NaN from `max_angle_rad` on."""
        k1, k2, k3, k4 = self.k
        s = angle_rad * angle_rad
        distorted = angle_rad * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        distorted[angle_rad >= self.max_angle_rad] = np.nan
        return distorted

    def undistort(self, target: FloatArray) -> FloatArray:
        """Return the angles (n,) from the optical axis of distorted radii; NaN where there is none."""
        k1, k2, k3, k4 = self.k
        angle = np.interp(target, self.table_distorted, self.table_angle)
        angle[target > self.table_distorted[-1]] = np.nan
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for _ in range(_MAX_ITERATIONS):
                s = angle * angle
                error = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) - target
                slope = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
                step = error / slope
                angle = angle - step
                if not np.any(np.abs(step) > _LAST_STEP):
                    break
            valid = (np.abs(step) <= _LAST_STEP) & (angle < self.max_angle_rad) & (slope > 0.0)
        angle[~valid] = np.nan
        return angle
