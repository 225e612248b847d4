"""Reaction to frames that drift from the prediction: gathers evidence, isolates the fault, corrects the filter.

With each frame the innovation statistics and the comparison of frame, gyroscope and IMU yaw are updated. When a mean
innovation is significant, and every `CHECK_INTERVAL_S`, `fusion.estimator.hypotheses.judge` decides over the spans of
`fusion.estimator.frame_drift`. The most probable hypothesis determines the reaction:

- gyroscope wrong: the covariance is widened along the drift, and heading and bias are corrected by the fitted line;
- corridor bends: the same, but the bias from before the bend is stored and restored at its end;
- gyroscope spikes: the heading is taken from the frames, which are continuous;
- all others: no correction here.
"""

from __future__ import annotations

from math import exp, isnan, nan, pi, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.estimator.axis_acquisition import Recovery, recover
from fusion.estimator.config import FusionConfig
from fusion.estimator.corridor_axis import VOTE_SPACING_S, CorridorAxis
from fusion.estimator.frame_drift import (
    MIN_POINTS,
    SPANS_S,
    Drift,
    Evidence,
    HeadingComparison,
    Slope,
    add_comparison,
    gyro_jump_between_frames,
)
from fusion.estimator.frame_noise import white_and_walk
from fusion.estimator.hypotheses import (
    CHECK_INTERVAL_S,
    SHORT_S,
    Diagnosis,
    Hypothesis,
    Innovations,
    ReportedFault,
    Verdict,
    judge,
)
from fusion.estimator.imu_yaw_check import GyroAndYaw, InertialNoise
from fusion.estimator.models import BIAS, N_STATES, PSI, YAW_OFFSET, heading_model
from fusion.estimator.propagation import DeadReckoning, yaw_at

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF


MAX_INTERVAL_S = 0.5  # largest weight of one frame in the means, as the time since the frame before
REJECTED_SHARE = 0.25  # of the frames; a spike needs more: single outliers do not come from the gyroscope


class MeasuredHeading(NamedTuple):
    """A frame's heading, its stated variance, the correlation with the one before, and the frames' interval.

    ``stamp_std_s`` is as in `fusion.estimator.frame_update.FrameSample`; ``clipped_ns`` is the time of the last
    clipped gyroscope sample: the angle turned then was not measured.
    """

    t_ns: int
    heading_rad: float
    variance: float
    rho: float
    interval_s: float
    stamp_std_s: float = 0.0
    clipped_ns: int | None = None


def with_diagnosis(
    axis: CorridorAxis,
    ekf: CorridorEKF,
    reckoning: DeadReckoning,
    seen: MeasuredHeading,
    corrects_heading: bool,
    config: FusionConfig,
) -> tuple[CorridorAxis, CorridorAxis | None]:
    """Diagnose after the gate; return the axis with the diagnosis, and the corrected one if the filter follows it.

    Parameters
    ----------
    axis, ekf, corrects_heading, config
        As in `fusion.estimator.axis_acquisition.acquire`; the axis with the newest frame's innovation.
    reckoning
        Dead reckoning by the gyroscope.
    seen
        The newest frame.
    """
    t_ns, heading_rad, variance, rho, interval_s, stamp_std_s, clipped_ns = seen
    axis = axis.without_frames_before(clipped_ns)
    scale, correlation_s = axis.scale_and_correlation(reckoning.mode, config)
    std, walk = white_and_walk(variance * scale, correlation_s, interval_s)
    linked, yaw_rad = axis.recent[-1].linked, yaw_at(reckoning, t_ns)
    bias_rad_s, bias_variance = float(ekf.x[BIAS]) + bend_rate(axis.diagnosis, ekf), float(ekf.P[BIAS, BIAS])
    raw_rad = reckoning.raw_theta_rad
    comparison = HeadingComparison(
        t_ns, heading_rad, std, raw_rad, yaw_rad, linked, walk, bias_rad_s, bias_variance, stamp_std_s
    )
    axis, drift = update_diagnosis(axis, ekf, comparison, rho, config)
    followed = follow_verdict(axis, ekf, comparison, drift, reckoning.theta_rad, corrects_heading)
    if axis.was_accepted and axis.diagnosis.found is Hypothesis.WELL:
        difference = heading_rad - reckoning.theta_rad
        noise = axis.frame_noise.with_heading(
            t_ns, difference, variance, config.gyro_noise, config.heading_correlation_s
        )
        axis = axis._replace(frame_noise=noise)
    return axis, followed


def update_diagnosis(
    axis: CorridorAxis, ekf: CorridorEKF, new: HeadingComparison, rho: float, config: FusionConfig
) -> tuple[CorridorAxis, Slope | None]:
    """Add a frame to the evidence and judge if due; return the fitted slope of frames minus prediction, if judged.

    Parameters
    ----------
    axis, ekf
        As in `fusion.estimator.axis_acquisition.acquire`; the axis with the newest frame's innovation.
    new
        The newest frame with gyroscope and IMU yaw.
    rho
        Correlation of its error with that of the frame before.
    """
    before = axis.diagnosis
    normalised = 0.0 if axis.gate is None else axis.gate.residual / sqrt(axis.gate.variance)
    elapsed_s = (new.t_ns - axis.recent[-2].t_ns) * 1e-9 if len(axis.recent) > 1 else 0.0
    interval_s = min(elapsed_s, MAX_INTERVAL_S)
    innovations = before.innovations.with_innovation(normalised, interval_s, rho)
    if not isnan(before.straight_bias_rad_s):  # dead reckoning turns with the bend, the anchor does not
        axis = axis._replace(anchor_rad=axis.anchor_rad + bend_rate(before, ekf) * elapsed_s)
    kept = exp(-interval_s / SHORT_S)
    rejected_share = kept * before.rejected_share + (0.0 if axis.was_accepted else 1.0 - kept)
    noise = _inertial_noise(config, axis.frame_noise.gyro_scale)
    beside = GyroAndYaw(new.t_ns, new.raw_theta_rad, new.yaw_rad, new.bias_rad_s, new.bias_variance)
    comparisons = add_comparison(before.comparisons, new, round(0.9 * VOTE_SPACING_S * 1e9))
    now = before._replace(
        rejected_share=rejected_share,
        innovations=innovations,
        comparisons=comparisons,
        verdict=Verdict(),
        jump_rad=gyro_jump_between_frames(before.comparisons, new, float(ekf.x[BIAS])),
        yaw_probabilities=before.yaw_probabilities.compared(beside, noise),
    )
    if now.jump_rad:
        now = now._replace(reported=ReportedFault(Hypothesis.SPIKE, new.t_ns))
    due = now.judged_ns is None or new.t_ns - now.judged_ns >= CHECK_INTERVAL_S * 1e9
    if not (innovations.systematic or due) or comparisons[-1] is not new:
        return axis._replace(diagnosis=now), None
    verdict, drift = _judge_spans(now, ekf, noise)
    now = now.with_verdict(new.t_ns, verdict, due)
    found = now.found
    if found in (Hypothesis.WELL, Hypothesis.GYRO) and not isnan(now.straight_bias_rad_s):
        now = end_bend(now, ekf)
    if found is Hypothesis.SPIKE:
        now = now._replace(comparisons=(new,))
    return axis._replace(diagnosis=now), drift


def _judge_spans(d: Diagnosis, ekf: CorridorEKF, noise: InertialNoise) -> tuple[Verdict, Slope | None]:
    """Judge over each span: the shortest one that shows a fault decides, else the one with the least `WELL`.

    Returns the verdict, and the slope of the frames minus the filter's prediction.
    """
    last = d.comparisons[-MIN_POINTS:]
    jumped = d.innovations.systematic and 2 * sum(not s.linked for s in last) > MIN_POINTS
    frames_rejected = d.rejected_share > REJECTED_SHARE
    drift = Drift(d.comparisons, float(ekf.x[PSI]), noise)
    verdict, evidence = Verdict(), Evidence()
    for span_s in SPANS_S:
        shown = drift.over(span_s)._replace(
            jumped=jumped, frames_rejected=frames_rejected, yaw_probabilities=d.yaw_probabilities
        )
        found = judge(shown, d.found)
        if evidence.gyro is None or found.probability_of(Hypothesis.WELL) < verdict.probability_of(
            Hypothesis.WELL
        ):
            verdict, evidence = found, shown
        if verdict.most_probable is not Hypothesis.WELL:
            break
    if evidence.gyro is None:
        return verdict, None
    by_filter = evidence.gyro.rate_rad_s + float(ekf.x[BIAS]) - evidence.bias_rad_s
    return verdict, evidence.gyro._replace(rate_rad_s=by_filter)


def _inertial_noise(c: FusionConfig, gyro_scale: float) -> InertialNoise:
    return InertialNoise(sqrt(gyro_scale) * c.gyro_noise, c.offset_walk, c.imu_yaw_std_rad, c.gyro_scale_std)


def follow_verdict(
    axis: CorridorAxis,
    ekf: CorridorEKF,
    new: HeadingComparison,
    drift: Slope | None,
    theta_rad: float,
    corrects_heading: bool,
) -> CorridorAxis | None:
    """Correct the filter by the frames if another source is at fault; None if no correction is needed.

    Parameters
    ----------
    axis, ekf, theta_rad, corrects_heading
        As in `fusion.estimator.axis_acquisition.acquire`.
    new, drift
        The newest frame, and the slope of frames minus prediction.
    """
    d = axis.diagnosis
    if d.jump_rad:
        psi_rad = float(ekf.x[PSI])
        found = Recovery(psi_rad - pi * round(d.jump_rad / pi), new.std_rad)
        return recover(axis, ekf, found, new.t_ns, theta_rad, corrects_heading)
    most_probable = d.verdict.most_probable
    followed = not isnan(d.straight_bias_rad_s) and not d.innovations.systematic
    if most_probable in (Hypothesis.GYRO, Hypothesis.BEND) and drift is not None and not followed:
        return follow_drift(axis, ekf, drift, new.t_ns, theta_rad, corrects_heading)
    spiked = most_probable is Hypothesis.SPIKE and d.rejected_share > 0.5
    if spiked and new.linked and not axis.was_accepted:
        found = Recovery(new.heading_rad + axis.facing_rad, new.std_rad)
        return recover(axis, ekf, found, new.t_ns, theta_rad, corrects_heading)
    return None


def bend_rate(d: Diagnosis, ekf: CorridorEKF) -> float:
    """Return the estimated rate at which the axis turns, rad/s; zero for a straight corridor."""
    straight = d.straight_bias_rad_s
    return 0.0 if isnan(straight) else straight - float(ekf.x[BIAS])


def end_bend(d: Diagnosis, ekf: CorridorEKF) -> Diagnosis:
    """Restore the bias from before a bend that has ended."""
    x = ekf.x.copy()
    x[BIAS] = d.straight_bias_rad_s
    ekf.predict(x, np.eye(N_STATES), np.zeros((N_STATES, N_STATES)))
    return d._replace(straight_bias_rad_s=nan)


def _with_bias(d: Diagnosis, bias_rad_s: float, variance: float) -> Diagnosis:
    """Replace the biases stored with the evidence, after a step of the filter's bias or a bend."""
    comparisons = tuple(s._replace(bias_rad_s=bias_rad_s, bias_variance=variance) for s in d.comparisons)
    return d._replace(comparisons=comparisons)


def follow_drift(
    axis: CorridorAxis, ekf: CorridorEKF, found: Slope, t_ns: int, theta_rad: float, corrects_heading: bool
) -> CorridorAxis:
    """Correct heading and bias by a line fitted to frames that drift away from the gyroscope.

    The covariance is widened by ``v v'`` with v = (now, -rate) for heading and bias, so that an update with the
    heading on the fitted line corrects both.

    Parameters
    ----------
    axis, ekf, t_ns, theta_rad, corrects_heading
        As in `fusion.estimator.axis_acquisition.acquire`.
    found
        The fitted line.
    """
    now = axis.diagnosis
    along = np.zeros(N_STATES)
    along[PSI] = found.now_rad
    along[BIAS] = -found.rate_rad_s
    if corrects_heading:
        along[YAW_OFFSET] = -found.now_rad
    before = float(ekf.x[PSI])
    Q = np.multiply.outer(along, along)
    if not corrects_heading:
        Q[YAW_OFFSET, YAW_OFFSET] += found.now_rad**2
    ekf.predict(ekf.x, np.eye(N_STATES), Q)
    if now.verdict.most_probable is Hypothesis.BEND and isnan(now.straight_bias_rad_s):
        # The filter's bias has absorbed some of the bend's rate by now.
        now = _with_bias(now, now.comparisons[0].bias_rad_s, now.comparisons[0].bias_variance)
        now = now._replace(straight_bias_rad_s=now.comparisons[0].bias_rad_s)
    m = heading_model(ekf.x, before + found.now_rad, found.now_std**2)
    ekf.update(m._replace(residual=found.now_rad))
    if now.verdict.most_probable is Hypothesis.GYRO:
        now = _with_bias(now, float(ekf.x[BIAS]), float(ekf.P[BIAS, BIAS]))
    axis = axis.with_reset(ekf, before)
    axis = axis._replace(votes=(), rival=None, diagnosis=now._replace(innovations=Innovations()))
    return axis.confirmed(ekf, t_ns, theta_rad)
