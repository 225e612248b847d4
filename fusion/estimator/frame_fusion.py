"""Fusion of a camera frame: measurement, acceptance and update of heading, lateral offset, width and elevation.

`FrameFusion.fused` takes a state that has been propagated to the frame's time:

1. The frame is measured with the filter's prediction (`fusion.estimator.frame_update`), unless it repeats an earlier
   one (`fusion.estimator.camera_repeats`).
2. Before an axis is known, its heading votes for one (`fusion.estimator.axis_acquisition`).
3. Otherwise it updates the filter, robustly and with correlated errors (`fusion.estimator.noise_adaptation`). The
   fault isolation may follow another axis or correct the gyroscope instead (`fusion.estimator.axis_drift`).
4. A rejected heading votes for another axis, which may be another corridor (`fusion.estimator.junctions`).
5. The other measurements of an accepted frame update lateral offset, width and elevation.
"""

from __future__ import annotations

from math import hypot, nan, pi, sqrt

from fusion.estimator import junctions
from fusion.estimator import tilt as tilts
from fusion.estimator.attitude_drift import AttitudeDrift
from fusion.estimator.axis_acquisition import Recovery, acquire, recover
from fusion.estimator.axis_drift import MeasuredHeading, with_diagnosis
from fusion.estimator.camera_delay import (
    DelayedInnovation,
    FrameHeading,
    innovation_of,
    learn_delay,
    turned_since_exposure,
    with_axis,
)
from fusion.estimator.camera_elevation import Elevation
from fusion.estimator.config import FusionConfig
from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.frame_update import FrameResult, FrameSample, measure_with_prior, reason_to_reject
from fusion.estimator.hypotheses import Hypothesis
from fusion.estimator.imu_yaw import compare_by_frame
from fusion.estimator.lateral.status import Lateral
from fusion.estimator.lateral.updates import LateralOffset
from fusion.estimator.models import BIAS, PSI, heading_model
from fusion.estimator.noise_adaptation import ErrorModel, correlation, update_robustly
from fusion.estimator.propagation import Mode, Propagation
from fusion.estimator.range_width import Width
from fusion.estimator.sample_times import seconds_since
from fusion.estimator.state import State
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason
from vision.rotations import wrap_axis

OUTLIER_DENSITY = 1 / pi  # 1/rad: outlying headings are uniform over half a turn


class FrameFusion:
    """Fuses frames; the result depends only on state and frame.

    Parameters
    ----------
    config
        Settings.
    propagation
        Model of the heading between samples.
    lateral
        Filter of the lateral offset.
    """

    def __init__(self, config: FusionConfig, propagation: Propagation, lateral: LateralOffset) -> None:
        self.config = config
        self._propagation = propagation
        self._lateral = lateral

    def expected(self, s: State, t_ns: int) -> Prior:
        """Return the predicted measurement of a frame at this time."""
        x, P, d = s.x, s.P, s.reckoning
        psi = float(x[PSI]) - turned_since_exposure(s.delay, float(x[BIAS]), t_ns, d.raw_theta_rad)
        offset = offset_std = nan
        if seconds_since(t_ns, s.lateral.t_ns) <= s.frames.age_limit_s(self.config):
            half_m = s.width.half_m(self.config)
            offset, offset_std = self._lateral.expected(s.lateral, psi, half_m)
        p, q, r = d.gyro_rad_s
        return Prior(
            heading_rad=wrap_axis(psi) if s.axis.acquired else nan,
            heading_std_rad=sqrt(float(P[PSI, PSI])) if s.axis.acquired else nan,
            lateral_offset_norm=offset,
            lateral_offset_norm_std=offset_std,
            width_per_height=s.width.per_height,
            elevation_rad=s.elevation.mean_rad,
            elevation_std_rad=s.elevation.std_rad,
            body_rate_rad_s=sqrt(p * p + q * q + r * r) if d.mode is Mode.GYRO else nan,
            body_rates_rad_s=(p, q, r) if d.mode is Mode.GYRO else None,
        )

    def fused(
        self, s: State, ekf: CorridorEKF, sample: FrameSample, with_offset: bool
    ) -> tuple[State, FrameResult]:
        """Fuse a frame at the time of the state; return the new state and what became of the frame.

        ``ekf`` holds the state's filter and is updated. ``with_offset``: whether to look for the lateral offset.
        """
        if sample.measure is None:
            return s, FrameResult(sample.stamp_ns, None, False, Reason.UNREADABLE)
        repeats = s.checks.repeats.with_frame(sample, s.reckoning, s.checks.gyro)
        s = s._replace(checks=s.checks._replace(repeats=repeats))
        if repeats.found:
            m = sample.measure if isinstance(sample.measure, FrameMeasurement) else None
            return s, FrameResult(sample.stamp_ns, m, False, Reason.REPEATED)
        attitude = tilts.attitude_at(s.tilt, sample.t_ns, self.config.attitude_std_rad)
        if isinstance(sample.measure, FrameMeasurement):
            m = sample.measure
        else:
            prior, psi_rad = self.expected(s, sample.t_ns), float(ekf.x[PSI])
            m = measure_with_prior(sample.measure, attitude, prior, psi_rad, with_offset, self.config)
        s = s._replace(axis=s.axis.with_split_seen(m))
        reason = reason_to_reject(m, self.config)
        if reason is not Reason.OK:
            if s.axis.acquired and not m.accepted and m.offset_evidence:  # relative to the predicted axis
                seen, half_m = s.lateral.with_section_seen(sample.t_ns, m), s.width.half_m(self.config)
                s = s._replace(lateral=self._lateral.fused(seen, ekf.x, sample.t_ns, m, half_m))
            return s, FrameResult(sample.stamp_ns, m, False, reason)
        installed = s.checks.installation
        if s.reckoning.mode is Mode.GYRO and s.axis.diagnosis.found is not Hypothesis.SPIKE:
            installed = installed.with_frame(
                sample.t_ns, m.heading_rad, s.reckoning.raw_theta_rad, m.heading_std_rad
            )
        else:
            installed = installed.interrupted()
        s = s._replace(checks=s.checks._replace(installation=installed))
        s = self._with_axis_checked(s, ekf, sample)
        return self._with_heading(s, ekf, sample, m, attitude)

    def _with_axis_checked(self, s: State, ekf: CorridorEKF, sample: FrameSample) -> State:
        """Drop an axis that is lost, and evidence that gyroscope or frame stamps no longer support."""
        axis, d = s.axis, s.reckoning
        if axis.acquired and float(ekf.P[PSI, PSI]) > self.config.lost_heading_std_rad**2:
            axis = axis.lost()
        if axis.stamps_suspect != (sample.stamp_std_s > 0.0):
            axis = axis._replace(stamps_suspect=sample.stamp_std_s > 0.0)
        if d.mode is not Mode.GYRO:  # without a gyroscope the faulty sensor cannot be isolated
            axis = axis._replace(
                diagnosis=axis.diagnosis.restarted(), frame_noise=axis.frame_noise.interrupted()
            )
        if d.mode is not Mode.ATTITUDE and axis.attitude_drift != AttitudeDrift():
            axis = axis._replace(attitude_drift=AttitudeDrift())
        extra_noise = axis.attitude_drift.density
        if d.mode is Mode.GYRO:
            extra_noise = (axis.frame_noise.gyro_scale - 1.0) * self.config.gyro_noise**2
        if extra_noise != d.extra_noise:
            d = d._replace(extra_noise=extra_noise)
        return s if axis is s.axis and d is s.reckoning else s._replace(axis=axis, reckoning=d)

    def _with_heading(
        self, s: State, ekf: CorridorEKF, sample: FrameSample, m: FrameMeasurement, attitude: Attitude | None
    ) -> tuple[State, FrameResult]:
        """Update with a frame's heading if it passes the gate, or keep it as a vote for another axis."""
        c, t_ns, d, axis = self.config, sample.t_ns, s.reckoning, s.axis
        interval_s = s.frames.interval_s
        variance = max(m.heading_std_rad, c.heading_std_floor_rad) ** 2 + axis.unseen_split_variance(m)
        variance += self._propagation.held_rate_variance(d, t_ns)
        variance += (sample.stamp_std_s * (d.rate_rad_s - float(ekf.x[BIAS]))) ** 2
        heading = m.heading_rad + turned_since_exposure(s.delay, float(ekf.x[BIAS]), t_ns, d.raw_theta_rad)
        if not axis.acquired:
            s = self._acquire(s, ekf, t_ns, m, attitude, heading, sqrt(variance))
            return s, FrameResult(sample.stamp_ns, m, True, Reason.OK)
        scale, correlation_s = axis.scale_and_correlation(d.mode, c)
        rho = correlation(t_ns, axis.t_vision_ns, correlation_s)
        measurement = heading_model(ekf.x, heading, variance)
        delay, by_delay = s.delay, DelayedInnovation(0.0, 0.0)
        if delay is not None:
            delay = with_axis(delay, ekf, t_ns, d.raw_theta_rad, axis.reset_count)
            by_delay = innovation_of(delay, ekf, t_ns, d.raw_theta_rad)
        error_model = ErrorModel(
            axis.gate_sigma(c, t_ns, d.theta_rad - float(ekf.x[PSI]), float(ekf.P[PSI, PSI]) + variance),
            rho,
            OUTLIER_DENSITY,
            extra_variance=by_delay.variance,
            scale=scale,
            rejected_share=axis.diagnosis.rejected_share,
        )
        gate, noise = update_robustly(ekf, measurement, axis.noise, error_model)
        axis = axis._replace(noise=noise, gate=gate)
        axis = axis.with_seen_heading(
            t_ns, heading, sqrt(variance), d, gate.accepted, interval_s, c.imu_yaw_std_rad
        )
        result = (gate.residual, gate.test_ratio)
        if d.mode is Mode.GYRO:
            clipped_ns = s.checks.gyro.clipped_ns
            seen = MeasuredHeading(t_ns, heading, variance, rho, interval_s, sample.stamp_std_s, clipped_ns)
            axis, followed = with_diagnosis(axis, ekf, d, seen, s.imu_yaw.corrects_heading, c)
            if followed is not None:
                s = s._replace(axis=followed, delay=delay, x=ekf.x, P=ekf.P)
                return s, FrameResult(sample.stamp_ns, m, True, Reason.OK, *result)
        if not gate.accepted:
            vote = (t_ns, d.theta_rad - heading, sqrt(variance))
            axis = axis.with_vote(*vote, axis.recent[-1].linked, interval_s)
            s = self._follow_votes(s._replace(axis=axis, delay=delay), ekf, t_ns)
            return s, FrameResult(sample.stamp_ns, m, False, Reason.GATE, *result)
        if delay is not None and d.mode is Mode.GYRO:
            at_delay = FrameHeading(t_ns, m.heading_rad, variance * scale, axis.reset_count)
            delay = learn_delay(delay, ekf, at_delay, by_delay.per_s, c)
        imu_yaw = compare_by_frame(s.imu_yaw, t_ns, heading, variance, d)
        axis = axis.with_lasting_error(float(ekf.K[PSI, 0]), m)
        if d.mode is Mode.ATTITUDE:
            axis = axis.with_attitude_drift(ekf, t_ns, rho)
        s = s._replace(axis=axis.confirmed(ekf, t_ns, d.theta_rad), delay=delay, imu_yaw=imu_yaw)
        s = self._with_accepted(s, ekf, t_ns, m, attitude)
        return s, FrameResult(sample.stamp_ns, m, True, Reason.OK, *result)

    def _with_accepted(
        self, s: State, ekf: CorridorEKF, t_ns: int, m: FrameMeasurement, attitude: Attitude | None
    ) -> State:
        """Use the other measurements of an accepted frame, and store the filter's new state."""
        lateral, width, elevation = self._fuse_other_measurements(s, ekf, t_ns, m, attitude)
        checks = s.checks
        if attitude is not None:
            std_rad = hypot(m.elevation_std_rad, attitude.std_rad)
            installation = checks.installation.with_elevation(
                t_ns, m.elevation_rad, std_rad, attitude.roll_rad
            )
            checks = checks._replace(installation=installation)
        x, P = ekf.x, ekf.P
        return s._replace(x=x, P=P, lateral=lateral, width=width, elevation=elevation, checks=checks)

    def _acquire(
        self,
        s: State,
        ekf: CorridorEKF,
        t_ns: int,
        m: FrameMeasurement,
        attitude: Attitude | None,
        heading_rad: float,
        std_rad: float,
    ) -> State:
        """Add a frame to the search for an axis; if that acquires one, use the frame's other measurements too."""
        d, interval_s = s.reckoning, s.frames.interval_s
        axis = s.axis.with_vote(t_ns, d.theta_rad - heading_rad, std_rad, False, interval_s)
        axis = acquire(axis, ekf, t_ns, d.theta_rad, s.imu_yaw.corrects_heading, self.config, d.mode)
        axis = axis.with_seen_heading(
            t_ns, heading_rad, std_rad, d, axis.acquired, interval_s, self.config.imu_yaw_std_rad
        )
        axis = axis.with_lasting_error(1.0, m)
        s = s._replace(axis=axis)
        if not axis.acquired:
            return s
        lateral, width, elevation = self._fuse_other_measurements(s, ekf, t_ns, m, attitude)
        return s._replace(lateral=lateral, width=width, elevation=elevation, x=ekf.x, P=ekf.P)

    def _fuse_other_measurements(
        self, s: State, ekf: CorridorEKF, t_ns: int, m: FrameMeasurement, attitude: Attitude | None
    ) -> tuple[Lateral, Width, Elevation]:
        """Use an accepted frame's other measurements: lateral offset, corridor width, elevation of the camera."""
        lateral = s.lateral.with_section_seen(t_ns, m)
        another = lateral.section.is_another_seen
        width = s.width if another else s.width.with_frame(t_ns, m.width_per_height)
        lateral = self._lateral.fused(lateral, ekf.x, t_ns, m, width.half_m(self.config))
        return lateral, width, s.elevation.with_frame(m, attitude)

    def _follow_votes(self, s: State, ekf: CorridorEKF, t_ns: int) -> State:
        """Recover the heading or enter another corridor if enough votes against the present axis agree."""
        c, theta_rad = self.config, s.reckoning.theta_rad
        corrects_heading = s.imu_yaw.corrects_heading
        axis, found = junctions.decide(
            s.axis, float(ekf.x[PSI]), sqrt(float(ekf.P[PSI, PSI])), t_ns, theta_rad, s.frames.interval_s, c
        )
        if found is None:
            return s._replace(axis=axis)  # the gate rejected the heading: the filter is unchanged
        imu_yaw = s.imu_yaw.axis_changed()
        if isinstance(found, Recovery):
            axis = recover(axis, ekf, found, t_ns, theta_rad, corrects_heading)
            return s._replace(axis=axis, imu_yaw=imu_yaw, x=ekf.x, P=ekf.P)
        lateral = s.lateral.without_offset()
        crossing = junctions.Crossing(corrects_heading, lateral.n_used)
        axis = junctions.enter_corridor(axis, ekf, found, t_ns, theta_rad, crossing, c)
        width = s.width.corridor_changed()
        return s._replace(axis=axis, imu_yaw=imu_yaw, lateral=lateral, width=width, x=ekf.x, P=ekf.P)
