r"""The lateral offset as a Gaussian sum: several places at once, until time and motion tell which is right.

A frame seldom leaves one offset (`vision.lateral.mixture`). So the filter carries a sum of Gaussians (D. L. Alspach,
H. W. Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE Transactions on Automatic
Control 17(4), 1972) and the probability that the offset is unknown. Each hypothesis is a state (4,) ``[y, v, c, s]``:

- y: offset right of the centre line, half widths;
- v: its rate, half widths per second;
- c: the accelerometer's bias across the corridor, half widths per second squared;
- s: one over the half width, 1/m.

**Process.** With the acceleration a across the corridor, m/s^2, from the specific force f levelled by roll and
pitch::

    a  = sin(psi) f_forward + cos(psi) f_right
    y' = v        v' = a s - c + s n_v        c' = s n_c        s' = 0

which is linear in the state, as s multiplies what is measured: with A1 and A2 the single and double integral of a
over T, one transition serves all hypotheses, and a sample of the accelerometer costs a few additions::

        [ 1  T  -T^2/2  A2 ]
    F = [ 0  1  -T      A1 ]
        [ 0  0   1      0  ]
        [ 0  0   0      1  ]

Where there is no accelerometer, or one that vibrates so much that it tells less than nothing would, v is a
Gauss-Markov process instead, as long as the silence lasts. A velocity stream's speed w across the corridor is a
measurement of v: ``0 = v - w s``.

**Evidence.** A frame's likelihood of the offset is ``p(y) = e / 2 + sum_j w_j N(o_j; y, sigma_j^2)``, with e the
probability that it cannot tell. Errors of successive frames resemble each other, so a frame that follows the last one
after dt counts as a part ``1 - exp(-dt / tau)`` of one: the hypotheses' weights are multiplied by that power of the
likelihood, and the variances of the update are divided by it (with a longer tau, as what is shared by frames of one
hypothesis, a line taken for the corner that lies beside it, lasts longer). Within a hypothesis, components are
weighed by probabilistic data association (Y. Bar-Shalom, E. Tse, "Tracking in a cluttered environment with
probabilistic data association", Automatica 11(5), 1975). The unknown offset is uniform over (-1, 1), hence its
likelihood is 1/2; what it holds moves to new hypotheses at the components that none explains. A little is always
forgotten: weight leaks from all hypotheses to the unknown.

**Reported** is the sum of those about the likeliest; it is known where it holds most of the probability and is
narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, exp, expm1, hypot, isfinite, nan, sin, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.lateral_kernels import (
    C,
    N_LATERAL,
    S,
    V,
    Y,
    FloatArray,
    absorb,
    associate,
    corrected,
    merged,
    moved,
)
from vision.lateral.mixture import OffsetMixture, combine

MAX_HYPOTHESES = 15


class OffsetModel(NamedTuple):
    """What the filter assumes; lengths in metres unless they are said to be in half widths (``norm``)."""

    accel_noise: float = (
        0.08  # m/s/sqrt(s), beyond what the accelerometer itself shows: tilt that comes and goes
    )
    accel_bias_std: float = 0.12  # m/s^2
    accel_bias_walk: float = 0.05  # m/s^2/sqrt(s): the attitude's slow errors
    rough_limit: float = 0.35  # m/s/sqrt(s) of noise from which on an accelerometer is worth nothing
    velocity_std_m_s: float = 0.3  # without accelerometer
    velocity_time_s: float = 1.0
    start_velocity_std_m_s: float = 0.4
    inverse_half_width: tuple[float, float] = (
        0.9,
        0.3,
    )  # 1/m, mean and standard deviation where it is not told
    weight_time_s: float = 0.15
    state_time_s: float = 0.5
    forget_1_s: float = 0.03
    slack_norm: float = 0.02
    near_norm: float = 0.05  # hypotheses nearer than this are one
    cluster_norm: float = 0.1
    known_probability: float = 0.9
    known_std_norm: float = 0.12
    lost_std_norm: float = 0.5


class Path(NamedTuple):
    """Motion since the hypotheses' time: seconds, of which with accelerometer, and integrals of the acceleration.

    ``noise`` is the integral of the accelerometer's noise density squared.
    """

    t_s: float = 0.0
    accel_s: float = 0.0
    a1: float = 0.0
    a2: float = 0.0
    noise: float = 0.0


class Roughness(NamedTuple):
    """How much successive samples of the acceleration across the corridor differ, as a noise density squared."""

    last: float = nan
    density2: float = 0.0
    n: int = 0


class RollCorrection(NamedTuple):
    """How far the frames' vertical lines lie right of the attitude's vertical, rad: mean and variance."""

    mean: float = 0.0
    variance: float = 0.01**2


class OffsetState(NamedTuple):
    """Immutable; its arrays are never written into.

    ``weight`` (k + 1,) sums to one and ends with that of the unknown.
    """

    x: FloatArray
    P: FloatArray
    weight: FloatArray
    path: Path = Path()
    rough: Roughness = Roughness()
    roll: RollCorrection = RollCorrection()
    evidence_age_s: float = nan  # since a frame supported the likeliest hypothesis
    frame_age_s: float = nan
    surprise: float = 1.0  # mean normalised innovation squared of the likeliest


class OffsetReadout(NamedTuple):
    """The offset at the state's time, its rate, the probability of its hypothesis, whether it may be relied on."""

    offset_norm: float
    std_norm: float
    velocity_norm_s: float
    velocity_std_norm_s: float
    probability: float
    known: bool
    evidence_age_s: float


def nothing_known() -> OffsetState:
    """Return the state before any frame."""
    return OffsetState(np.zeros((0, N_LATERAL)), np.zeros((0, N_LATERAL, N_LATERAL)), np.ones(1))


def in_new_corridor(state: OffsetState) -> OffsetState:
    """Forget the offset and its rate; what is known of the accelerometer stays."""
    # The bias across the corridor is another one there: it is that of the tilt and of both axes.
    return nothing_known()._replace(rough=state.rough, roll=state.roll)


def levelled(
    force: tuple[float, float, float], down: tuple[float, float, float], roll_rad: float
) -> tuple[float, float]:
    """Specific force forward and right in the level frame, m/s^2.

    Parameters
    ----------
    force
        Body FRD.
    down
        Unit vector of gravity's direction in the body.
    roll_rad
        Further roll of the level frame by which the frames' verticals correct it.
    """
    dx, dy, dz = down
    fx, fy, fz = force
    horizontal = max(sqrt(dy * dy + dz * dz), 0.09)
    right = (dz * fy - dy * fz) / horizontal
    along = dx * fx + dy * fy + dz * fz
    forward = (fx - dx * along) / horizontal
    return forward, right - roll_rad * along


def propagate(
    state: OffsetState,
    dt_s: float,
    heading_rad: float,
    force: tuple[float, float, float] | None,
    down: tuple[float, float, float],
) -> OffsetState:
    """Carry the state on by ``dt_s`` with the accelerometer's sample at its end; None: there is none."""
    path, rough = state.path, state.rough
    t, accel_s, a1, a2, noise = path
    age, frame_age = state.evidence_age_s + dt_s, state.frame_age_s + dt_s
    if force is None:
        path = Path(t + dt_s, accel_s, a1, a2 + a1 * dt_s, noise)
        return state._replace(path=path, evidence_age_s=age, frame_age_s=frame_age)
    forward, right = levelled(force, down, state.roll.mean)
    a = sin(heading_rad) * forward + cos(heading_rad) * right
    last, density2, n = rough
    mean = a
    if n:
        mean = 0.5 * (a + last)
        n = min(n + 1, 100)
        density2 += (0.5 * (a - last) ** 2 * dt_s - density2) / n
    else:
        n = 1
    path = Path(
        t + dt_s,
        accel_s + dt_s,
        a1 + mean * dt_s,
        a2 + (a1 + 0.5 * mean * dt_s) * dt_s,
        noise + density2 * dt_s,
    )
    return state._replace(
        path=path, rough=Roughness(a, density2, n), evidence_age_s=age, frame_age_s=frame_age
    )


def transition(path: Path, model: OffsetModel, surprise: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return F (4, 4) and Q (4, 4), the latter in metres: over s squared."""
    t = path.t_s
    F, Q = np.eye(N_LATERAL), np.zeros((N_LATERAL, N_LATERAL))
    if not t > 0.0:
        return F, Q
    n2 = path.noise / t + model.accel_noise**2
    b2 = model.accel_bias_walk**2
    if path.accel_s < 0.9 * t or n2 > model.rough_limit**2:
        tau, std = model.velocity_time_s, model.velocity_std_m_s
        x = t / tau
        fall = -expm1(-x)
        F[Y, V], F[V, V] = tau * fall, exp(-x)
        yy = 2 * x - 2 * fall - fall * fall if x > 0.05 else x**3 * (2 / 3 - x / 2)
        Q[Y, Y] = (std * tau) ** 2 * yy
        Q[Y, V] = Q[V, Y] = std**2 * tau * fall * fall
        Q[V, V] = -(std**2) * expm1(-2 * x)
        Q[C, C] = b2 * t
        return F, Q
    F[Y, V], F[Y, C], F[Y, S] = t, -0.5 * t * t, path.a2
    F[V, C], F[V, S] = -t, path.a1
    n2 *= surprise
    Q[Y, Y] = n2 * t**3 / 3 + b2 * t**5 / 20
    Q[Y, V] = Q[V, Y] = n2 * t**2 / 2 + b2 * t**4 / 8
    Q[V, V] = n2 * t + b2 * t**3 / 3
    Q[Y, C] = Q[C, Y] = -b2 * t**3 / 6
    Q[V, C] = Q[C, V] = -b2 * t**2 / 2
    Q[C, C] = b2 * t
    return F, Q


def at_path_end(state: OffsetState, model: OffsetModel) -> OffsetState:
    """Carry the hypotheses to the state's time."""
    if not state.path.t_s > 0.0:
        return state
    F, Q = transition(state.path, model, state.surprise)
    x, P = np.empty_like(state.x), np.empty_like(state.P)
    moved(state.x, state.P, F, Q, x, P)
    return state._replace(x=x, P=P, path=Path())


def with_roll(state: OffsetState, roll_rad: float, std_rad: float, dt_s: float) -> OffsetState:
    """Take in how far a frame's vertical lines lie right of the attitude's vertical."""
    mean, variance = state.roll
    variance = variance + ROLL_WALK**2 * max(dt_s, 0.0)
    gain = variance / (variance + std_rad**2 / (1.0 - exp(-max(dt_s, 0.02) / ROLL_TIME_S)))
    return state._replace(roll=RollCorrection(mean + gain * (roll_rad - mean), (1.0 - gain) * variance))


ROLL_WALK = 0.006  # rad/sqrt(s)
ROLL_TIME_S = 0.3


class Camera(NamedTuple):
    """How a frame's offset follows from the body's: side (-1: the vehicle flies against the axis), metres aside."""

    side: float = 1.0
    aside_m: float = 0.0


def update(
    state: OffsetState, evidence: Sequence[OffsetMixture], camera: Camera, model: OffsetModel, dt_s: float
) -> OffsetState:
    """Take in what a frame says of the offset; ``dt_s`` is the time since the frame before."""
    state = at_path_end(state, model)
    if not evidence:
        return state._replace(frame_age_s=0.0)
    mixture = evidence[0]
    for other in evidence[1:]:
        mixture = combine(mixture, other)
    components = np.column_stack([mixture.weight, mixture.offset_norm, mixture.std_norm**2])
    dt_s = min(dt_s, 1.0) if isfinite(dt_s) else 1.0
    temper = -expm1(-dt_s / model.weight_time_s)
    inflation = -1.0 / expm1(-dt_s / model.state_time_s)
    x, P, weight = state.x.copy(), state.P.copy(), state.weight.copy()
    H = np.array([camera.side, 0.0, 0.0, camera.aside_m])
    nis = associate(x, P, weight, components, H, model.slack_norm**2, temper, inflation)
    weight /= weight.sum()
    forgotten = -expm1(-dt_s * model.forget_1_s) * weight[:-1]
    weight[:-1] -= forgotten
    weight[-1] += forgotten.sum()
    x, P, weight = _with_new(x, P, weight, components, camera, model, temper)
    x, P, weight = _reduced(x, P, weight, model)
    age, surprise = state.evidence_age_s, state.surprise
    if isfinite(nis):
        age = 0.0
        surprise += 0.05 * (min(nis, 9.0) - surprise)
    return state._replace(
        x=x, P=P, weight=weight, evidence_age_s=age, frame_age_s=0.0, surprise=max(1.0, surprise)
    )


def _with_new(
    x: FloatArray,
    P: FloatArray,
    weight: FloatArray,
    components: FloatArray,
    camera: Camera,
    model: OffsetModel,
    temper: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Let the unknown's weight move to the components, as new hypotheses where none explains them."""
    s, s_std = model.inverse_half_width
    unknown = weight[-1] * temper
    new_x, new_P, new_weight = [], [], []
    for w, o, variance in components.tolist():
        mass = unknown * w
        weight[-1] -= mass
        y = camera.side * (o - camera.aside_m * s)
        variance += (camera.aside_m * s_std) ** 2 + model.slack_norm**2
        if absorb(x, P, weight[:-1], y, variance, mass, model.near_norm):
            continue
        new_x.append((y, 0.0, 0.0, s))
        new_P.append(
            np.diag(
                [variance, (model.start_velocity_std_m_s * s) ** 2, (model.accel_bias_std * s) ** 2, s_std**2]
            )
        )
        new_weight.append(mass)
    if not new_x:
        return x, P, weight
    return (
        np.concatenate([x, np.array(new_x)]),
        np.concatenate([P, np.array(new_P)]),
        np.concatenate([weight[:-1], new_weight, weight[-1:]]),
    )


def _reduced(
    x: FloatArray, P: FloatArray, weight: FloatArray, model: OffsetModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Merge what has become one and drop what hardly counts; what they held is unknown."""
    known = weight[:-1].copy()
    known[(P[:, Y, Y] > model.lost_std_norm**2) | (np.abs(x[:, Y]) > 1.2)] = 0.0
    order = np.argsort(-known, kind="stable")
    keep = np.empty(len(x), np.int64)
    keep = keep[: merged(x, P, known, order, model.near_norm, keep)]
    keep = keep[np.argsort(-known[keep], kind="stable")][:MAX_HYPOTHESES]
    keep = keep[known[keep] > 1e-4]
    left = known[keep]
    return x[keep], P[keep], np.append(left, max(1.0 - left.sum(), 0.0))


def readout(state: OffsetState, model: OffsetModel) -> OffsetReadout:
    """Report the offset at the state's time."""
    if not len(state.x):
        return OffsetReadout(nan, nan, nan, nan, 0.0, False, nan)
    F, Q = transition(state.path, model, state.surprise)
    best = int(np.argmax(state.weight[:-1]))
    near = np.abs(state.x[:, Y] - state.x[best, Y]) < model.cluster_norm
    weight = state.weight[:-1][near]
    probability = float(weight.sum())
    x, P = state.x[near], state.P[near]
    x_out, P_out = np.empty_like(x), np.empty_like(P)
    moved(x, P, F, Q, x_out, P_out)
    share = weight / probability
    mean = share @ x_out
    apart = x_out - mean
    y_var = float(share @ (P_out[:, Y, Y] + apart[:, Y] ** 2))
    v_var = float(share @ (P_out[:, V, V] + apart[:, V] ** 2))
    std = sqrt(y_var)
    known = probability > model.known_probability and std < model.known_std_norm
    return OffsetReadout(
        float(mean[Y]), std, float(mean[V]), sqrt(v_var), probability, known, state.evidence_age_s
    )
