"""Run an estimator over a recording with a fault in it, and compare what it reports with the truth.

An instant is *silent* if the status is ``tracking``, no reason is given, and the error is beyond 4 sigma: the one
thing that a controller cannot detect.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isfinite, nan
from typing import Literal

import numpy as np
import numpy.typing as npt

from fusion import CorridorEstimator, Estimate
from tests.fusion.simulated import wrap, wrap_half

from .injections import Injection
from .recording import FloatArray, Recording

BoolArray = npt.NDArray[np.bool_]
Quantity = Literal["heading", "lateral"]

EVERY_NS = 20_000_000
MAX_STEP_S = 0.1  # between two questions, for what one instant counts
SETTLED_S = 2.0
SILENT_SIGMA = 4.0
MAX_SILENT_S = 0.5
TOLD_WITHIN_S = 0.5
OVER_PEER = 1.5
MIN_TRACKING = 0.95
MAX_TOLD_SHARE = 0.02
MAX_EXCEPTIONS = 100
NUMBERS = tuple(name for name, kind in Estimate.__annotations__.items() if kind == "float")
OF_THE_OFFSET = ("lateral offset", "velocity is silent", "range sensor is silent")
NO_CROSS_CHECK = "attitude is silent"  # worth a word, yet it does not say that the heading is wrong


@dataclass(frozen=True, slots=True)
class Bound:
    """What is asked of a fault's flight; errors in degrees, or in per cent of half the width for the lateral offset.

    Parameters
    ----------
    within
        Largest error, while status and reason tell nothing; what is told within 0.5 s may be larger.
    after
        Largest error once ``recovery_s`` have passed since the fault's end; then the status is ``tracking``.
    recovery_s
        Time to recover in.
    told_s
        Within what time of the fault's start status or reason must tell of it; None: only if ``within`` is broken.
    at_once
        Largest error at any instant at which nothing is told: where a sample cannot be, nothing need be waited for.
    by_peer
        Whether ``within`` rises to 1.5 times the worst error of a plain Kalman filter on the same samples.
    over_oracle
        Largest RMSE over that of the oracle, which knows the frames' true errors.
    nees
        Range of the mean of squared error over variance.
    quiet
        Whether nothing may be told: there is no fault.
    """

    within: float = inf
    after: float = inf
    recovery_s: float = 1.0
    told_s: float | None = None
    at_once: float = inf
    by_peer: bool = False
    over_oracle: float | None = None
    nees: tuple[float, float] | None = None
    quiet: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Estimates (n,) against the truth; errors in degrees, or in per cent of half the width."""

    t_s: FloatArray
    error: FloatArray
    std: FloatArray
    tracking: BoolArray
    told: BoolArray
    reasons: tuple[str, ...]
    exceptions: int
    exception: str
    not_finite: int
    resets_taken_back: int

    @property
    def silent(self) -> BoolArray:
        """Where the estimate is wrong and nothing says so."""
        return ~self.told & (np.abs(self.error) > SILENT_SIGMA * self.std)


def is_told(estimate: Estimate, quantity: Quantity) -> bool:
    """Whether status or reason say that the heading, or the offset, is not to be relied on."""
    if estimate.status != "tracking":
        return True
    reasons = reasons_of(estimate, quantity)
    return any(quantity == "lateral" or reason != NO_CROSS_CHECK for reason in reasons)


def reasons_of(estimate: Estimate, quantity: Quantity) -> list[str]:
    """Split the reason into its parts; where the heading is judged, without those of the offset."""
    parts = [part for part in estimate.reason.split("; ") if part]
    return [p for p in parts if quantity == "lateral" or not any(words in p for words in OF_THE_OFFSET)]


def is_sound(e: Estimate) -> bool:
    """Whether every number is finite or, where it may be unknown, NaN."""
    if any(abs(getattr(e, name)) == inf for name in NUMBERS):
        return False
    known = e.status == "initialising" or (isfinite(e.heading_rad) and isfinite(e.heading_std_rad))
    return known and not e.heading_std_rad < 0.0 and not e.lateral_offset_norm_std < 0.0


def fly(recording: Recording, quantity: Quantity = "heading") -> Trace:
    """Give the events in order of arrival, and ask after each that comes 20 ms or more after the last question.

    The truth is that at the time at which the newest sample was taken, whatever its stamp says.
    """
    estimator = CorridorEstimator(recording.config)
    rows: list[tuple[float, float, float, bool, bool]] = []
    reasons: list[str] = []
    exceptions, exception, not_finite, resets, taken_back = 0, "", 0, 0, 0
    newest_ns, next_ns = 0, round(SETTLED_S * 1e9)
    for event in recording.events:
        newest_ns = max(newest_ns, event.true_ns)
        try:
            event.give(estimator)
            if event.arrival_ns < next_ns:
                continue
            next_ns = event.arrival_ns + EVERY_NS
            e = estimator.estimate()
        except Exception as raised:  # any kind is what is counted
            exceptions, exception = exceptions + 1, exception or f"{type(raised).__name__}: {raised}"
            if exceptions >= MAX_EXCEPTIONS:
                break
            continue
        not_finite += not is_sound(e)
        taken_back += e.reset_count < resets
        resets = e.reset_count
        value, std = (
            (e.heading_rad, e.heading_std_rad)
            if quantity == "heading"
            else (e.lateral_offset_norm, e.lateral_offset_norm_std)
        )
        rows.append((newest_ns * 1e-9, value, std, e.status == "tracking", is_told(e, quantity)))
        said = "; ".join(reasons_of(e, quantity))
        reasons.append(f"{e.status}: {said}" if said else e.status)
    t, value, std, tracking, told = np.array(rows or [(0.0, nan, nan, False, False)], float).T
    if quantity == "heading":
        error = np.degrees(wrap(value - np.interp(t, recording.t_s, recording.heading_rad)))
        std = np.degrees(std)
    else:
        error = 100.0 * (value - np.interp(t, recording.t_s, recording.lateral_norm))
        std = 100.0 * std
    return Trace(
        t, error, std, tracking > 0, told > 0, tuple(reasons), exceptions, exception, not_finite, taken_back
    )


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """A fault: what it does and what is asked.

    Parameters
    ----------
    name, group
        What is injected; the row of the list of faults that it belongs to.
    injection
        What it changes; None where the scene or the configuration alone make it.
    bound
        What is asked.
    start_s, end_s
        When it begins, and from when on recovery counts; infinite where it lasts.
    seconds, flights
        Length and number of the simulated flights.
    scene, config
        What differs from the base scene and its configuration.
    quantity
        What is judged.
    """

    name: str
    group: str
    injection: Injection | None
    bound: Bound
    start_s: float = 8.0
    end_s: float = inf
    seconds: float = 20.0
    flights: int = 1
    scene: dict[str, object] = field(default_factory=dict)
    config: dict[str, object] = field(default_factory=dict)
    quantity: Quantity = "heading"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one or several flights with a fault; the worst of each number, the mean of the ratios.

    ``worst`` and ``worst_sigma`` are those while nothing is told, ``told_s`` the time from the fault's start until
    something is (infinite: never), ``failures`` what of the bound is broken.
    """

    worst: float
    within: float
    worst_sigma: float
    silent_s: float
    told_s: float
    after: float
    over_peer: float
    nees: float
    exceptions: int
    failures: tuple[str, ...]
    said: str


def plain_kalman(recording: Recording, t_s: FloatArray) -> FloatArray:
    """Heading (n,) by a Kalman filter of heading and bias with the configured noise and no gate, radians.

    It sees the frames without gross errors, without delay, under their stamps, and the true tilt.
    """
    c = recording.config
    imu = [(e.stamp_ns * 1e-9, *e.values[0]) for e in recording.events if e.kind == "imu"]
    t_imu, _, q, r = np.array(imu).T
    roll, pitch = (
        np.interp(t_imu, recording.t_s, angle) for angle in (recording.roll_rad, recording.pitch_rad)
    )
    rate = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    turn = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t_imu))])
    frames = [
        (e.stamp_ns * 1e-9, e.values[0].heading_rad, e.values[0].heading_std_rad)
        for e in recording.events
        if e.kind == "frame" and e.values[0].accepted and not e.is_gross
    ]
    x, b = frames[0][1], 0.0
    pxx, pxb, pbb = 0.1, 0.0, c.gyro_bias_std_rad_s**2
    at, headings, biases = [frames[0][0]], [x], [b]
    turned = np.interp([f[0] for f in frames], t_imu, turn).tolist()
    for k in range(1, len(frames)):
        t, seen, std = frames[k]
        h = t - frames[k - 1][0]
        x += turned[k] - turned[k - 1] - b * h
        pxx += -2 * h * pxb + h * h * pbb + c.gyro_noise**2 * h
        pxb -= h * pbb
        pbb += c.bias_walk**2 * h
        s = pxx + std**2
        residual = float(wrap_half(seen - x))
        x, b = x + pxx / s * residual, b + pxb / s * residual
        pxx, pxb, pbb = pxx * (1 - pxx / s), pxb * (1 - pxx / s), pbb - pxb * pxb / s
        at.append(t)
        headings.append(x)
        biases.append(b)
    last = np.clip(np.searchsorted(at, t_s, side="right") - 1, 0, None)
    since = np.interp(t_s, t_imu, turn) - np.array(turned)[last]
    return np.asarray(np.array(headings)[last] + since - np.array(biases)[last] * (t_s - np.array(at)[last]))


def longest_s(t_s: FloatArray, where: BoolArray) -> float:
    """Length of the longest run of instants."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    return max((float(t_s[b - 1] - t_s[a]) for a, b in edges.reshape(-1, 2)), default=0.0)


def silent_s(trace: Trace) -> float:
    """Seconds in which the estimate is wrong and nothing says so, in all."""
    lasted_s = np.clip(np.diff(trace.t_s, prepend=trace.t_s[0]), 0.0, MAX_STEP_S)
    return float(lasted_s[trace.silent].sum())


def judge(fault: Fault, trace: Trace, peer_worst: float = 0.0, over_peer: float = nan) -> Outcome:
    """Hold one flight against the fault's bound."""
    bound, t, size = fault.bound, trace.t_s, np.abs(trace.error)
    during = t >= fault.start_s
    within = max(bound.within, OVER_PEER * peer_worst)
    untold = ~trace.told
    after = t >= fault.end_s + bound.recovery_s
    before = {"tracking"} | {r for r, early in zip(trace.reasons, t < fault.start_s, strict=True) if early}
    first = next(
        (
            float(at)
            for at, r in zip(t, trace.reasons, strict=True)
            if at >= fault.start_s and r not in before
        ),
        inf,
    )
    known = np.isfinite(size) & (trace.std > 0.0)
    nees = float(np.mean((size[known] / trace.std[known]) ** 2)) if known.any() else nan
    failures = []
    if trace.exceptions:
        failures.append(f"{trace.exceptions} exceptions")
    if trace.not_finite:
        failures.append(f"{trace.not_finite} not finite")
    if trace.resets_taken_back:
        failures.append("reset count falls")
    if silent_s(trace) > MAX_SILENT_S:
        failures.append("silent")
    if longest_s(t, during & untold & (size > within)) > TOLD_WITHIN_S:
        failures.append("error")
    if np.nanmax(size[during & untold], initial=0.0) > bound.at_once:
        failures.append("jolt")
    if bound.told_s is not None and first - fault.start_s > bound.told_s:
        failures.append("not told")
    if after.any() and isfinite(bound.after):
        if not np.max(size[after]) <= bound.after:  # NaN fails too
            failures.append("not recovered")
        if trace.tracking[after].mean() < MIN_TRACKING:
            failures.append("not tracking again")
    if bound.quiet and trace.told[during].mean() > MAX_TOLD_SHARE:
        failures.append("false alarm")
    quietly = size[during & untold]
    return Outcome(
        worst=float(np.nanmax(quietly, initial=0.0)),
        within=within,
        worst_sigma=float(np.nanmax(quietly / trace.std[during & untold], initial=0.0)),
        silent_s=silent_s(trace),
        told_s=first - fault.start_s,
        after=float(np.nanmax(size[after], initial=0.0)) if after.any() and isfinite(bound.after) else nan,
        over_peer=over_peer,
        nees=nees,
        exceptions=trace.exceptions,
        failures=tuple(failures),
        said=trace.exception or _newly_said(trace, before, fault.start_s),
    )


def _newly_said(trace: Trace, before: set[str], start_s: float) -> str:
    """Return what is said longest from the fault's start on and was not before."""
    later = [r for r, t in zip(trace.reasons, trace.t_s, strict=True) if t >= start_s and r not in before]
    return max(set(later), key=later.count) if later else ""


def merged(fault: Fault, outcomes: list[Outcome]) -> Outcome:
    """Join the outcomes of several flights; what is asked of a mean is judged here."""
    ratio, nees = (float(np.mean([getattr(o, name) for o in outcomes])) for name in ("over_peer", "nees"))
    failures = list(dict.fromkeys(f for o in outcomes for f in o.failures))
    bound = fault.bound
    if bound.over_oracle is not None and not ratio <= bound.over_oracle:
        failures.append("RMSE")
    if bound.nees is not None and not bound.nees[0] <= nees <= bound.nees[1]:
        failures.append("NEES")
    worst = max(outcomes, key=lambda o: (len(o.failures), o.silent_s))
    return Outcome(
        worst=max(o.worst for o in outcomes),
        within=max(o.within for o in outcomes),
        worst_sigma=max(o.worst_sigma for o in outcomes),
        silent_s=max(o.silent_s for o in outcomes),
        told_s=max(o.told_s for o in outcomes),
        after=max(o.after for o in outcomes),
        over_peer=ratio,
        nees=nees,
        exceptions=sum(o.exceptions for o in outcomes),
        failures=tuple(failures),
        said=worst.said,
    )
