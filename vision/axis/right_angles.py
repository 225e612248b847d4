"""Likelihood of a focal length: how well three orthogonal directions explain a picture's lines.

Corridor lines, transverse lines and door posts meet in three vanishing points. The directions to them are orthogonal
only at the true focal length, which is observable if the camera is pitched, or is turned and sees transverse lines.
Each line is a mixture over the three axes k and stray lines; with the density p_k of its direction under axis k, the
log-likelihood ratio against stray lines is

    sum over lines of log(STRAY_SHARE + sum_k SHARE_k p_k),

maximised over the rotation of the axes by Gauss-Newton with expectation-maximisation. Lines are given as nominal
rays, those of a camera with a fixed, assumed focal length f_0; the axes are scaled by f / f_0 instead. So lines and
tolerances are the same for every f, and a picture without information gives all of them the same score.

Buildings are not exact, and the optical axis is not exactly at the picture's centre. Five deviations, called the
slack, are estimated along with the rotation; each has a Gaussian prior, see `slack_std`.
"""

from __future__ import annotations

from math import cos, exp, log, radians, sin, sqrt
from typing import NamedTuple

import numpy as np

from vision.compiled import compiled, compiled_inner
from vision.lines.line_set import LineGeometry
from vision.types import FloatArray

N_AXES = 3  # along the corridor, across it, down: columns of a rotation, optical frame
N_TURN, N_SLACK = 3, 5
N_PARAMETERS = N_TURN + N_SLACK

CENTRE_STD_OF_SIDE = 0.01  # of the optical axis from the centre, over the longer side
SHARE = np.array([0.30, 0.12, 0.25])  # of the lines, expected along each axis
STRAY_SHARE = 1.0 - float(SHARE.sum())
PARALLEL_STD_RAD = np.array([radians(0.10), radians(0.15), radians(0.15)])  # of lines about their axis
CORRELATION = 2.0  # divides the log-likelihood: edges of one door or skirting board have common errors
UNIFORM = 1.2533  # peak density of a Gaussian of unit sigma over the uniform density on half a turn: pi / sqrt(2 pi)
MAX_Z2 = 40.0
MIN_RESPONSIBILITY = 1e-3
LAST_EXTRA_RAD = radians(0.02)  # the start's tolerance is halved until it is below the lines' own
MAX_STEPS = 14
TURN_STD_RAD = 6.0  # weak prior of the rotation: keeps the equations regular where no line constrains it
MAX_TURN_RAD = 0.1


def slack_std(centre_std: float) -> FloatArray:
    """Return the standard deviations (5,) of a picture's slack.

    In this order: slope of the corridor relative to the posts, slope of the transverse lines, deviation of the walls
    from a right angle (radians); optical axis right of and below the picture's centre (``centre_std``, nominal rays).
    """
    return np.array([radians(0.25), radians(0.25), radians(0.5), centre_std, centre_std])


class NominalAxes(NamedTuple):
    """The three axes as nominal rays.

    Parameters
    ----------
    ray
        Unit vectors (3, 3), a row per axis.
    slopes
        Their derivatives (3, 8, 3) with respect to the rotation vector (3) and the slack (5).
    """

    ray: FloatArray
    slopes: FloatArray


class RightAngles(NamedTuple):
    """Three right-angled axes fitted to a picture's lines at one focal length.

    Parameters
    ----------
    score
        Log-likelihood ratio against stray lines, with the prior of the slack.
    rotation
        Rotation (3, 3) from the axes (along, across, down) to the optical frame.
    slack
        Deviations (5,), in the order of `slack_std`.
    """

    score: float
    rotation: FloatArray
    slack: FloatArray


@compiled
def _nominal_axes(rotation: FloatArray, slack: FloatArray, focal_ratio: float) -> NominalAxes:
    axes, slopes = np.empty((N_AXES, 3)), np.zeros((N_AXES, N_PARAMETERS, 3))
    for i in range(3):
        axes[0, i] = rotation[i, 0] + slack[0] * rotation[i, 2]
        axes[1, i] = rotation[i, 1] + slack[1] * rotation[i, 2] + slack[2] * rotation[i, 0]
        axes[2, i] = rotation[i, 2]
        slopes[0, 3, i] = rotation[i, 2]
        slopes[1, 4, i] = rotation[i, 2]
        slopes[1, 5, i] = rotation[i, 0]
    for k in range(N_AXES):
        for p in range(N_TURN):  # e_p x d
            slopes[k, p, (p + 1) % 3] = -axes[k, (p + 2) % 3]
            slopes[k, p, (p + 2) % 3] = axes[k, (p + 1) % 3]
    for k in range(N_AXES):
        depth = axes[k, 2]
        axes[k, 0] = focal_ratio * axes[k, 0] + slack[3] * depth
        axes[k, 1] = focal_ratio * axes[k, 1] + slack[4] * depth
        size = sqrt(axes[k, 0] ** 2 + axes[k, 1] ** 2 + depth * depth)
        for i in range(3):
            axes[k, i] /= size
        for p in range(N_PARAMETERS):
            z = slopes[k, p, 2]
            x = focal_ratio * slopes[k, p, 0] + slack[3] * z
            y = focal_ratio * slopes[k, p, 1] + slack[4] * z
            if p == 6:
                x = depth
            if p == 7:
                y = depth
            along = x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2]
            slopes[k, p, 0] = (x - along * axes[k, 0]) / size
            slopes[k, p, 1] = (y - along * axes[k, 1]) / size
            slopes[k, p, 2] = (z - along * axes[k, 2]) / size
    return NominalAxes(axes, slopes)


@compiled
def _log_likelihood(
    lines: LineGeometry,
    direction_std: FloatArray,
    axes: NominalAxes,
    extra_std: float,
    H: FloatArray,
    g: FloatArray,
) -> float:
    """Return the log-likelihood ratio against stray lines; fill H (lower half) and g with the normal equations.

    Densities are those of a line's direction in the picture; each line enters the normal equations of an axis with
    its responsibility. ``direction_std`` (n,) is the standard deviation of each line's direction.
    """
    normal, centre, direction, sigma = lines.normal, lines.centre, lines.direction, lines.sigma_rad
    ray, slopes = axes.ray, axes.slopes
    H[:] = 0.0
    g[:] = 0.0
    residual = np.empty(N_AXES)
    variance = np.empty(N_AXES)
    density = np.empty(N_AXES)
    slope = np.empty(N_PARAMETERS)
    score = 0.0
    for i in range(len(sigma)):
        total = STRAY_SHARE
        for k in range(N_AXES):
            x = ray[k, 0]
            y = ray[k, 1]
            z = ray[k, 2]
            alpha = centre[i, 0] * x + centre[i, 1] * y + centre[i, 2] * z
            beta = direction[i, 0] * x + direction[i, 1] * y + direction[i, 2] * z
            r = normal[i, 0] * x + normal[i, 1] * y + normal[i, 2] * z
            v = (
                (sigma[i] * alpha) ** 2
                + (direction_std[i] * beta) ** 2
                + PARALLEL_STD_RAD[k] ** 2
                + extra_std**2
            )
            residual[k] = r
            variance[k] = v
            density[k] = 0.0
            if r * r < MAX_Z2 * v:
                density[k] = SHARE[k] * UNIFORM * max(abs(beta), 1e-3) / sqrt(v) * exp(-0.5 * r * r / v)
            total += density[k]
        score += log(total)
        for k in range(N_AXES):
            w = density[k] / total
            if w < MIN_RESPONSIBILITY:
                continue
            w /= CORRELATION * variance[k]
            for p in range(N_PARAMETERS):
                slope[p] = (
                    normal[i, 0] * slopes[k, p, 0]
                    + normal[i, 1] * slopes[k, p, 1]
                    + normal[i, 2] * slopes[k, p, 2]
                )
            for p in range(N_PARAMETERS):
                g[p] += w * slope[p] * residual[k]
                for o in range(p + 1):
                    H[p, o] += w * slope[p] * slope[o]
    return score / CORRELATION


@compiled
def _solve(H: FloatArray, g: FloatArray, x: FloatArray) -> None:
    """Solve H x = g by Cholesky, H given by its lower half and overwritten."""
    n = len(g)
    for i in range(n):
        for j in range(i + 1):
            t = H[i, j]
            for k in range(j):
                t -= H[i, k] * H[j, k]
            H[i, j] = sqrt(max(t, 1e-12)) if i == j else t / H[j, j]
    for i in range(n):
        t = g[i]
        for k in range(i):
            t -= H[i, k] * x[k]
        x[i] = t / H[i, i]
    for i in range(n - 1, -1, -1):
        t = x[i]
        for k in range(i + 1, n):
            t -= H[k, i] * x[k]
        x[i] = t / H[i, i]


@compiled_inner
def _turn(rotation: FloatArray, x: float, y: float, z: float) -> None:
    """Rotate the columns of a rotation matrix in place by a rotation vector (Rodrigues' formula)."""
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return
    c = cos(angle)
    s = sin(angle)
    x /= angle
    y /= angle
    z /= angle
    for j in range(3):
        a = rotation[0, j]
        b = rotation[1, j]
        d = rotation[2, j]
        along = (x * a + y * b + z * d) * (1.0 - c)
        rotation[0, j] = a * c + (y * d - z * b) * s + x * along
        rotation[1, j] = b * c + (z * a - x * d) * s + y * along
        rotation[2, j] = d * c + (x * b - y * a) * s + z * along


@compiled
def fit_right_angles(
    lines: LineGeometry,
    direction_std: FloatArray,
    focal_ratio: float,
    slack_stds: FloatArray,
    start: RightAngles,
    start_std: float,
) -> RightAngles:
    """Fit three orthogonal axes to the lines at one focal length.

    Parameters
    ----------
    lines
        The picture's lines, for the nominal camera, optical frame.
    direction_std
        Standard deviation (n,) of each line's direction, radians.
    focal_ratio
        Focal length over the nominal one.
    slack_stds
        Standard deviations (5,) of the slack, see `slack_std`.
    start
        Axes to start from; their score is not used.
    start_std
        Standard deviation of the start's error, radians; it widens the residuals at first.
    """
    rotation, slack = start.rotation.copy(), start.slack.copy()
    H = np.empty((N_PARAMETERS, N_PARAMETERS))
    g = np.empty(N_PARAMETERS)
    x = np.empty(N_PARAMETERS)
    extra = start_std
    for _ in range(MAX_STEPS):
        _log_likelihood(lines, direction_std, _nominal_axes(rotation, slack, focal_ratio), extra, H, g)
        for p in range(N_TURN):
            H[p, p] += 1.0 / TURN_STD_RAD**2
        for p in range(N_SLACK):
            H[N_TURN + p, N_TURN + p] += 1.0 / slack_stds[p] ** 2
            g[N_TURN + p] += slack[p] / slack_stds[p] ** 2
        _solve(H, g, x)
        turned = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        shorter = min(1.0, MAX_TURN_RAD / max(turned, 1e-12))
        _turn(rotation, -x[0] * shorter, -x[1] * shorter, -x[2] * shorter)
        for p in range(N_SLACK):
            slack[p] -= x[N_TURN + p] * shorter
        if extra == 0.0 and turned < 1e-5:
            break
        extra = extra * 0.5 if extra > LAST_EXTRA_RAD else 0.0
    score = _log_likelihood(lines, direction_std, _nominal_axes(rotation, slack, focal_ratio), 0.0, H, g)
    for p in range(N_SLACK):
        score -= 0.5 * (slack[p] / slack_stds[p]) ** 2
    return RightAngles(score, rotation, slack)
