"""What follows where frames drift from the prediction: asks who is wrong, and lets heading, bias or axis follow.

`fusion.estimator.hypotheses` decides; this module gathers its evidence frame by frame and acts on the verdict.
"""

from __future__ import annotations

from math import exp, isnan, nan, sqrt
from typing import TYPE_CHECKING

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.corridor_axis import VOTE_SPACING_S, CorridorAxis, Told
from fusion.estimator.hypotheses import (
    MIN_POINTS,
    SHORT_S,
    SPANS_S,
    Evidence,
    Hypothesis,
    Sight,
    Slope,
    Verdict,
    judge,
    slopes,
    with_sight,
)
from fusion.estimator.models import BIAS, N_STATES, PSI, YAW_OFFSET, heading_model

if TYPE_CHECKING:
    from fusion.estimator.ekf import CorridorEKF


REFUSED_SHARE = 0.25  # one gross frame of ten is none of the gyroscope's


def weigh(
    axis: CorridorAxis,
    ekf: CorridorEKF,
    new: Sight,
    normalised: float,
    rho: float,
    config: FusionConfig,
    refused: bool,
) -> tuple[CorridorAxis, Slope | None]:
    """Ask who is wrong, and return what frames minus gyroscope showed.

    Parameters
    ----------
    axis, ekf
        As in `start`.
    new
        The newest frame beside what gyroscope and IMU yaw say.
    normalised
        Its innovation, over its standard deviation.
    rho
        Correlation of its error with that of the frame before.
    refused
        Whether the gate rejected it.
    """
    interval_s = 0.5
    if axis.sights:
        interval_s = min((new.t_ns - axis.sights[-1].t_ns) * 1e-9, interval_s)
    innovations = axis.innovations.with_innovation(normalised, interval_s, rho)
    if not isnan(axis.straight_bias_rad_s):  # dead reckoning turns with the bend, the anchor does not
        axis = axis._replace(anchor_rad=axis.anchor_rad + bend_rate(axis, ekf) * interval_s)
    kept = exp(-interval_s / SHORT_S)
    share = 1.0 - kept + kept * axis.refused_share if refused else kept * axis.refused_share
    axis = axis._replace(
        refused_share=share,
        innovations=innovations,
        sights=with_sight(axis.sights, new, round(0.9 * VOTE_SPACING_S * 1e9)),
    )
    due = axis.judged_ns is None or new.t_ns - axis.judged_ns >= SHORT_S * 1e9
    if not (innovations.systematic or due) or axis.sights[-1] is not new:
        return axis._replace(verdict=Verdict()), None
    last = axis.sights[-MIN_POINTS:]
    jumped = innovations.systematic and 2 * sum(not s.linked for s in last) > MIN_POINTS
    walks = (config.gyro_noise, config.offset_walk)
    bias = float(ekf.x[BIAS]) + bend_rate(axis, ekf)
    verdict, gyro = Verdict(), None
    for span_s in SPANS_S if innovations.systematic else SPANS_S[-1:]:
        drift, yaw = slopes(axis.sights, span_s, float(ekf.x[PSI]), bias, walks)
        # Wander of gyroscope and IMU yaw, and the yaw's own noise; of a line fitted to it, the ends count for most.
        apart = (1.2 * (walks[0] ** 2 + walks[1] ** 2) + 2.0 * config.imu_yaw_std_rad**2 / span_s) / span_s
        found = judge(Evidence(drift, yaw, sqrt(apart), jumped, share > REFUSED_SHARE), axis.found)
        if gyro is None or found.of(Hypothesis.WELL) < verdict.of(Hypothesis.WELL):
            verdict, gyro = found, drift
    axis = axis._replace(judged_ns=new.t_ns, found=verdict.likeliest)
    if innovations.systematic or verdict.likeliest is not Hypothesis.WELL:
        axis = axis._replace(told=Told(verdict.likeliest, new.t_ns))
    if verdict.likeliest in (Hypothesis.WELL, Hypothesis.GYRO) and not isnan(axis.straight_bias_rad_s):
        axis = straight_again(axis, ekf)
    if verdict.likeliest is Hypothesis.SPIKE:
        axis = axis._replace(sights=(new,))
    return axis._replace(verdict=verdict), gyro


def bend_rate(axis: CorridorAxis, ekf: CorridorEKF) -> float:
    """Rate, rad/s, at which the axis is taken to turn; zero where it is straight."""
    straight = axis.straight_bias_rad_s
    return 0.0 if isnan(straight) else straight - float(ekf.x[BIAS])


def straight_again(axis: CorridorAxis, ekf: CorridorEKF) -> CorridorAxis:
    """Take the rate of a bend that has ended off the bias again."""
    x = ekf.x.copy()
    x[BIAS] = axis.straight_bias_rad_s
    ekf.predict(x, np.eye(N_STATES), np.zeros((N_STATES, N_STATES)))
    return axis._replace(straight_bias_rad_s=nan)


def follow_drift(
    axis: CorridorAxis, ekf: CorridorEKF, found: Slope, t_ns: int, theta_rad: float, coupled: bool
) -> CorridorAxis:
    """Let heading and, where the gyroscope is wrong, bias follow frames that drift away from the gyroscope.

    The covariance is widened along the drift, heading and bias together, so that the heading on the fitted line
    corrects both.

    Parameters
    ----------
    axis, ekf, t_ns, theta_rad, coupled
        As in `start`.
    found
        The drift.
    """
    d = np.zeros(N_STATES)
    d[PSI] = found.now_rad
    d[BIAS] = -(found.rate_rad_s - bend_rate(axis, ekf))
    if coupled:
        d[YAW_OFFSET] = -found.now_rad
    before = float(ekf.x[PSI])
    Q = np.multiply.outer(d, d)
    if not coupled:
        Q[YAW_OFFSET, YAW_OFFSET] += found.now_rad**2
    ekf.predict(ekf.x, np.eye(N_STATES), Q)
    if axis.verdict.likeliest is Hypothesis.BEND and isnan(axis.straight_bias_rad_s):
        axis = axis._replace(straight_bias_rad_s=float(ekf.x[BIAS]))
    m = heading_model(ekf.x, before + found.now_rad, found.now_std**2)
    ekf.update(m._replace(residual=found.now_rad))
    axis = axis.stepped(ekf, before)._replace(votes=(), rival=None, sights=axis.sights)
    return axis.confirmed(ekf, t_ns, theta_rad)
