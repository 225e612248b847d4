"""The corridor's axis that the heading is measured from: what is known of it, and of other axes that frames show.

A frame shows the heading psi modulo half a turn. With the dead-reckoned heading theta, the axis ``theta - psi`` is
constant however the vehicle turns, so headings are compared as axes in that frame:

- Before an axis is acquired, each heading votes for one (`fusion.estimator.axis_acquisition`).
- Headings rejected by the gate are kept as votes for another axis; `fusion.estimator.junctions` decides what they
  mean.
- A heading is *linked* if no jump lies between it and a heading that the filter accepted, allowing for noise and for
  the turn measured by the gyroscope. Linked headings belong to the present axis even if the gate rejects them.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, isfinite, isnan, nan, radians, sqrt
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from fusion.estimator.attitude_drift import AttitudeDrift
from fusion.estimator.config import FusionConfig
from fusion.estimator.frame_noise import FrameNoise
from fusion.estimator.hypotheses import Diagnosis, Hypothesis, Innovations, ReportedFault
from fusion.estimator.models import PSI, Gate
from fusion.estimator.noise_adaptation import SourceNoise
from fusion.estimator.propagation import DeadReckoning, Mode, yaw_at
from fusion.estimator.votes import Vote, add_vote
from vision.measurement import FrameMeasurement
from vision.rotations import wrap, wrap_axis

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF

RIVAL_NS = 2_000_000_000  # after its last vote, for which an axis stays rejected
VOTE_AGE_S = 3.0
VOTE_AGE_FRAMES = 15
VOTE_SPACING_S = 0.03
GRADUAL_RAD = radians(6)  # largest turn between frames that is accepted without the gyroscope
LINK_SIGMA = 3.0
DRIFTED_SIGMA = 4.0
NEARER_SHARE = 0.25  # of the distance to a rejected axis, within which a frame shows the present one
MIN_YAW_LOG_RATIO = 4.0  # log-likelihood ratio above which the IMU yaw confirms the gyroscope, not the frame
REPEATING = 0.1  # probability above which the IMU's yaw may repeat a jump of the gyroscope
N_SPLITS, SHOWN_BY = 9, 3  # frames; a second direction counts if so many of the last ones show it
MAX_ACCELERATION_RAD_S2 = radians(150)  # yaw acceleration of a vehicle with a camera


class PreviousAxis(NamedTuple):
    """The corridor left last: axis in the dead-reckoned frame, index, turn, time, lateral offsets used by then."""

    axis_rad: float
    corridor_index: int
    corridor_turn_rad: float
    left_ns: int
    n_lateral: int


class FrameAxis(NamedTuple):
    """A frame's heading, its sigma, and the gyroscope's angle at its time.

    ``linked``: no jump lies between it and one that the filter accepted. ``yaw_rad``: the IMU's yaw at its time; NaN
    if there is none, or if it may repeat the gyroscope's errors.
    """

    t_ns: int
    heading_rad: float
    std_rad: float
    linked: bool
    raw_theta_rad: float
    yaw_rad: float = nan


class Rival(NamedTuple):
    """An axis that rejected frames agree on.

    Parameters
    ----------
    axis_rad
        In the dead-reckoned frame.
    since_ns, last_ns
        Times of its first and its last vote.
    psi_std_rad
        Sigma of the filter's heading when the votes began to agree.
    """

    axis_rad: float
    since_ns: int
    last_ns: int
    psi_std_rad: float

    def reach(self, config: FusionConfig, drifted: float = 0.0) -> float:
        """Return how far the present axis may have drifted before the first vote; ``drifted`` is a sigma of that."""
        return max(config.recovery_spread_rad, DRIFTED_SIGMA * max(self.psi_std_rad, drifted))


def continues_at_same_rate(seen: Sequence[FrameAxis], t_ns: int, heading_rad: float, std_rad: float) -> bool:
    """Whether a frame's heading continues at the earlier frames' rate, within noise and the largest acceleration.

    Parameters
    ----------
    seen
        Earlier frames, oldest first.
    t_ns, heading_rad, std_rad
        The frame's time, heading and standard deviation.
    """
    first, last = seen[0], seen[-1]
    span_s, dt_s = (last.t_ns - first.t_ns) * 1e-9, (t_ns - last.t_ns) * 1e-9
    if not 0.0 < dt_s < span_s:
        return False
    ahead = dt_s / span_s
    step = wrap_axis(heading_rad - last.heading_rad)
    expected = ahead * wrap_axis(last.heading_rad - first.heading_rad)
    variance = std_rad**2 + ((1.0 + ahead) * last.std_rad) ** 2 + (ahead * first.std_rad) ** 2
    reach = LINK_SIGMA * sqrt(variance) + 0.5 * MAX_ACCELERATION_RAD_S2 * dt_s * (dt_s + span_s)
    return abs(step - expected) < min(reach, GRADUAL_RAD)


def _is_linked(near: Sequence[FrameAxis], new: FrameAxis, yaw_std_rad: float) -> bool:
    """Whether no jump lies between a frame's heading and those before, within noise and the gyroscope's turn.

    The gyroscope itself may jump. If the IMU's yaw has turned as far, it has not, and the frames must have turned
    too.
    """
    last = near[-1].heading_rad
    step = wrap_axis(new.heading_rad - last - median(wrap_axis(r.heading_rad - last) for r in near))
    turned = new.raw_theta_rad - median(r.raw_theta_rad for r in near)
    variance = new.std_rad**2 + sum(r.std_rad**2 for r in near) / len(near) ** 2
    noise = LINK_SIGMA * sqrt(variance)
    if abs(step - turned) < noise:
        return True
    yawed = median(wrap(new.yaw_rad - r.yaw_rad) for r in near)
    variance += yaw_std_rad**2 * (1.0 + 1.0 / len(near))
    if (yawed - step) ** 2 - (yawed - turned) ** 2 > 2.0 * variance * MIN_YAW_LOG_RATIO:  # NaN is not
        return False
    low, high = max(min(turned, 0.0), -GRADUAL_RAD), min(max(turned, 0.0), GRADUAL_RAD)
    if low - noise < step < high + noise:
        return True
    gyro_jumped = abs(new.raw_theta_rad - near[-1].raw_theta_rad) > GRADUAL_RAD
    # Frames alone decide if the gyroscope may have jumped.
    return gyro_jumped and continues_at_same_rate(near, new.t_ns, new.heading_rad, new.std_rad)


class CorridorAxis(NamedTuple):
    """State of the axis that the heading is measured from.

    Parameters
    ----------
    acquired, ever_acquired
        Whether a heading has been acquired and not lost since, and whether ever.
    corridor_index, n_corridors, corridor_turn_rad
        The present corridor, the number of corridors so far, and the angle of its axis from the first one's.
    reset_count, reset_heading_rad
        Number of jumps of the heading, and the last jump.
    t_vision_ns, n_accepted
        Time of the last accepted frame, and the number of accepted frames.
    support_s
        Time over which frames have confirmed the present axis.
    anchor_rad, anchor_ns
        Axis in the dead-reckoned frame when a frame last confirmed it, and the time; not updated in a bend or while
        the frames' stamps are in doubt.
    stamps_suspect
        Whether a step of the camera's clock is suspected: a turn seen late may then look like another axis.
    facing_rad
        pi if the vehicle then faced against the axis, modulo a turn.
    lasting_std_rad
        Sigma of the heading's error by the part of the frames' errors that successive frames have in common.
    splits
        Variances, rad^2, of the last frames due to a second direction near the axis; none if all are 0.
    noise, frame_noise, gate
        Noise of the frames' headings, from their innovations and from their scatter about the gyroscope; outcome of
        the last innovation.
    votes
        Rejected headings, as axes in the dead-reckoned frame.
    recent
        The last headings of frames.
    rival
        Axis that rejected frames agree on.
    previous
        The corridor left last.
    diagnosis
        Fault isolation for frames that disagree with the prediction.
    attitude_drift
        Drift of the attitude's yaw against the frames while no gyroscope propagates the heading.
    """

    acquired: bool = False
    ever_acquired: bool = False
    corridor_index: int = 0
    n_corridors: int = 1
    corridor_turn_rad: float = 0.0
    reset_count: int = 0
    reset_heading_rad: float = 0.0
    t_vision_ns: int | None = None
    n_accepted: int = 0
    support_s: float = 0.0
    anchor_rad: float = nan
    anchor_ns: int = 0
    stamps_suspect: bool = False
    facing_rad: float = 0.0
    lasting_std_rad: float = 0.0
    splits: tuple[float, ...] = ()
    noise: SourceNoise = SourceNoise()
    frame_noise: FrameNoise = FrameNoise()
    gate: Gate | None = None
    votes: tuple[Vote, ...] = ()
    recent: tuple[FrameAxis, ...] = ()
    rival: Rival | None = None
    previous: PreviousAxis | None = None
    diagnosis: Diagnosis = Diagnosis()
    attitude_drift: AttitudeDrift = AttitudeDrift()

    @property
    def test_ratio(self) -> float:
        """Square of the last innovation over the gate squared."""
        return nan if self.gate is None else self.gate.test_ratio

    @property
    def common_std_rad(self) -> float:
        """Sigma of the heading's errors that successive frames have, or may have, in common."""
        return hypot(self.lasting_std_rad, self.attitude_drift.undecided_std_rad)

    @property
    def was_accepted(self) -> bool:
        """Whether the last innovation passed the gate."""
        return self.gate is not None and self.gate.accepted

    def lost(self) -> CorridorAxis:
        """Restart acquisition with the next headings."""
        return self._replace(
            acquired=False,
            votes=(),
            diagnosis=self.diagnosis.restarted(),
            frame_noise=self.frame_noise.interrupted(),
            attitude_drift=self.attitude_drift.interrupted(),
        )

    def clock_set_back(self) -> CorridorAxis:
        """Restart acquisition and drop all times; keep corridors and counts."""
        return self.lost()._replace(t_vision_ns=None, recent=(), previous=None)

    def without_frames_before(self, clipped_ns: int | None) -> CorridorAxis:
        """Drop headings from before a clipped turn.

        The gyroscope did not measure it, so they cannot be compared with later ones.
        """
        comparisons = self.diagnosis.comparisons
        if clipped_ns is None or not comparisons or comparisons[0].t_ns > clipped_ns:
            return self
        kept = tuple(comparison for comparison in comparisons if comparison.t_ns > clipped_ns)
        diagnosis = self.diagnosis._replace(innovations=Innovations(), comparisons=kept)
        return self._replace(diagnosis=diagnosis, frame_noise=self.frame_noise.interrupted())

    def confirmed(self, ekf: CorridorEKF, t_ns: int, theta_rad: float) -> CorridorAxis:
        """Record that a frame confirmed the present axis at a time and a dead-reckoned heading."""
        support_s = self.support_s
        if self.t_vision_ns is not None:
            support_s += min((t_ns - self.t_vision_ns) * 1e-9, 0.5)
        psi = float(ekf.x[PSI])
        sure = isnan(self.diagnosis.straight_bias_rad_s) and not self.stamps_suspect
        return self._replace(
            support_s=support_s,
            t_vision_ns=t_ns,
            n_accepted=self.n_accepted + 1,
            anchor_rad=theta_rad - psi if sure else self.anchor_rad,
            anchor_ns=t_ns if sure else self.anchor_ns,
            facing_rad=psi - wrap_axis(psi),
        )

    def with_split_seen(self, m: FrameMeasurement) -> CorridorAxis:
        """Note whether a frame shows a second direction near the axis; it may be rejected for it."""
        if not m.heading_std_rad > 0.0:  # NaN fails too: no axis was found
            return self
        variance = m.heading_split_std_rad**2
        if variance == 0.0 and not any(self.splits):
            return self if not self.splits else self._replace(splits=())
        before = self.splits or (0.0,) * (N_SPLITS - 1)
        return self._replace(splits=(*before[1 - N_SPLITS :], variance))

    def unseen_split_variance(self, m: FrameMeasurement) -> float:
        """Return the variance to add to a frame's heading for a second direction that many of the last frames show.

        Frames that happen not to show it are as wrong as the others.
        """
        if not self.splits:
            return 0.0
        return max(sorted(self.splits)[-SHOWN_BY] - m.heading_split_std_rad**2, 0.0)

    def with_lasting_error(self, gain: float, m: FrameMeasurement) -> CorridorAxis:
        """Update with the common error of a frame that was fused with this Kalman gain.

        The errors of all frames are taken as equal but for their sigmas, as in the consider (Schmidt-Kalman) filter
        with a constant parameter.
        """
        std_rad = sqrt(m.heading_lasting_std_rad**2 + self.unseen_split_variance(m))
        return self._replace(lasting_std_rad=(1.0 - gain) * self.lasting_std_rad + gain * std_rad)

    def with_attitude_drift(self, ekf: CorridorEKF, t_ns: int, rho: float) -> CorridorAxis:
        """Widen the heading's variance if the yaw increments drift from the frames, and report it.

        For an accepted frame in `Mode.ATTITUDE`; ``rho`` is the correlation of its error with that of the one before.
        """
        if self.gate is None or self.t_vision_ns is None:
            return self
        elapsed_s = (t_ns - self.t_vision_ns) * 1e-9
        drift, variance = self.attitude_drift.with_innovation(self.gate, elapsed_s, rho)
        if variance == 0.0:
            return self._replace(attitude_drift=drift)
        ekf.widen(PSI, variance)
        diagnosis = self.diagnosis._replace(reported=ReportedFault(Hypothesis.WELL, t_ns))
        return self._replace(attitude_drift=drift, diagnosis=diagnosis)

    def gate_sigma(self, config: FusionConfig, t_ns: int, axis_rad: float, variance: float) -> float:
        """Return the gate of a frame's heading.

        It is halved while frames show another axis. It also ends a quarter of the way to an axis that was too far off
        when it appeared: that stays rejected, however much the prediction's sigma has grown since, and with such a
        sigma one frame by chance in the gate would move the heading there.

        Parameters
        ----------
        config
            Settings.
        t_ns, axis_rad
            The frame's time, and the axis that the filter expects then, in the dead-reckoned frame.
        variance
            Variance of the innovation.
        """
        gate = config.heading_gate_sigma * (0.5 if self.diagnosis.found is Hypothesis.AXIS else 1.0)
        rival = self.rival
        if rival is None or t_ns - rival.last_ns > RIVAL_NS:
            return gate
        apart = abs(wrap_axis(axis_rad - rival.axis_rad))
        return min(gate, NEARER_SHARE * apart / sqrt(variance)) if apart > rival.reach(config) else gate

    def scale_and_correlation(self, mode: Mode, config: FusionConfig) -> tuple[float, float]:
        """Return the ratio of the frames' error variance to the stated one, and the errors' correlation time, s."""
        if mode is Mode.GYRO and self.frame_noise.fitted_ns is not None:
            return self.frame_noise.scale, self.frame_noise.correlation_s
        return self.noise.inflation, config.heading_correlation_s

    def with_seen_heading(
        self,
        t_ns: int,
        heading_rad: float,
        std_rad: float,
        reckoning: DeadReckoning,
        accepted: bool,
        frame_interval_s: float,
        yaw_std_rad: float,
    ) -> CorridorAxis:
        """Record a frame's heading, and whether it is linked to the earlier ones.

        Parameters
        ----------
        t_ns, heading_rad, std_rad, accepted
            The frame's measurement, and whether the filter accepted it.
        reckoning
            Dead reckoning of the heading.
        frame_interval_s
            Mean time between frames; NaN if unknown.
        yaw_std_rad
            White noise of the IMU's yaw.
        """
        reach_ns = round(max(0.4, 2.5 * frame_interval_s if isfinite(frame_interval_s) else 0.0) * 1e9)
        near = [r for r in self.recent if r.linked and t_ns - r.t_ns <= reach_ns]
        raw_theta_rad = reckoning.raw_theta_rad
        yaw_rad = yaw_at(reckoning, t_ns) if self.diagnosis.yaw_probabilities.repeating < REPEATING else nan
        new = FrameAxis(t_ns, heading_rad, std_rad, False, raw_theta_rad, yaw_rad)
        if reckoning.mode is Mode.NONE:
            linked = accepted or any(abs(wrap_axis(heading_rad - r.heading_rad)) < GRADUAL_RAD for r in near)
        else:
            linked = accepted and self.diagnosis.rejected_share < 0.5
            linked = linked or (bool(near) and _is_linked(near, new, yaw_std_rad))
        return self._replace(recent=(*self.recent[-5:], new._replace(linked=linked)))

    def with_vote(
        self, t_ns: int, axis_rad: float, std_rad: float, linked: bool, frame_interval_s: float
    ) -> CorridorAxis:
        """Keep a heading as a vote.

        Parameters
        ----------
        t_ns, axis_rad, std_rad
            The frame's time, its axis in the dead-reckoned frame, and the sigma.
        linked
            See `FrameAxis`.
        frame_interval_s
            Mean time between frames; NaN if unknown.
        """
        if self.votes and (t_ns - self.votes[-1].t_ns) * 1e-9 < VOTE_SPACING_S:
            return self  # frames of a fast camera are correlated, and would displace the older ones
        interval = frame_interval_s if isfinite(frame_interval_s) else 0.0
        age_s = max(VOTE_AGE_S, VOTE_AGE_FRAMES * interval)
        vote = Vote(t_ns, axis_rad, std_rad, self.n_accepted, linked)
        return self._replace(votes=add_vote(self.votes, vote, age_s))

    def with_reset(self, ekf: CorridorEKF, before_rad: float) -> CorridorAxis:
        """Count a jump of the heading from ``before_rad`` to its present value."""
        step_rad = float(ekf.x[PSI]) - before_rad
        return self._replace(
            reset_count=self.reset_count + 1,
            reset_heading_rad=step_rad,
            diagnosis=self.diagnosis.without_evidence(),
            frame_noise=self.frame_noise.interrupted(),
            attitude_drift=self.attitude_drift.interrupted(),
        )
