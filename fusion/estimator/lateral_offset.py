r"""The lateral offset as a Gaussian sum: several hypotheses, between which later frames and the motion decide.

A frame seldom leaves one offset (`vision.lateral.mixture`). So the filter keeps a sum of Gaussians (D. L. Alspach,
H. W. Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE Transactions on Automatic
Control 17(4), 1972) and the probability that the offset is unknown. Each hypothesis is a state (4,) ``[y, v, c, s]``:

- y: offset right of the centre line, half widths;
- v: its rate, half widths per second;
- c: the accelerometer's bias across the corridor, half widths per second squared;
- s: one over the half width, 1/m.

**Process.** With the acceleration a across the corridor, m/s^2, from the specific force f levelled by roll and
pitch::

    a  = sin(psi) f_forward + cos(psi) f_right
    y' = v        v' = a s - c + n_v        c' = n_c        s' = 0

which is linear in the state, as s multiplies what is measured: with A1 and A2 the single and double integral of a
over T, one transition serves all hypotheses, and a sample of the accelerometer costs a few additions::

        [ 1  T  -T^2/2  A2 ]
    F = [ 0  1  -T      A1 ]
        [ 0  0   1      0  ]
        [ 0  0   0      1  ]

Where there is no accelerometer, or one that vibrates so much that it tells less than nothing would, v is a
Gauss-Markov process instead, as long as the silence lasts. A velocity stream's speed w across the corridor is a
measurement of v: ``0 = v - w s``, with its variance inflated where it is far from what a hypothesis expects.

**Evidence.** A frame's likelihood of the offset is ``p(y) = e / 2 + sum_j w_j N(o_j; y, sigma_j^2)``, with e the
probability that it cannot tell. Errors of successive frames resemble each other, so a frame that follows the last one
after dt counts as a part ``1 - exp(-dt / tau)`` of one: the hypotheses' weights are multiplied by that power of the
likelihood, and the variances of the update are divided by it. Within a hypothesis, components are
weighed by probabilistic data association (Y. Bar-Shalom, E. Tse, "Tracking in a cluttered environment with
probabilistic data association", Automatica 11(5), 1975). The unknown offset is uniform over (-1, 1), hence its
likelihood is 1/2; what it contains moves to new hypotheses at the components that none explains. A little is always
forgotten: weight leaks from all hypotheses to the unknown.

**Reported** is the sum of those about the likeliest; it is known where it contains most of the probability and is
narrow. A line beside the corner that is taken for it stays there for seconds, and no average over frames makes that
error less. So what is reported has two variances besides those of the hypotheses, which the filter itself does not
feed back: ``(s_y y)^2``, as lines inside or outside both corners make the corridor narrower or wider, and
``s_l^2 u^2``, with u^2 the second moment of the frames' likelihoods about the likeliest hypothesis, averaged over
seconds: where each frame leaves much open, or says something else than all of them together do, that is off as well.
On simulated corridors the error grows in proportion to u, and u tells a wrong offset from a right one better than
the variance of the hypotheses, or the distance between what floor and ceiling say.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from math import cos, exp, expm1, isfinite, nan, sin
from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import NO_FORCE
from fusion.estimator.lateral_kernels import (
    N_LATERAL,
    S,
    Y,
    correct_all,
    extended_path,
    fill_transition,
    propagated_along,
)
from fusion.estimator.lateral_mixture_kernels import summarised, update_with_frame
from fusion.estimator.records import new_record
from vision.lateral.mixture import OffsetMixture, combine
from vision.types import FloatArray

MAX_HYPOTHESES = 15
MIN_WEIGHT = 1e-4
MAX_OFFSET = 1.2  # beyond the walls
MIN_CANNOT_TELL = 0.15  # of each kind of evidence, as no frame tells what it does not know
FIRST_FRAME_S = (
    0.3  # as if that long after another: one frame alone, whenever it comes, is not to be relied on
)
START_SPREAD_NORM = 0.05  # u before the first frame
SUPPORTED = 0.5  # belief in a frame from which on it confirms the likeliest hypothesis
ROLL_WALK = 0.006  # rad/sqrt(s) that the attitude's roll strays
SPEED_SIGMA = 3.0  # from which on a velocity is doubted
ROLL_TIME_S = 0.3  # over which errors of the frames' verticals resemble each other


class OffsetModel(NamedTuple):
    """What the filter assumes; lengths in metres unless they are said to be in half widths (``norm``)."""

    accel_noise: float = (
        0.09  # m/s/sqrt(s), besides what the accelerometer itself shows: tilt that comes and goes
    )
    accel_bias_std: float = 0.15  # m/s^2
    accel_bias_walk: float = 0.03  # m/s^2/sqrt(s): the attitude's slow errors
    rough_limit: float = 0.17  # m/s/sqrt(s) of noise from which on an accelerometer is worth nothing
    velocity_std_m_s: float = 0.3  # without accelerometer
    velocity_time_s: float = 1.0
    start_velocity_std_m_s: float = 0.4
    inverse_half_width: tuple[float, float] = (
        0.95,
        0.25,
    )  # 1/m, mean and standard deviation in an unknown corridor
    weight_time_s: float = 0.26
    state_time_s: float = 0.05
    displacement_time_s: float = 2.0  # likewise for displacements by parallax: the axis errs for seconds
    forgotten: float = 0.08  # share of all weights that a frame which is all new gives to the unknown
    forget_1_s: float = 0.3  # the same while no frame comes
    slack_norm: float = 0.01
    spread_time_s: float = 1.5  # over which the second moment of the frames' likelihoods is averaged
    lasting_share: float = 0.4  # standard deviation of an error that lasts, over the root of that moment
    scale_std: float = 0.05  # of the corridor's width as the taken lines have it, over the true one
    near_norm: float = 0.03  # hypotheses nearer than this are one
    tolerance_norm: float = 0.1
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

    def then(self, on: Path) -> Path:
        """Return this path with another one at its end."""
        return Path(
            self.t_s + on.t_s,
            self.accel_s + on.accel_s,
            self.a1 + on.a1,
            self.a2 + self.a1 * on.t_s + on.a2,
            self.noise + on.noise,
        )

    def since(self, start: Path) -> Path:
        """Return what follows a path that this one begins with."""
        t_s = self.t_s - start.t_s
        return Path(
            t_s,
            self.accel_s - start.accel_s,
            self.a1 - start.a1,
            self.a2 - start.a2 - start.a1 * t_s,
            self.noise - start.noise,
        )


class Acceleration(NamedTuple):
    """The acceleration across the corridor: last sample, m/s^2, its age, and how much successive samples differ.

    ``density2`` is that difference as the square of a white noise's density, (m/s)^2/s; ``n`` counts samples.
    """

    last: float = nan
    age_s: float = 0.0
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
    accel: Acceleration = Acceleration()
    roll: RollCorrection = RollCorrection()
    spread2: float = START_SPREAD_NORM**2  # second moment of the frames' likelihoods, half widths squared
    evidence_age_s: float = nan  # since a frame supported the likeliest hypothesis


class OffsetReadout(NamedTuple):
    """The offset at the state's time, its rate, the probability of its hypothesis, whether it may be relied on."""

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
    """Forget the offset and its rate; what is known of the accelerometer stays."""
    # The bias across the corridor is another one there: it is that of the tilt and of both axes.
    return initial_offset_state()._replace(accel=state.accel, roll=state.roll)


def propagate(
    state: OffsetState,
    dt_s: float,
    heading_rad: float,
    force: tuple[float, float, float] | None,
    down: tuple[float, float, float],
) -> OffsetState:
    """Carry the state on by ``dt_s`` with the accelerometer's sample at its end; None: there is none there."""
    x, P, weight, path, accel, roll, spread2, age_s = state
    far, felt = extended_path((*path,), (*accel,), dt_s, heading_rad, force or NO_FORCE, down, roll[0])
    path, accel = new_record(Path, far), new_record(Acceleration, felt)
    return new_record(OffsetState, (x, P, weight, path, accel, roll, spread2, age_s + dt_s))


def transition(path: Path, model: OffsetModel, *, backward: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return F (4, 4) and Q (4, 4) of a path of some length, or, ``backward``, those that lead back.

    The noise is turned into half widths by the s of the model, not that of a hypothesis: one that takes the corridor
    for wider would have less of it, and win for that alone.
    """
    F, Q = np.empty((N_LATERAL, N_LATERAL)), np.empty((N_LATERAL, N_LATERAL))
    t_s, accel_s, a1, a2, noise = path
    fill_transition((t_s, accel_s, a1, a2, noise), motion_noise(model), backward, F, Q)
    return F, Q


def motion_noise(m: OffsetModel) -> tuple[float, float, float, float, float, float]:
    """Return what `fill_transition` takes of a model."""
    inverse, _ = m.inverse_half_width
    return inverse, m.accel_noise, m.accel_bias_walk, m.rough_limit, m.velocity_std_m_s, m.velocity_time_s


def along_path(state: OffsetState, path: Path, model: OffsetModel, *, backward: bool = False) -> OffsetState:
    """Carry the hypotheses along a path, or back along it."""
    x, P = _propagated_along(state, path, model, backward)
    return state if x is state.x else state._replace(x=x, P=P)


def _propagated_along(
    state: OffsetState, path: Path, model: OffsetModel, backward: bool = False
) -> tuple[FloatArray, FloatArray]:
    if not path.t_s > 0.0 or not len(state.x):
        return state.x, state.P
    t_s, accel_s, a1, a2, noise = path
    return propagated_along(state.x, state.P, (t_s, accel_s, a1, a2, noise), motion_noise(model), backward)


def at_path_end(state: OffsetState, model: OffsetModel) -> OffsetState:
    """Carry the hypotheses to the state's time."""
    return along_path(state, state.path, model)._replace(path=Path())


def with_roll(state: OffsetState, roll_rad: float, std_rad: float, dt_s: float) -> OffsetState:
    """Take in how far a frame's vertical lines lie right of the attitude's vertical."""
    mean, variance = state.roll
    variance = variance + ROLL_WALK**2 * max(dt_s, 0.0)
    gain = variance / (variance + std_rad**2 / (1.0 - exp(-max(dt_s, 0.02) / ROLL_TIME_S)))
    return state._replace(roll=RollCorrection(mean + gain * (roll_rad - mean), (1.0 - gain) * variance))


class FrameEvidence(NamedTuple):
    """What a frame says of the offset.

    Parameters
    ----------
    components
        Rows (m, 3) of weight, offset of the camera and variance, half widths; the rest of the weight: it cannot tell.
    dt_s
        Time since the frame before, which says how much of it is new.
    side
        1, or -1 where the vehicle flies against the axis and right is left.
    aside_m
        How far the camera is right of the body's centre, across the corridor as it faces.
    """

    components: FloatArray
    dt_s: float
    side: float = 1.0
    aside_m: float = 0.0


def frame_evidence(
    mixtures: Sequence[OffsetMixture], dt_s: float, heading_rad: float, camera_arm_m: tuple[float, float]
) -> FrameEvidence:
    """Combine what one frame says by several kinds of evidence.

    Parameters
    ----------
    mixtures
        At least one.
    dt_s
        Time since the frame before; NaN for the first.
    heading_rad
        The vehicle's, from the corridor's axis, in all directions.
    camera_arm_m
        How far the camera sits ahead and right of the body's centre.
    """
    mixture = reduce(combine, [m.less_sure(MIN_CANNOT_TELL) for m in mixtures])
    side = 1.0 if cos(heading_rad) >= 0.0 else -1.0
    ahead_m, right_m = camera_arm_m
    aside_m = side * (ahead_m * sin(heading_rad) + right_m * cos(heading_rad))
    components = np.column_stack([mixture.weight, mixture.offset_norm, mixture.std_norm**2])
    return FrameEvidence(components, dt_s if isfinite(dt_s) else FIRST_FRAME_S, side, aside_m)


def with_speed(state: OffsetState, across_m_s: float, variance: float) -> OffsetState:
    """Take in a speed across the corridor, positive right, with its variance, (m/s)^2."""
    if not len(state.x):
        return state
    x, P = state.x.copy(), state.P.copy()
    H = np.array([0.0, 1.0, 0.0, -across_m_s])
    correct_all(x, P, H, 0.0, variance * float(np.mean(x[:, S])) ** 2, SPEED_SIGMA)
    return state._replace(x=x, P=P)


def with_evidence(state: OffsetState, frame: FrameEvidence, model: OffsetModel) -> OffsetState:
    """Take in what a frame says, at the hypotheses' time."""
    gap_s, dt_s = max(frame.dt_s - FIRST_FRAME_S, 0.0), min(frame.dt_s, FIRST_FRAME_S)
    new = -expm1(-dt_s / model.weight_time_s)
    forgotten = 1.0 - (1.0 - model.forgotten * new) * exp(-model.forget_1_s * gap_s)
    x, P, weight, belief, moment = updated_hypotheses(state, frame, model, dt_s, forgotten)
    age_s = 0.0 if belief > SUPPORTED or not len(state.x) else state.evidence_age_s
    spread2 = state.spread2
    if moment >= 0.0:
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
    """Take in what a frame at the state's time says."""
    return with_evidence(at_path_end(state, model), frame, model)


def readout(state: OffsetState, model: OffsetModel) -> OffsetReadout:
    """Report the offset at the state's time."""
    x, P = _propagated_along(state, state.path, model)
    return summary(x, P, state.weight[:-1], state, model)


def lasting_variance(state: OffsetState, model: OffsetModel) -> float:
    """Variance of an error that successive frames have in common, half widths squared, see the module's text."""
    return model.lasting_share**2 * state.spread2


def summary(
    mean: FloatArray, cov: FloatArray, weight: FloatArray, state: OffsetState, model: OffsetModel
) -> OffsetReadout:
    """Report the sum of the hypotheses about the likeliest.

    Parameters
    ----------
    mean, cov
        Of y and v, and what may follow: (k, 2 or more) and (k, 2 or more, 2 or more).
    weight
        (k,), with what is unknown left out.
    state
        Has the age of its evidence, reported as it is, and the spread of its frames.
    model
        Says what is near, and when an offset is known.
    """
    if not len(mean):
        return OffsetReadout(nan, nan, nan, nan, 0.0, False, nan)
    lasting = lasting_variance(state, model)
    y, y_std, v, v_std, probability = summarised(
        mean, cov, weight, model.tolerance_norm, lasting, model.scale_std
    )
    known = probability > model.known_probability and y_std < model.known_std_norm
    return OffsetReadout(y, y_std, v, v_std, probability, known, state.evidence_age_s)


def moments(state: OffsetState, model: OffsetModel) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and covariance (4, 4) of the hypotheses that `summary` reports on; there is at least one."""
    weight = state.weight[:-1]
    near = np.abs(state.x[:, Y] - state.x[np.argmax(weight), Y]) < model.tolerance_norm
    share = weight[near] / weight[near].sum()
    mean = share @ state.x[near]
    apart = state.x[near] - mean
    cov = np.einsum("k,kij->ij", share, state.P[near]) + np.einsum("k,ki,kj->ij", share, apart, apart)
    lasting, offsets = lasting_variance(state, model), state.x[near, Y]
    cov[Y, Y] += lasting + model.scale_std**2 * float(share @ offsets**2)
    return mean, cov


@cache
def compile_filter() -> None:
    """Compile, or load what was compiled, when an estimator is made: not at its first frame, in flight."""
    one = np.array([0.5])
    mixture = OffsetMixture(one, one, one, one)
    frame = frame_evidence([mixture, mixture], FIRST_FRAME_S, 0.0, (0.0, 0.0))
    state, model = initial_offset_state(), OffsetModel()
    for _ in range(2):
        state = update(propagate(state, 0.01, 0.0, None, (0.0, 0.0, 1.0)), frame, model)
    readout(with_speed(state, 0.0, 1.0), model)
