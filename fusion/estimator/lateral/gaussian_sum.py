r"""Gaussian-sum filter of the lateral offset: several hypotheses, weighted by frames and motion.

A frame's likelihood of the offset usually has several peaks (`vision.lateral.mixture`). So the posterior is a sum of
Gaussians (D. L. Alspach, H. W. Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE
Transactions on Automatic Control 17(4), 1972) and the probability that the offset is unknown. Each hypothesis has a
mean and covariance of the state (4,) ``[y, v, c, s]``:

- y: offset right of the centre line, half widths;
- v: its rate, half widths per second;
- c: the accelerometer's bias across the corridor, half widths per second squared;
- s: one over the half width, 1/m.

**Process model.** With the acceleration a across the corridor, m/s^2, from the specific force f levelled by roll and
pitch::

    a  = sin(psi) f_forward + cos(psi) f_right
    y' = v        v' = a s - c + n_v        c' = n_c        s' = 0

This is linear in the state, because s multiplies the measured acceleration. With A1 and A2 the single and double
integral of a over the time T, all hypotheses share one transition, and an accelerometer sample costs a few
additions::

        [ 1  T  -T^2/2  A2 ]
    F = [ 0  1  -T      A1 ]
        [ 0  0   1      0  ]
        [ 0  0   0      1  ]

If the accelerometer corrects the tilt, because there is no attitude stream, the tilt leans after the accelerations
themselves: the measured a is the true one without its slow part, k / (s + k) for the gain k = 0.4/s, and c, which
contains the difference, walks faster (``leaning_walk``, about k sigma_a sqrt(2 tau_a) for accelerations of
0.4 m/s^2 that last for a second). Without an accelerometer, or if its noise exceeds `OffsetModel.rough_limit`, v is a
Gauss-Markov process instead. The speed w across the corridor from a velocity stream is a measurement of v:
``0 = v - w s``; its variance is inflated if the innovation is beyond `SPEED_SIGMA`.

**Measurement update.** A frame's likelihood of the offset is ``p(y) = e / 2 + sum_j w_j N(o_j; y, sigma_j^2)``, with
e the probability that the frame cannot tell. Errors of successive frames are correlated, so a frame that follows the
last one after dt counts as the part ``a = 1 - exp(-dt / tau)`` of an independent one: the hypotheses' weights are
multiplied by the likelihood to the power of a (tau = ``weight_time_s``), and the variances of the state update are
divided by a (tau = ``state_time_s``). Within a hypothesis, components are weighted by probabilistic data association
(Y. Bar-Shalom, E. Tse, "Tracking in a cluttered environment with probabilistic data association", Automatica 11(5),
1975). The unknown offset is uniform over (-1, 1), so its likelihood is 1/2; its weight moves to new hypotheses at
components that no hypothesis explains. A forgetting factor moves weight from all hypotheses back to the unknown.

**Output.** The mean and variance of the hypotheses within ``tolerance_norm`` of the most probable one are reported;
the offset is known if they contain most of the probability and are narrow. A line beside a corner that is mistaken
for the corner stays for seconds, and averaging over frames does not reduce that error. Two variances are therefore
added to the output, and not fed back to the filter: ``(s_y y)^2``, since lines inside or outside both corners make
the corridor look narrower or wider, and ``s_l^2 u^2``, with u^2 the second moment of the frames' likelihoods about
the most probable hypothesis, averaged over seconds: it is large if single frames are ambiguous or contradict the
fused offset. On simulated corridors u separates wrong from right offsets better than the variance of the hypotheses
or the difference between floor and ceiling. The error has long tails where u is large: half of the errors stay below
``s_l u``, which the probability uses, while their root mean square, and so the reported sigma, is
``max(s_l u, s_t (u - u_0))``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from math import cos, exp, expm1, isfinite, nan, sin, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import NO_FORCE
from fusion.estimator.lateral.kernels import (
    N_LATERAL,
    MotionNoise,
    S,
    Y,
    correct_all,
    extended_path,
    fill_transition,
    propagated_along,
)
from fusion.estimator.lateral.mixture_kernels import summarised, update_with_frame
from fusion.estimator.records import new_record
from vision.lateral.mixture import OffsetMixture, combine
from vision.types import FloatArray

MAX_HYPOTHESES = 15
MIN_WEIGHT = 1e-4
MAX_OFFSET = 1.2  # beyond the walls
MIN_CANNOT_TELL = 0.15  # lower bound of e for each kind of evidence: frames are overconfident
FIRST_FRAME_S = 0.3  # largest dt: a single frame never counts as more than this part of one
START_SPREAD_NORM = 0.05  # u before the first frame
CORNERS_AHEAD = 4.0  # half widths; usual distance at which the corners are seen that give the offset
SUPPORTED = 0.5  # association probability above which a frame confirms the most probable hypothesis
ROLL_WALK = 0.006  # rad/sqrt(s); random walk of the attitude's roll error
SPEED_SIGMA = 3.0  # innovations of a velocity beyond this have their variance inflated
ROLL_TIME_S = 0.3  # correlation time of the errors of the frames' verticals


class OffsetModel(NamedTuple):
    """Parameters of the filter; lengths in metres, or in half widths for names with ``norm``."""

    accel_noise: float = 0.09  # m/s/sqrt(s); tilt errors, added to the accelerometer's measured noise
    accel_bias_std: float = 0.15  # m/s^2
    accel_bias_walk: float = 0.03  # m/s^2/sqrt(s); slow errors of the attitude
    leaning_walk: float = 0.2  # m/s^2/sqrt(s); the same of a tilt that the accelerometer corrects
    rough_limit: float = 0.17  # m/s/sqrt(s); an accelerometer with more noise is not used
    velocity_std_m_s: float = 0.3  # without accelerometer
    velocity_time_s: float = 1.0
    start_velocity_std_m_s: float = 0.4
    inverse_half_width: tuple[float, float] = (0.95, 0.25)  # 1/m; mean and sigma in an unknown corridor
    weight_time_s: float = 0.26
    state_time_s: float = 0.05
    displacement_time_s: float = 2.0  # tau for displacements by parallax: errors of the axis last for seconds
    forgotten: float = 0.08  # share of all weights that one independent frame moves to the unknown
    forget_1_s: float = 0.3  # rate of the same between frames
    slack_norm: float = 0.01  # model error added to every component's sigma
    spread_time_s: float = 1.5  # time constant of the average of u^2
    lasting_share: float = 0.4  # s_l
    tail_slope: float = 2.2  # s_t
    tail_from_norm: float = 0.04  # u_0
    scale_std: float = 0.05  # s_y: relative error of the corridor's width as the detected lines show it
    near_norm: float = 0.03  # hypotheses closer than this are merged
    tolerance_norm: float = 0.1
    known_probability: float = 0.9
    known_std_norm: float = 0.2
    lost_std_norm: float = 0.5


class Path(NamedTuple):
    """Motion since the hypotheses' time: duration, part of it with accelerometer, integrals A1 and A2.

    ``noise`` is the integral of the squared noise density of the accelerometer, ``leaning_s`` the time in
    which the accelerometer corrects the tilt.
    """

    t_s: float = 0.0
    accel_s: float = 0.0
    a1: float = 0.0
    a2: float = 0.0
    noise: float = 0.0
    leaning_s: float = 0.0

    def followed_by(self, on: Path) -> Path:
        """Return this path followed by another one."""
        return Path(
            self.t_s + on.t_s,
            self.accel_s + on.accel_s,
            self.a1 + on.a1,
            self.a2 + self.a1 * on.t_s + on.a2,
            self.noise + on.noise,
            self.leaning_s + on.leaning_s,
        )

    def since(self, start: Path) -> Path:
        """Return the rest of this path after its initial part ``start``."""
        t_s = self.t_s - start.t_s
        return Path(
            t_s,
            self.accel_s - start.accel_s,
            self.a1 - start.a1,
            self.a2 - start.a2 - start.a1 * t_s,
            self.noise - start.noise,
            self.leaning_s - start.leaning_s,
        )


class Acceleration(NamedTuple):
    """Acceleration across the corridor: last sample, m/s^2, its age, and the noise density.

    ``density2`` is the squared density of the white noise that explains the differences of successive samples,
    (m/s)^2/s; ``n`` counts samples.
    """

    last: float = nan
    age_s: float = 0.0
    density2: float = 0.0
    n: int = 0


class RollCorrection(NamedTuple):
    """Angle of the frames' vertical lines to the right of the attitude's vertical, rad: mean and variance."""

    mean: float = 0.0
    variance: float = 0.01**2


class OffsetState(NamedTuple):
    """The Gaussian sum; immutable, its arrays are never written to.

    ``weight`` (k + 1,) sums to one; its last element is the weight of the unknown.
    """

    x: FloatArray
    P: FloatArray
    weight: FloatArray
    path: Path = Path()
    accel: Acceleration = Acceleration()
    roll: RollCorrection = RollCorrection()
    spread2: float = START_SPREAD_NORM**2  # second moment of the frames' likelihoods, half widths squared
    evidence_age_s: float = nan  # since a frame confirmed the most probable hypothesis


class OffsetReadout(NamedTuple):
    """The offset at the state's time, its rate, the probability of its hypothesis, and whether it is reliable."""

    offset_norm: float
    std_norm: float
    velocity_norm_s: float
    velocity_std_norm_s: float
    probability: float
    known: bool
    evidence_age_s: float


def initial_offset_state() -> OffsetState:
    """Return the state before any frame."""
    return OffsetState(np.zeros((0, N_LATERAL)), np.zeros((0, N_LATERAL, N_LATERAL)), np.ones(1))


def in_new_corridor(state: OffsetState) -> OffsetState:
    """Forget the hypotheses; keep the accelerometer's noise and the roll correction."""
    # The bias across the corridor changes with the direction: it combines tilt and both accelerometer axes.
    return initial_offset_state()._replace(accel=state.accel, roll=state.roll)


def propagate(
    state: OffsetState,
    dt_s: float,
    heading_rad: float,
    force: tuple[float, float, float] | None,
    down: tuple[float, float, float],
    follows_force: bool = False,
) -> OffsetState:
    """Propagate by ``dt_s``, with the specific force at the end of the step; None without a sample.

    ``follows_force``: whether the accelerometer corrects the tilt ``down``.
    """
    x, P, weight, path, accel, roll, spread2, age_s = state
    longer, sample = extended_path(
        (*path,), (*accel,), dt_s, heading_rad, force or NO_FORCE, down, roll[0], float(follows_force)
    )
    path, accel = new_record(Path, longer), new_record(Acceleration, sample)
    return new_record(OffsetState, (x, P, weight, path, accel, roll, spread2, age_s + dt_s))


def transition(path: Path, model: OffsetModel, *, backward: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return F (4, 4) and Q (4, 4) of a path of non-zero length, or of its reversal if ``backward``.

    The noise is converted to half widths by the model's s, not by that of each hypothesis: a hypothesis of a wider
    corridor would otherwise have less noise and win for that reason alone.
    """
    F, Q = np.empty((N_LATERAL, N_LATERAL)), np.empty((N_LATERAL, N_LATERAL))
    fill_transition((*path,), motion_noise(model), backward, F, Q)
    return F, Q


def motion_noise(m: OffsetModel) -> MotionNoise:
    """Return the noise parameters that `fill_transition` takes from a model."""
    inverse, _ = m.inverse_half_width
    walks = (m.accel_noise, m.accel_bias_walk, m.leaning_walk)
    return inverse, *walks, m.rough_limit, m.velocity_std_m_s, m.velocity_time_s


def along_path(state: OffsetState, path: Path, model: OffsetModel, *, backward: bool = False) -> OffsetState:
    """Propagate the hypotheses along a path, or backward along it."""
    x, P = _propagated_along(state, path, model, backward)
    return state if x is state.x else state._replace(x=x, P=P)


def _propagated_along(
    state: OffsetState, path: Path, model: OffsetModel, backward: bool = False
) -> tuple[FloatArray, FloatArray]:
    if not path.t_s > 0.0 or not len(state.x):
        return state.x, state.P
    return propagated_along(state.x, state.P, (*path,), motion_noise(model), backward)


def at_path_end(state: OffsetState, model: OffsetModel) -> OffsetState:
    """Propagate the hypotheses to the state's time."""
    return along_path(state, state.path, model)._replace(path=Path())


def with_roll(state: OffsetState, roll_rad: float, std_rad: float, dt_s: float) -> OffsetState:
    """Update the roll correction by the angle of a frame's vertical lines to the attitude's vertical."""
    mean, variance = state.roll
    variance = variance + ROLL_WALK**2 * max(dt_s, 0.0)
    gain = variance / (variance + std_rad**2 / (1.0 - exp(-max(dt_s, 0.02) / ROLL_TIME_S)))
    return state._replace(roll=RollCorrection(mean + gain * (roll_rad - mean), (1.0 - gain) * variance))


class FrameEvidence(NamedTuple):
    """A frame's likelihood of the offset.

    Parameters
    ----------
    components
        Rows (m, 3) of weight, offset of the camera and variance, half widths; the weights sum to 1 - e.
    dt_s
        Time since the frame before, which gives the independent part of the frame.
    side
        1, or -1 if the vehicle flies against the axis, so that left and right are exchanged.
    aside_m
        Distance of the camera to the right of the body's centre, across the corridor, in the frame's direction.
    split_std_rad
        Sigma of the frame's heading due to a second direction near the axis, on which some of its lines agree.
    """

    components: FloatArray
    dt_s: float
    side: float = 1.0
    aside_m: float = 0.0
    split_std_rad: float = 0.0


def frame_evidence(
    mixtures: Sequence[OffsetMixture], dt_s: float, heading_rad: float, camera_arm_m: tuple[float, float]
) -> FrameEvidence:
    """Combine a frame's likelihoods from several kinds of evidence.

    Parameters
    ----------
    mixtures
        At least one likelihood.
    dt_s
        Time since the frame before; NaN for the first.
    heading_rad
        Heading of the vehicle from the corridor's axis, over the full circle.
    camera_arm_m
        Position of the camera ahead and right of the body's centre, metres.
    """
    mixture = reduce(combine, [m.less_sure(MIN_CANNOT_TELL) for m in mixtures])
    side = 1.0 if cos(heading_rad) >= 0.0 else -1.0
    ahead_m, right_m = camera_arm_m
    aside_m = side * (ahead_m * sin(heading_rad) + right_m * cos(heading_rad))
    components = np.column_stack([mixture.weight, mixture.offset_norm, mixture.std_norm**2])
    return FrameEvidence(components, dt_s if isfinite(dt_s) else FIRST_FRAME_S, side, aside_m)


def with_speed(state: OffsetState, across_m_s: float, variance: float) -> OffsetState:
    """Update with a speed across the corridor, positive right, with its variance, (m/s)^2."""
    if not len(state.x):
        return state
    x, P = state.x.copy(), state.P.copy()
    H = np.array([0.0, 1.0, 0.0, -across_m_s])
    correct_all(x, P, H, 0.0, variance * float(np.mean(x[:, S])) ** 2, SPEED_SIGMA)
    return state._replace(x=x, P=P)


def with_evidence(state: OffsetState, frame: FrameEvidence, model: OffsetModel) -> OffsetState:
    """Update with a frame's likelihood at the hypotheses' time."""
    gap_s, dt_s = max(frame.dt_s - FIRST_FRAME_S, 0.0), min(frame.dt_s, FIRST_FRAME_S)
    new = -expm1(-dt_s / model.weight_time_s)
    forgotten = 1.0 - (1.0 - model.forgotten * new) * exp(-model.forget_1_s * gap_s)
    x, P, weight, belief, moment = updated_hypotheses(state, frame, model, dt_s, forgotten)
    age_s = 0.0 if belief > SUPPORTED or not len(state.x) else state.evidence_age_s
    spread2 = state.spread2
    if moment >= 0.0:
        moment += (CORNERS_AHEAD * frame.split_std_rad) ** 2
        spread2 -= expm1(-dt_s / model.spread_time_s) * (moment - spread2)
    return state._replace(x=x, P=P, weight=weight, evidence_age_s=age_s, spread2=spread2)


def updated_hypotheses(
    state: OffsetState, frame: FrameEvidence, model: OffsetModel, dt_s: float, forgotten: float
) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """Call `update_with_frame` for a frame of which ``dt_s`` is new; a share ``forgotten`` of all weights is lost."""
    s, s_std = model.inverse_half_width
    v_std, c_std = model.start_velocity_std_m_s * s, model.accel_bias_std * s
    return update_with_frame(
        state.x,
        state.P,
        state.weight,
        frame.components,
        frame.side,
        frame.aside_m,
        model.slack_norm**2,
        (-expm1(-dt_s / model.weight_time_s), -expm1(-dt_s / model.state_time_s), forgotten),
        (model.slack_norm**2, v_std**2, c_std**2, s, s_std**2),
        model.near_norm,
        (model.lost_std_norm**2, MAX_OFFSET, MAX_HYPOTHESES, MIN_WEIGHT),
    )


def update(state: OffsetState, frame: FrameEvidence, model: OffsetModel) -> OffsetState:
    """Update with a frame's likelihood at the state's time."""
    return with_evidence(at_path_end(state, model), frame, model)


def readout(state: OffsetState, model: OffsetModel) -> OffsetReadout:
    """Report the offset at the state's time."""
    x, P = _propagated_along(state, state.path, model)
    return summary(x, P, state.weight[:-1], state, model)


def lasting_variances(state: OffsetState, model: OffsetModel) -> tuple[float, float]:
    """Return the variance of errors common to successive frames, half widths squared: usual, and with its tails."""
    u = sqrt(state.spread2)
    usual = model.lasting_share * u
    return usual**2, max(usual, model.tail_slope * (u - model.tail_from_norm)) ** 2


def summary(
    mean: FloatArray, cov: FloatArray, weight: FloatArray, state: OffsetState, model: OffsetModel
) -> OffsetReadout:
    """Report the moments of the hypotheses near the most probable one.

    Parameters
    ----------
    mean, cov
        Hypotheses: y and v, possibly followed by further states: (k, 2 or more) and (k, 2 or more, 2 or more).
    weight
        Weights (k,) without that of the unknown.
    state
        Source of the evidence's age and of u^2.
    model
        Thresholds: which hypotheses are near, and when an offset is known.
    """
    if not len(mean):
        return OffsetReadout(nan, nan, nan, nan, 0.0, False, nan)
    lasting = lasting_variances(state, model)
    y, y_std, v, v_std, probability = summarised(
        mean, cov, weight, model.tolerance_norm, lasting, model.scale_std
    )
    known = probability > model.known_probability and y_std < model.known_std_norm
    return OffsetReadout(y, y_std, v, v_std, probability, known, state.evidence_age_s)


def moments(state: OffsetState, model: OffsetModel) -> tuple[FloatArray, FloatArray]:
    """Return mean (4,) and covariance (4, 4) of the hypotheses that `summary` reports; there is at least one."""
    weight = state.weight[:-1]
    near = np.abs(state.x[:, Y] - state.x[np.argmax(weight), Y]) < model.tolerance_norm
    share = weight[near] / weight[near].sum()
    mean = share @ state.x[near]
    apart = state.x[near] - mean
    cov = np.einsum("k,kij->ij", share, state.P[near]) + np.einsum("k,ki,kj->ij", share, apart, apart)
    (_, lasting), offsets = lasting_variances(state, model), state.x[near, Y]
    cov[Y, Y] += lasting + model.scale_std**2 * float(share @ offsets**2)
    return mean, cov


@cache
def compile_filter() -> None:
    """Compile the filter's kernels, or load them from the cache, before the first frame."""
    one = np.array([0.5])
    mixture = OffsetMixture(one, one, one, one)
    frame = frame_evidence([mixture, mixture], FIRST_FRAME_S, 0.0, (0.0, 0.0))
    state, model = initial_offset_state(), OffsetModel()
    for _ in range(2):
        state = update(propagate(state, 0.01, 0.0, None, (0.0, 0.0, 1.0)), frame, model)
    readout(with_speed(state, 0.0, 1.0), model)
