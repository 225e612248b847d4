"""How well three directions at right angles explain a picture's lines, if its focal length were so and so.

Corridor lines, transverse lines and door posts meet in three vanishing points. The points alone say nothing of the
focal length; that the directions towards them are at right angles does, as soon as the camera pitches, or turns while
something transverse is seen. The fit lives in nominal rays, those of a camera of a fixed, assumed focal length:
the lines and their tolerances stay what they are whatever focal length is tried, so that a picture that
cannot tell gives the same score to all.

Buildings are not exact, and neither is the assumption that the optical axis passes through the picture's centre. So
each picture may take a little slack, at the price of its prior: `SLACK_STD`.
"""

from __future__ import annotations

from math import cos, exp, log, radians, sin, sqrt

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]

N_AXES = 3  # along the corridor, across it, down: columns of a rotation, optical frame
N_TURN, N_SLACK = 3, 5
N_PARAMETERS = N_TURN + N_SLACK

CENTRE_STD_OF_SIDE = 0.01  # of the optical axis from the centre, over the longer side
SHARE = np.array([0.30, 0.12, 0.25])  # of the lines, expected along each axis
STRAY_SHARE = 1.0 - float(SHARE.sum())
PARALLEL_STD_RAD = np.array(
    [radians(0.10), radians(0.15), radians(0.15)]
)  # lines along an axis are parallel to this
CORRELATION = 2.0  # the edges of one door or board err together: so many lines speak as one
UNIFORM = (
    1.2533  # density of a Gaussian's peak over that of any direction within half a turn: pi / sqrt(2 pi)
)
MAX_Z2 = 40.0
MIN_RESPONSIBILITY = 1e-3
LAST_EXTRA_RAD = radians(0.02)  # the start's tolerance is halved until it is below the lines' own
MAX_STEPS = 14
TURN_STD_RAD = 6.0  # keeps the equations solvable where no line holds a direction
MAX_TURN_RAD = 0.1


def slack_std(centre_std: float) -> FloatArray:
    """Give the standard deviations (5,) of a picture's slack.

    In this order: slope of the corridor against the posts, slope of the transverse lines, squareness of the walls
    (radians); place of the optical axis right and down of the picture's centre (``centre_std``, nominal rays).
    """
    return np.array([radians(0.25), radians(0.25), radians(0.5), centre_std, centre_std])


@compiled
def _point_axes(
    rotation: FloatArray, slack: FloatArray, stretch: float, axes: FloatArray, slopes: FloatArray
) -> None:
    """Fill the axes' nominal rays (3, 3), one per row, and their derivatives (3, 8, 3) by turn and slack."""
    slopes[:] = 0.0
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
        axes[k, 0] = stretch * axes[k, 0] + slack[3] * depth
        axes[k, 1] = stretch * axes[k, 1] + slack[4] * depth
        size = sqrt(axes[k, 0] ** 2 + axes[k, 1] ** 2 + depth * depth)
        for i in range(3):
            axes[k, i] /= size
        for p in range(N_PARAMETERS):
            z = slopes[k, p, 2]
            x = stretch * slopes[k, p, 0] + slack[3] * z
            y = stretch * slopes[k, p, 1] + slack[4] * z
            if p == 6:
                x = depth
            if p == 7:
                y = depth
            along = x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2]
            slopes[k, p, 0] = (x - along * axes[k, 0]) / size
            slopes[k, p, 1] = (y - along * axes[k, 1]) / size
            slopes[k, p, 2] = (z - along * axes[k, 2]) / size


@compiled
def _weigh(
    normal: FloatArray,
    centre: FloatArray,
    direction: FloatArray,
    sigma: FloatArray,
    swing: FloatArray,
    axes: FloatArray,
    slopes: FloatArray,
    extra_std: float,
    H: FloatArray,
    g: FloatArray,
) -> float:
    """Log-likelihood of the lines over stray ones; H (lower half) and g become Gauss-Newton's equations.

    A line runs along each axis with its share's probability, or anywhere. Likelihoods are densities of its direction
    in the picture. ``swing``: standard deviation of a line's direction.
    """
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
            x = axes[k, 0]
            y = axes[k, 1]
            z = axes[k, 2]
            alpha = centre[i, 0] * x + centre[i, 1] * y + centre[i, 2] * z
            beta = direction[i, 0] * x + direction[i, 1] * y + direction[i, 2] * z
            r = normal[i, 0] * x + normal[i, 1] * y + normal[i, 2] * z
            v = (sigma[i] * alpha) ** 2 + (swing[i] * beta) ** 2 + PARALLEL_STD_RAD[k] ** 2 + extra_std**2
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


@compiled
def _turn(rotation: FloatArray, x: float, y: float, z: float) -> None:
    """Turn the columns of a rotation by a rotation vector (Rodrigues)."""
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
    normal: FloatArray,
    centre: FloatArray,
    direction: FloatArray,
    sigma: FloatArray,
    swing: FloatArray,
    stretch: float,
    spread: FloatArray,
    start_std: float,
    rotation: FloatArray,
    slack: FloatArray,
) -> float:
    """Turn three right-angled axes until they explain the lines best; return the log-likelihood over stray lines.

    Parameters
    ----------
    normal, centre, direction, sigma
        Of the lines, as in `vision.lines.segments.LineSet`, for the nominal camera.
    swing
        Standard deviation (n,) of each line's direction, radians.
    stretch
        The focal length to try, over the nominal one.
    spread
        `slack_std`.
    start_std
        How far the axes may be from where they start, radians.
    rotation, slack
        Where to start, (3, 3) and (5,); they become the fit.
    """
    axes = np.empty((N_AXES, 3))
    slopes = np.empty((N_AXES, N_PARAMETERS, 3))
    H = np.empty((N_PARAMETERS, N_PARAMETERS))
    g = np.empty(N_PARAMETERS)
    x = np.empty(N_PARAMETERS)
    extra = start_std
    for _ in range(MAX_STEPS):
        _point_axes(rotation, slack, stretch, axes, slopes)
        _weigh(normal, centre, direction, sigma, swing, axes, slopes, extra, H, g)
        for p in range(N_TURN):
            H[p, p] += 1.0 / TURN_STD_RAD**2
        for p in range(N_SLACK):
            H[N_TURN + p, N_TURN + p] += 1.0 / spread[p] ** 2
            g[N_TURN + p] += slack[p] / spread[p] ** 2
        _solve(H, g, x)
        turned = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        shorter = min(1.0, MAX_TURN_RAD / max(turned, 1e-12))
        _turn(rotation, -x[0] * shorter, -x[1] * shorter, -x[2] * shorter)
        for p in range(N_SLACK):
            slack[p] -= x[N_TURN + p] * shorter
        if extra == 0.0 and turned < 1e-5:
            break
        extra = extra * 0.5 if extra > LAST_EXTRA_RAD else 0.0
    _point_axes(rotation, slack, stretch, axes, slopes)
    score = _weigh(normal, centre, direction, sigma, swing, axes, slopes, 0.0, H, g)
    for p in range(N_SLACK):
        score -= 0.5 * (slack[p] / spread[p]) ** 2
    return score
