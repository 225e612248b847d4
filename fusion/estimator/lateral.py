"""The lateral offset: takes propagation steps and frames, corrects the filter, returns its part of the state.

The engine calls `propagated` in each propagation step, with a `MotionStep`, and `fused` for each accepted frame; the
estimate asks for `readout`, a frame's prediction for `expected`. Offset and velocity themselves are y and v of the
filter's state; this part gates them, and lets rejected offsets win by agreeing, as `fusion.estimator.corridor_axis`
does with headings.
"""

from __future__ import annotations

from math import cos, hypot, isfinite, nan, sin, sqrt
from typing import TYPE_CHECKING, NamedTuple

from fusion.estimator.config import FusionConfig
from fusion.estimator.models import PSI, FloatArray, V, Vector, Y, lateral_model
from fusion.estimator.noise_adaptation import Doubt, SourceNoise, correlation, update_with_doubt
from fusion.estimator.propagation import Drift
from fusion.estimator.velocity import Velocity
from fusion.estimator.votes import AGREEING_SHARE, Vote, add_vote, agreement, is_contested
from vision.measurement import FrameMeasurement
from vision.rotations import wrap_axis

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

UNKNOWN_STD = 1.0
LOST_STD = 0.5
PRIOR_STD = 0.1
START_FRAMES = 3
VOTE_AGE_S = 3.0
OUTLIER_DENSITY = 0.5  # anywhere between the walls


class MotionStep(NamedTuple):
    """One propagation step, as told to the lateral offset.

    Parameters
    ----------
    t_ns, dt_s
        Its end, and its length; 0 s at the first sample.
    x
        The filter's state (5,) at the start: heading, gyroscope bias.
    rate_rad_s
        Level yaw rate at the end, bias included.
    down, accel_m_s2
        Direction of gravity in the body, and the accelerometer's specific force there (FRD); None without.
    velocity
        Level speeds of the velocity stream.
    """

    t_ns: int
    dt_s: float
    x: FloatArray
    rate_rad_s: float
    down: Vector
    accel_m_s2: Vector | None
    velocity: Velocity


class Lateral(NamedTuple):
    """What is known of the lateral offset beside its mean and variance.

    Parameters
    ----------
    acquired
        Whether it is known.
    t_ns, n_used
        When one was last used, and how many have been.
    noise, test_ratio
        Of the frames' offsets; of the last innovation.
    votes
        Rejected offsets.
    last_known
        Last offset known, half widths and metres, while none is.
    reset_count, reset_norm, reset_m
        How often it jumped, and its last step.
    """

    acquired: bool = False
    t_ns: int | None = None
    n_used: int = 0
    noise: SourceNoise = SourceNoise()
    test_ratio: float = nan
    votes: tuple[Vote, ...] = ()
    last_known: tuple[float, float] = (nan, nan)
    reset_count: int = 0
    reset_norm: float = 0.0
    reset_m: float = 0.0


class LateralReadout(NamedTuple):
    """Offset and sigma, half widths; its rate and sigma, half widths per second; speed along the axis, m/s."""

    offset: float
    offset_std: float
    rate: float
    rate_std: float
    along_m_s: float


class LateralOffset:
    """Gates lateral offsets and decides when they are known.

    Parameters
    ----------
    config
        Settings.
    camera_arm_m
        How far the camera sits ahead and right of the body's centre.
    """

    def __init__(self, config: FusionConfig, camera_arm_m: tuple[float, float]) -> None:
        self.config = config
        self.camera_arm_m = camera_arm_m
        self._unmoved = Drift(0.0, 0.0, nan)  # the same from step to step while no velocity is known

    def propagated(self, lateral: Lateral, step: MotionStep, half_m: float) -> tuple[Lateral, Drift]:
        """Take a propagation step; return also how the offset moves in it.

        Parameters
        ----------
        lateral
            Part of the state.
        step
            What moves the vehicle.
        half_m
            Half the corridor's width; NaN where unknown.
        """
        scale, velocity = _scale_m(half_m), step.velocity
        if velocity.is_known(step.t_ns):
            v_std = self.config.velocity_std_m_s / scale
            return lateral, Drift(velocity.forward_m_s / scale, velocity.sideways_m_s / scale, v_std)
        v_std = self.config.lateral_velocity_std_m_s / scale
        if v_std != self._unmoved.v_std:
            self._unmoved = Drift(0.0, 0.0, v_std)
        return lateral, self._unmoved

    def fused(
        self, lateral: Lateral, ekf: CorridorEKF, t_ns: int, m: FrameMeasurement, half_m: float
    ) -> Lateral:
        """Take the offset of a frame whose heading was accepted.

        Parameters
        ----------
        lateral
            Part of the state.
        ekf
            Filter to correct.
        t_ns, m
            The frame.
        half_m
            Half the corridor's width; NaN where unknown.
        """
        if not (isfinite(m.lateral_offset_norm) and 0.0 < m.lateral_offset_norm_std < 10.0):
            return lateral
        offset_norm = m.lateral_offset_norm - self._camera_aside(m.heading_rad, half_m)
        return self._gated(lateral, ekf, t_ns, offset_norm, m.lateral_offset_norm_std, half_m)

    def lost(self, lateral: Lateral, ekf: CorridorEKF, half_m: float) -> Lateral:
        """Let the next lateral offsets start anew; what was known last is kept, to tell the step."""
        last_known = lateral.last_known
        if lateral.acquired:
            y = float(ekf.x[Y])
            last_known = (y, y * half_m)
        return lateral._replace(acquired=False, votes=(), last_known=last_known)

    def unknown_variances(self, half_m: float) -> tuple[float, float]:
        """Variances of y and v in a corridor of which nothing is known."""
        return UNKNOWN_STD**2, (self.config.lateral_velocity_std_m_s / _scale_m(half_m)) ** 2

    def expected(
        self, lateral: Lateral, x: FloatArray, P: FloatArray, psi_rad: float, half_m: float
    ) -> tuple[float, float]:
        """Offset and sigma, half widths, that a frame should show; NaN while it is not known.

        Parameters
        ----------
        lateral
            Part of the state.
        x, P
            The filter's state (5,) and covariance (5, 5).
        psi_rad
            Heading that the frame should show.
        half_m
            Half the corridor's width; NaN where unknown.
        """
        if not lateral.acquired:
            return nan, nan
        side = 1 if cos(psi_rad) >= 0 else -1
        offset = side * float(x[Y]) + self._camera_aside(wrap_axis(psi_rad), half_m)
        # Wider than it is: were vision silent wherever the filter is wrong, nothing could set the filter right.
        return offset, hypot(sqrt(float(P[Y, Y])), PRIOR_STD)

    def _camera_aside(self, heading_rad: float, half_m: float) -> float:
        """Half widths by which a camera ahead of the body's centre swings to the right; 0 while no width is known."""
        if not half_m > 0.0:  # NaN fails too
            return 0.0
        ahead_m, right_m = self.camera_arm_m
        return (ahead_m * sin(heading_rad) + right_m * cos(heading_rad)) / half_m

    def _gated(
        self, lateral: Lateral, ekf: CorridorEKF, t_ns: int, offset_norm: float, std: float, half_m: float
    ) -> Lateral:
        """Gate an offset; as with headings, what is rejected may win by agreeing."""
        c = self.config
        variance = max(std, c.lateral_std_floor_norm) ** 2
        if lateral.acquired and float(ekf.P[Y, Y]) > LOST_STD**2:
            lateral = self.lost(lateral, ekf, half_m)
        measurement = lateral_model(ekf.x, offset_norm, variance)
        if lateral.acquired:
            rho = correlation(t_ns, lateral.t_ns, c.lateral_correlation_s)
            doubt = Doubt(c.lateral_gate_sigma, rho, OUTLIER_DENSITY)
            gate, noise = update_with_doubt(ekf, measurement, lateral.noise, doubt)
            if gate.accepted:
                n_used = lateral.n_used + 1
                return lateral._replace(noise=noise, test_ratio=gate.test_ratio, t_ns=t_ns, n_used=n_used)
            lateral = lateral._replace(noise=noise, test_ratio=gate.test_ratio)
        side = float(measurement.H[Y])
        vote = Vote(t_ns, side * measurement.residual, sqrt(variance), lateral.n_used)
        lateral = lateral._replace(votes=add_vote(lateral.votes, vote, VOTE_AGE_S))
        found = agreement(lateral.votes, c.lateral_recovery_spread_norm)
        needed = c.recovery_frames if lateral.acquired else min(START_FRAMES, c.start_frames)
        if found is None or found.n_votes < needed or found.share < AGREEING_SHARE:
            return lateral
        if is_contested(found, lateral.n_used):
            return lateral
        ekf.widen(Y, found.value**2 if lateral.acquired else UNKNOWN_STD**2)
        value = offset_norm + side * (found.value - side * measurement.residual)
        before = float(ekf.x[Y])
        before, before_m = (before, before * half_m) if lateral.acquired else lateral.last_known
        ekf.update(lateral_model(ekf.x, value, found.std**2))
        if isfinite(before):  # known before: a step, not the start
            after = float(ekf.x[Y])
            lateral = lateral._replace(
                reset_count=lateral.reset_count + 1,
                reset_norm=after - before,
                reset_m=after * half_m - before_m,
            )
        return lateral._replace(acquired=True, votes=(), t_ns=t_ns, n_used=lateral.n_used + 1)


def readout(
    lateral: Lateral, x: FloatArray, P: FloatArray, velocity: Velocity, t_ns: int, half_m: float
) -> LateralReadout:
    """Report the offset, and how fast it changes by all that moves it: heading and speed, and drift.

    Parameters
    ----------
    lateral
        Part of the state.
    x, P
        The filter's state (5,) and covariance (5, 5).
    velocity
        Level speeds of the velocity stream.
    t_ns
        When.
    half_m
        Half the corridor's width; NaN where unknown.
    """
    psi, v = float(x[PSI]), float(x[V])
    along, c, across = nan, 0.0, 0.0
    if velocity.is_known(t_ns):
        along = velocity.forward_m_s * cos(psi) - velocity.sideways_m_s * sin(psi)
        across = velocity.forward_m_s * sin(psi) + velocity.sideways_m_s * cos(psi)
        scale = _scale_m(half_m)
        c, across = along / scale, across / scale
    if not lateral.acquired:
        return LateralReadout(nan, nan, nan, nan, along)
    variance = float(P[V, V]) + 2.0 * c * float(P[PSI, V]) + c * c * float(P[PSI, PSI])
    return LateralReadout(float(x[Y]), sqrt(float(P[Y, Y])), across + v, sqrt(max(variance, 0.0)), along)


def _scale_m(half_m: float) -> float:
    """Half width for turning metres into half widths; one metre where it is unknown."""
    return half_m if half_m > 0.0 else 1.0  # NaN fails too
