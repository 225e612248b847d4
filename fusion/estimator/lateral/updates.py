"""Lateral offset: updates its part of the state by propagation, velocities and frames. Pure functions.

The engine calls `LateralOffset.propagated` in each propagation step, `with_velocity` for each velocity and `fused`
for each accepted frame; `expected` is the prior that vision gets before it measures a frame. This module turns
samples into measurements of the Gaussian-sum filter `gaussian_sum`.
`status` holds this part of the state and decides whether the offset is reported.
"""

from __future__ import annotations

from math import cos, hypot, inf, isfinite, nan, sin
from typing import NamedTuple

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.lateral.gaussian_sum import (
    FIRST_FRAME_S,
    SPEED_SIGMA,
    FrameEvidence,
    OffsetModel,
    OffsetReadout,
    OffsetState,
    compile_filter,
    frame_evidence,
    propagate,
    with_evidence,
    with_roll,
    with_speed,
)
from fusion.estimator.lateral.gaussian_sum import readout as readout_of
from fusion.estimator.lateral.kernels import N_LATERAL, S, V, correct_all
from fusion.estimator.lateral.parallax import compare_walls, compile_parallax, with_parallax
from fusion.estimator.lateral.smoother import OffsetStep
from fusion.estimator.lateral.status import Lateral, reliable, with_frame_outcome
from fusion.estimator.models import PSI, FloatArray, Gate, Vector
from fusion.estimator.records import new_record
from fusion.estimator.sample_times import seconds_since
from fusion.estimator.velocity import Velocity
from vision.lateral.mixture import OffsetMixture
from vision.measurement import FrameMeasurement
from vision.rotations import wrap_axis

PRIOR_STD = 0.1
WIDTH_STD_SHARE = 0.05  # relative standard deviation of a configured width: it varies along a corridor
POINT_ESTIMATE_PROBABILITY = 0.97  # inlier probability of an offset that comes without a likelihood
MAX_FORCE_M_S2 = 300.0  # force and speed beyond these limits are corrupt samples
MAX_SPEED_M_S = 100.0
MAX_POINT_ESTIMATE_NORM = 10.0  # half widths; larger offsets or sigmas carry no information


class MotionStep(NamedTuple):
    """Input of one propagation step of the lateral offset.

    Parameters
    ----------
    dt_s
        Length of the step; 0 s at the first sample.
    heading_rad
        Heading at its start.
    down, accel_m_s2
        Direction of gravity and specific force, both in the body (FRD); the force is None without accelerometer.
    follows_force
        Whether the accelerometer corrects the direction of gravity.
    """

    dt_s: float
    heading_rad: float
    down: Vector
    accel_m_s2: Vector | None
    follows_force: bool = False


class LateralOffset:
    """Feeds samples to the Gaussian-sum filter of the lateral offset.

    Parameters
    ----------
    config
        Settings.
    camera_arm_m
        Position of the camera ahead and right of the body's centre, metres.
    """

    def __init__(self, config: FusionConfig, camera_arm_m: tuple[float, float]) -> None:
        self.config = config
        self.camera_arm_m = camera_arm_m
        self.model = offset_model(config)
        compile_filter()
        compile_parallax()

    def model_of(self, lateral: Lateral) -> OffsetModel:
        """Return the model parameters in use."""
        return lateral.model or self.model

    def with_set_width(self, lateral: Lateral, width_m: float | None) -> Lateral:
        """Set the corridor's width, metres, or None for unknown; the offset in half widths does not change."""
        model = offset_model(self.config.model_copy(update={"corridor_width_m": width_m}))
        path = lateral.offset.path
        lateral = lateral.at_path_end(self.model_of(lateral))
        offset = lateral.offset
        x, P = offset.x.copy(), offset.P.copy()
        inverse, std = model.inverse_half_width
        if width_m is not None:
            x[:, S] = inverse
        P[:, S], P[:, :, S] = 0.0, 0.0
        P[:, S, S] = std**2
        offset = offset._replace(x=x, P=P)
        return lateral._replace(offset=offset, step=OffsetStep(path, offset, is_reset=True), model=model)

    def propagated(self, lateral: Lateral, step: MotionStep) -> Lateral:
        """Propagate by one step."""
        dt_s, heading_rad, down, accel_m_s2, follows_force = step
        if dt_s <= 0.0 and accel_m_s2 is None:
            return lateral if lateral.step is None else lateral._replace(step=None)
        force = usable_force(accel_m_s2)
        offset = propagate(lateral.offset, dt_s, heading_rad, force, down, follows_force)
        return new_record(Lateral, (offset, None, *lateral[2:]))

    def with_velocity(self, lateral: Lateral, x: FloatArray, P: FloatArray, velocity: Velocity) -> Lateral:
        """Update with a level velocity as a measurement of the offset's rate, unless it is out of range.

        The velocity across the corridor is ``w = v_forward sin(psi) + v_right cos(psi)``. Its variance is
        ``(sigma_v^2 + v_along^2 P_psi) max(tau / dt, 1)``: errors that are correlated over tau are treated as white
        errors of samples dt apart.

        Parameters
        ----------
        lateral
            Part of the state.
        x, P
            The heading filter's state and covariance.
        velocity
            The new measurement.
        """
        if not max(abs(velocity.forward_m_s), abs(velocity.sideways_m_s)) < MAX_SPEED_M_S:
            return lateral
        psi = float(x[PSI])
        along = velocity.forward_m_s * cos(psi) - velocity.sideways_m_s * sin(psi)
        across = velocity.forward_m_s * sin(psi) + velocity.sideways_m_s * cos(psi)
        stated = self.config.velocity_std_m_s**2 + along * along * float(P[PSI, PSI])
        interval_s = velocity.times.interval_s  # NaN before the second
        variance = stated * (
            max(self.config.lateral_velocity_time_s / interval_s, 1.0) if interval_s > 0.0 else 1.0
        )
        path, moved = lateral.offset.path, lateral.at_path_end(self.model_of(lateral))
        gate, check = _speed_gate(moved.offset, across, variance), lateral.speed_check
        if gate is not None:
            check = check.with_innovation(gate.residual, gate.variance - variance + stated, interval_s)
        if check.is_contradicted:
            return lateral._replace(speed_gate=gate, speed_check=check)
        offset = with_speed(moved.offset, across, variance)
        step = OffsetStep(path, offset, speed=(across, variance))
        return moved._replace(offset=offset, step=step, speed_gate=gate, speed_check=check)

    def fused(
        self, lateral: Lateral, x: FloatArray, t_ns: int, m: FrameMeasurement, half_m: float
    ) -> Lateral:
        """Update with a frame's offset likelihood, roll correction and wall parallax.

        Parameters
        ----------
        lateral
            Part of the state, after `Lateral.with_section_seen`.
        x
            The heading filter's state.
        t_ns, m
            Time and measurement of the frame.
        half_m
            Half the corridor's width, metres; NaN if unknown.
        """
        dt_s = FIRST_FRAME_S if lateral.t_frame_ns is None else seconds_since(t_ns, lateral.t_frame_ns)
        path, model = lateral.offset.path, self.model_of(lateral)
        offset = lateral.offset
        if isfinite(m.roll_correction_rad) and m.roll_correction_std_rad > 0.0:
            offset = with_roll(offset, m.roll_correction_rad, m.roll_correction_std_rad, dt_s)
        lateral = lateral._replace(offset=offset)
        mixtures = _mixtures_of(m, self.config)
        if lateral.section.is_another_seen or not mixtures:
            return lateral
        evidence = frame_evidence(mixtures, dt_s, float(x[PSI]), self.camera_arm_m)
        evidence = evidence._replace(split_std_rad=m.heading_split_std_rad)
        lateral = lateral.at_path_end(model)
        offset = _with_width(lateral.offset, half_m)
        before = readout_of(offset, model)
        views, parallax = compare_walls(lateral.views, m.wall_profiles, evidence)
        if parallax is not None:
            offset = with_parallax(offset, parallax, model)
        offset = with_evidence(offset, evidence, model)
        after = readout_of(offset, model)
        lateral = lateral._replace(
            offset=offset,
            views=views,
            step=OffsetStep(path, offset, evidence, parallax=parallax),
            t_frame_ns=t_ns,
            gate=_offset_gate(before, evidence, half_m, self.config),
        )
        if after.evidence_age_s == 0.0 and len(offset.x):
            lateral = lateral._replace(t_ns=t_ns, n_used=lateral.n_used + 1)
        return with_frame_outcome(lateral, before, after, t_ns, half_m)

    def expected(self, lateral: Lateral, psi_rad: float, half_m: float) -> tuple[float, float]:
        """Return the predicted offset of the camera and its sigma, half widths; NaN while unknown.

        Parameters
        ----------
        lateral
            Part of the state.
        psi_rad
            Predicted heading at the frame.
        half_m
            Half the corridor's width, metres; NaN if unknown.
        """
        found = reliable(lateral, self.model_of(lateral))
        if not found.known:
            return nan, nan
        side = 1 if cos(psi_rad) >= 0 else -1
        offset = side * found.offset_norm + self._camera_aside(wrap_axis(psi_rad), half_m)
        # Inflated, so that vision still finds the true offset when the filter is wrong.
        return offset, hypot(found.std_norm, PRIOR_STD)

    def _camera_aside(self, heading_rad: float, half_m: float) -> float:
        """Return the camera's offset right of the body's centre, half widths; 0 while no width is known."""
        if not half_m > 0.0:  # NaN fails too
            return 0.0
        ahead_m, right_m = self.camera_arm_m
        return (ahead_m * sin(heading_rad) + right_m * cos(heading_rad)) / half_m


def usable_force(force: Vector | None) -> Vector | None:
    """Return a specific force (3,), m/s^2; None if it is missing or out of range."""
    if force is None:
        return None
    (x, y, z), most = force, MAX_FORCE_M_S2
    return force if -most < x < most and -most < y < most and -most < z < most else None


def offset_model(config: FusionConfig) -> OffsetModel:
    """Return the parameters of the Gaussian sum, with the configured corridor width if there is one."""
    model = OffsetModel()
    if config.corridor_width_m is None:
        return model
    inverse = 2.0 / config.corridor_width_m
    return model._replace(inverse_half_width=(inverse, WIDTH_STD_SHARE * inverse))


def _mixtures_of(m: FrameMeasurement, config: FusionConfig) -> tuple[OffsetMixture, ...]:
    """Return a frame's offset likelihoods; a measurement made elsewhere may hold only an offset and its sigma."""
    if m.offset_evidence:
        return m.offset_evidence
    is_possible = abs(m.lateral_offset_norm) < MAX_POINT_ESTIMATE_NORM  # NaN fails too
    if not (is_possible and 0.0 < m.lateral_offset_norm_std < MAX_POINT_ESTIMATE_NORM):
        return ()
    std = max(m.lateral_offset_norm_std, config.lateral_std_floor_norm)
    values = ([POINT_ESTIMATE_PROBABILITY], [m.lateral_offset_norm], [std], [m.width_per_height])
    return (OffsetMixture(*(np.array(v, dtype=float) for v in values)),)


def _with_width(offset: OffsetState, half_m: float) -> OffsetState:
    """Update the scale of the hypotheses by a known width, if theirs is more uncertain."""
    if not half_m > 0.0 or not len(offset.x):  # NaN fails too
        return offset
    inverse = 1.0 / half_m
    variance = (WIDTH_STD_SHARE * inverse) ** 2
    if not (offset.P[:, S, S] > 2.0 * variance).any():
        return offset
    x, P = offset.x.copy(), offset.P.copy()
    H = np.zeros(N_LATERAL)
    H[S] = 1.0
    correct_all(x, P, H, inverse, variance, inf)
    return offset._replace(x=x, P=P)


def _offset_gate(
    expected: OffsetReadout, evidence: FrameEvidence, half_m: float, config: FusionConfig
) -> Gate | None:
    """Return the innovation of a frame's most probable offset; None while the offset is unknown."""
    if not expected.known or not len(evidence.components):
        return None
    _, offset, variance = evidence.components[int(np.argmax(evidence.components[:, 0]))].tolist()
    aside = evidence.aside_m / half_m if half_m > 0.0 else 0.0
    innovation = float(evidence.side * (offset - aside) - expected.offset_norm)
    return _gate(innovation, variance + expected.std_norm**2, config.lateral_gate_sigma)


def _speed_gate(offset: OffsetState, across_m_s: float, variance: float) -> Gate | None:
    """Return the innovation of a speed across the corridor, m/s, for the most probable hypothesis; None if none."""
    if not len(offset.x):
        return None
    best = int(np.argmax(offset.weight[:-1]))
    v, s = offset.x[best, V].item(), offset.x[best, S].item()
    # v = w s, so w = v / s
    H = np.array([0.0, 1.0, 0.0, -v / s]) / s
    return _gate(across_m_s - v / s, float(H @ offset.P[best] @ H) + variance, SPEED_SIGMA)


def _gate(innovation: float, variance: float, gate_sigma: float) -> Gate:
    ratio = innovation * innovation / (gate_sigma * gate_sigma * variance)
    return Gate(ratio <= 1.0, innovation, ratio, variance)
