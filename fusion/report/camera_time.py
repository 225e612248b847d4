"""How much later than the IMU's clock the frames are stamped, as far as the innovations tell.

A frame stamped ``d`` late shows the heading of ``d`` earlier: its innovation is ``-d`` times the yaw rate, less what
earlier frames have already pulled the filter to. A cheap look at the filter's own output, good to a tenth of what it
finds up to some 60 ms; ``corridor align`` measures.
"""

from __future__ import annotations

from math import hypot, nan, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion.evaluation import wrap_angle
from fusion.flight import FloatArray

if TYPE_CHECKING:
    from fusion.offline import FusionResult

LEAST_FRAMES = 30
_KEPT = 0.85  # of a frame the filter keeps less than its gain says: successive frames resemble each other
_MODEL_SHARE = 0.1  # what that simplification may cost
_STEP_S = 0.1  # over which the rate is taken: a gyroscope's noise would hide the slope in single samples


class Lateness(NamedTuple):
    """Seconds by which stamps are later than the filter took them to be, and sigma; NaN where nothing tells."""

    late_s: float
    std_s: float


def frames_lateness(result: FusionResult) -> Lateness:
    """Regress the innovations on the yaw rate, allowing for what the filter has followed already."""
    frames, table = result.frames, result.smoothed
    innovation, ratio = frames["innovation_rad"], frames["test_ratio"]
    if len(table) < 3 or np.isfinite(innovation).sum() < LEAST_FRAMES:
        return Lateness(nan, nan)
    t_ns = frames["timestamp_ns"] - round(result.config.camera_delay_s * 1e9)
    rate = _rate(result, t_ns)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = innovation**2 / (ratio * result.config.heading_gate_sigma**2)
    row = np.maximum(np.searchsorted(result.estimates["timestamp_ns"], t_ns, side="left") - 1, 0)
    gain = np.clip(result.estimates["heading_std_rad"][row] ** 2 / variance, 0.0, 1.0)
    known = np.isfinite(innovation) & np.isfinite(rate) & np.isfinite(gain)
    gain = np.where(frames["accepted"] & known, gain, 0.0)
    seen, followed = np.full(len(frames), np.nan), 0.0
    for k in np.flatnonzero(known):
        seen[k] = rate[k] - followed
        followed += _KEPT * gain[k] * seen[k]
    # The smoothed heading follows the frames a little, too: rates that may be nothing but that tell nothing.
    own = sqrt(2) / _STEP_S * float(np.nanmedian(table["heading_std_rad"]))
    if not known.any() or not float(np.median(np.abs(rate[known]))) > 2 * own:
        return Lateness(nan, nan)
    found = _slope(-seen[known], innovation[known])
    return Lateness(found.late_s, hypot(found.std_s, _MODEL_SHARE * found.late_s))


def _rate(result: FusionResult, t_ns: np.ndarray[tuple[int], np.dtype[np.int64]]) -> FloatArray:
    """Rate of the smoothed heading at times (n,), through turns from one corridor into another."""
    table = result.smoothed
    known = np.isfinite(table["heading_rad"])
    if known.sum() < 2:
        return np.full(len(t_ns), np.nan)
    t = table["timestamp_ns"][known]
    heading = np.unwrap(wrap_angle(table["heading_rad"] + table["corridor_turn_rad"])[known])
    half_ns = int(_STEP_S / 2 * 1e9)
    at = [np.interp((t_ns + s * half_ns - t[0]) / 1e9, (t - t[0]) / 1e9, heading) for s in (-1, 1)]
    return np.asarray((at[1] - at[0]) / _STEP_S)


def _slope(x: FloatArray, y: FloatArray) -> Lateness:
    keep = np.ones(len(x), dtype=bool)
    slope = middle = nan
    for _ in range(4):
        a, b = x[keep] - x[keep].mean(), y[keep] - y[keep].mean()
        power = float(a @ a)
        if keep.sum() < LEAST_FRAMES or power <= 0:
            return Lateness(nan, nan)
        slope = float(a @ b) / power
        middle = float(y[keep].mean() - slope * x[keep].mean())
        rest = y - middle - slope * x
        spread = 1.4826 * float(np.median(np.abs(rest[keep])))
        now = np.abs(rest) <= max(5.0 * spread, 1e-9)
        if np.array_equal(now, keep):
            break
        keep = now
    rest = (y - middle - slope * x)[keep]
    a = x[keep] - x[keep].mean()
    score = a * rest  # errors of successive frames resemble each other, and so do the rates
    variance = float(score @ score)
    for lag in range(1, min(20, len(score) // 4)):
        variance += 2 * (1 - lag / 20) * float(score[lag:] @ score[:-lag])
    power = float(a @ a)
    return Lateness(slope, sqrt(max(variance, float(score @ score))) / power)
