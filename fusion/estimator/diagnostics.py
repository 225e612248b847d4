"""Covariance and innovations of the estimator by name, as an autopilot logs them. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, nan
from typing import TYPE_CHECKING

import numpy as np

from fusion.estimator.camera_delay import spread_by_delay
from fusion.estimator.lateral.gaussian_sum import OffsetModel, along_path, moments
from fusion.estimator.models import N_STATES, PSI, STATE_NAMES, FloatArray, Gate

if TYPE_CHECKING:
    from fusion.estimator.state import State

OFFSET_NAMES = (
    "lateral_offset_norm",
    "lateral_velocity_norm_s",
    "lateral_accel_bias_norm_s2",
    "inverse_half_width_1_m",
)


@dataclass(frozen=True, slots=True)
class Covariance:
    """Mean and covariance of all states at one time.

    Parameters
    ----------
    timestamp_ns
        Time of the newest sample; None before any.
    names
        Names of the states, in order; each ends with its unit (``norm``: half widths, positive right of the centre
        line). ``heading_rad`` is unwrapped; ``gyro_bias_rad_s`` is the bias of the source that propagates the
        heading, or minus the rate itself if neither gyroscope nor attitude does. The last four, of the lateral
        offset, are the moments of the hypotheses near the most probable one, and are present only while the offset is
        known.
    mean, matrix
        (n,) and (n, n). The lateral offset has a filter of its own: its covariance with the other states is zero.
    """

    timestamp_ns: int | None
    names: tuple[str, ...]
    mean: FloatArray
    matrix: FloatArray

    def variance(self, row: str, column: str | None = None) -> float:
        """Return the variance of a state, or its covariance with another one, by name; KeyError for no such state."""
        try:
            i = self.names.index(row)
            return float(self.matrix[i, i if column is None else self.names.index(column)])
        except ValueError:
            raise KeyError(f"no state {row!r} {column or ''} among {', '.join(self.names)}") from None


@dataclass(frozen=True, slots=True)
class Innovation:
    """Last measurement of a source minus its prediction, with the outcome of the gate.

    Parameters
    ----------
    value, variance
        Innovation and its variance, that of prediction plus measurement; in the source's unit, and its square.
    test_ratio
        ``value**2 / (gate_sigma**2 * variance)``; above 1 the innovation is beyond the gate.
    accepted
        Whether it was used.
    """

    value: float = nan
    variance: float = nan
    test_ratio: float = nan
    accepted: bool = False


@dataclass(frozen=True, slots=True)
class Innovations:
    """Last innovation of each source; NaN for a source without a measurement so far.

    Parameters
    ----------
    heading
        Heading of frames, rad.
    lateral
        Most probable offset of frames, half widths. It is never rejected: the Gaussian sum weighs it.
    imu_yaw
        Yaw of attitudes, rad.
    velocity
        Speed across the corridor, m/s. It is never rejected: beyond the gate its variance is inflated to the gate.

    Ranges have no innovation: they are fused by medians.
    """

    heading: Innovation
    lateral: Innovation
    imu_yaw: Innovation
    velocity: Innovation


def covariance_of(state: State, model: OffsetModel, known: bool) -> Covariance:
    """Return mean and covariance of a state; ``known`` is whether the lateral offset is.

    The variance of the heading contains those of an estimated camera delay and of the errors that successive frames
    have in common, as in `Estimate.heading_std_rad`; not that of a turn which late gyroscope samples have yet to
    confirm, since it depends on when samples arrive.
    """
    P = state.P.copy()
    if state.t_ns is not None:
        outside = spread_by_delay(state.axis.common_std_rad, state.delay, state.t_ns)
        P[PSI, PSI] = hypot(P[PSI, PSI] ** 0.5, outside) ** 2
    if not known:
        return Covariance(state.t_ns, STATE_NAMES, state.x.copy(), P)
    offset = state.lateral.offset
    mean, cov = moments(along_path(offset, offset.path, model), model)
    n = N_STATES + len(mean)
    matrix = np.zeros((n, n))
    matrix[:N_STATES, :N_STATES], matrix[N_STATES:, N_STATES:] = P, cov
    return Covariance(state.t_ns, STATE_NAMES + OFFSET_NAMES, np.concatenate([state.x, mean]), matrix)


def innovations_of(state: State) -> Innovations:
    """Return the last innovations of a state."""
    gates = (state.axis.gate, state.lateral.gate, state.imu_yaw.gate, state.lateral.speed_gate)
    return Innovations(*(_innovation(gate) for gate in gates))


def _innovation(gate: Gate | None) -> Innovation:
    if gate is None:
        return Innovation()
    return Innovation(gate.residual, gate.variance, gate.test_ratio, gate.accepted)
