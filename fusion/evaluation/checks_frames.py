"""Checks of the camera's frames: share of used frames, reasons of rejection, and clock offset from the IMU."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt

from fusion.alignment import clock_of_frames
from fusion.evaluation.verdict import CheckRule, Finding, Limits, level_of, nothing_to_judge, worst_of
from fusion.flight import Flight
from fusion.result.result import FusionResult
from fusion.result.summary import Level
from fusion.result.table_rows import held_back_at_junctions
from vision import InputError
from vision.measurement import REASON_MEANING, Reason

REASON_ACTION = {
    "too_few_lines": "Look for dark, blank or blurred views: more light or a wider lens helps.",
    "ambiguous": "Log the attitude too, if it is missing: it rules out the lines of doors and shelves.",
    "uncertain": "These views show few long lines along the corridor: point the camera along it.",
    "blur": "Shorten the exposure or turn more slowly.",
    "gate": "Check the camera's focal length, mounting and time offset first: each of them can cause this.",
    "unreadable": "Pictures are damaged: copy the flight again from the vehicle.",
    "late": "Frames arrived later than the buffer allows: increase buffer_s.",
    "repeated": "The camera sends the same picture again: check its driver and its connection.",
    "ahead": "Check the camera's clock: some frames are stamped far ahead of the other sensors.",
}
_HELD_BACK = "held back at a junction"  # shown instead of gate
TRIED = 20  # unreadable pictures examined for the cause
_DAMAGE = ("unreadable", "late")  # do not occur in a good log


def _share_used(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    frames = result.frames
    if not len(frames):
        return Finding(
            "No frames",
            level=Level.FAIL,
            meaning="There was nothing to measure.",
            action="Check the camera folder.",
        )
    share = float(np.mean(frames["accepted"]))
    text = f"{share:.1%} of {len(frames)}"
    if level_of(share, limits.accepted_share) is Level.PASS:
        return Finding(text, share)
    rejected = _reasons_to_reject(result)
    words, counts = np.unique(rejected, return_counts=True)
    worst = str(words[np.argmax(counts)])
    meaning = (
        f"Most of the rejected frames are “{worst.replace('_', ' ')}”: {counts.max()} of {len(rejected)}."
    )
    cause = _cause(result, flight) if worst == Reason.UNREADABLE else None
    if cause is not None:
        return Finding(text, share, meaning=f"{meaning[:-1]}, {cause[0]}.", action=cause[1])
    return Finding(text, share, meaning=meaning, action=REASON_ACTION.get(worst, ""))


def _cause(result: FusionResult, flight: Flight) -> tuple[str, str] | None:
    """Reason why most unreadable pictures cannot be used although they can be decoded, and the remedy, or None."""
    frames, found = result.frames, Counter[tuple[str, str] | None]()
    t_ns = frames["timestamp_ns"][frames["reason"] == Reason.UNREADABLE]
    t_ns = t_ns - round(result.config.camera_delay_s * 1e9)
    for k in np.flatnonzero(np.isin(flight.frames.t_ns, t_ns))[:TRIED].tolist():
        try:
            picture = flight.frames.read(k)
        except InputError:
            found[None] += 1
            continue
        try:
            flight.camera.require_size(picture.shape[1], picture.shape[0])
        except InputError as error:
            found[error.problem, _sentence(error.remedy or "")] += 1
    return found.most_common(1)[0][0] if found else None


def _sentence(text: str) -> str:
    return text and f"{text[0].upper()}{text[1:]}."


def _reasons_to_reject(result: FusionResult) -> npt.NDArray[np.str_]:
    """Return the reason of each rejected frame; frames held back at a junction are not contradictions."""
    frames = result.frames
    held = held_back_at_junctions(result.estimates, frames)
    reasons: npt.NDArray[np.str_] = np.where(held, _HELD_BACK, frames["reason"])[~frames["accepted"]]
    return reasons


FRAMES_USED = CheckRule(
    name="Frames used",
    measure=_share_used,
    pass_fail=lambda limits: limits.accepted_share,
    limit=lambda limits: (
        f"pass from {limits.accepted_share[0]:.0%}, fail below {limits.accepted_share[1]:.0%}"
    ),
    good="Enough frames show the corridor to track heading and offset.",
)


def _rejections_by_reason(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    """Each reason has its own cause and remedy."""
    frames = result.frames
    if not len(frames):
        return nothing_to_judge("The flight has no frames.")
    words, counts = np.unique(_reasons_to_reject(result), return_counts=True)
    if not len(words):
        return Finding("None", 0.0, level=Level.PASS, meaning="Every frame was used.")
    levels = {}
    for word, count in zip(words.tolist(), counts.tolist(), strict=True):
        if word == _HELD_BACK:  # normal behaviour of the filter
            continue
        level = level_of(count / len(frames), limits.one_reason_share)
        levels[word] = worst_of(level, Level.WARN) if word in _DAMAGE else level
    order = [str(words[k]) for k in np.argsort(-counts, kind="stable")]
    share = dict(zip(words.tolist(), (counts / len(frames)).tolist(), strict=True))
    text = ", ".join(f"{word.replace('_', ' ')} {share[word]:.1%}" for word in order)
    level = worst_of(Level.PASS, *levels.values())
    largest = max((share[word] for word in levels), default=0.0)
    if level is Level.PASS:
        return Finding(text, largest, level=level)
    word = next(word for word in order if levels.get(word) is level)
    cause = _cause(result, flight) if word == Reason.UNREADABLE else None
    if cause is not None:
        return Finding(
            text, largest, level=level, meaning=f"Unreadable pictures: {cause[0]}.", action=cause[1]
        )
    meaning = f"“{word.replace('_', ' ').capitalize()}” means: {REASON_MEANING[Reason(word)]}."
    return Finding(text, largest, level=level, meaning=meaning, action=REASON_ACTION.get(word, ""))


REJECTIONS = CheckRule(
    name="Rejected frames by reason",
    measure=_rejections_by_reason,
    limit=lambda limits: (
        f"pass to {limits.one_reason_share[0]:.0%}, fail above {limits.one_reason_share[1]:.0%} for one reason; "
        "damaged or late: pass if there are none"
    ),
    good="No single reason accounts for many frames.",
)


def _camera_time(result: FusionResult, flight: Flight, limits: Limits) -> Finding:
    """Compare the times of turns in frames and IMU."""
    frames, delay_s = result.frames, result.config.camera_delay_s
    try:
        found = clock_of_frames(
            flight,
            frames["timestamp_ns"] - round(delay_s * 1e9),
            np.where(frames["accepted"], frames["heading_rad"], np.nan),
            frames["heading_std_rad"],
        )
    except InputError:
        return nothing_to_judge("There is nothing to compare: no frames, or neither gyroscope nor attitude.")
    late_s, std_s = -found.value, found.sigma
    if not found.usable or not std_s <= max(limits.late_std_s, abs(late_s) / 5):
        return nothing_to_judge(found.sentence)
    text = (
        f"Frames stamped {abs(1e3 * late_s):.0f} ± {1e3 * std_s:.0f} ms {'late' if late_s >= 0 else 'early'}"
    )
    if abs(late_s) < 3 * std_s:
        return Finding(text, late_s, level=Level.PASS)
    now = f", on top of camera_delay_s = {delay_s:g}" if delay_s else ""
    action = f"Run `corridor align --write` on the flight: it estimates this offset and corrects it{now}."
    level = level_of(abs(late_s), limits.late_s)
    return Finding(text, late_s, level=level, action="" if level is Level.PASS else action)


def _camera_time_limit(limits: Limits) -> str:
    good, bad = (1e3 * v for v in limits.late_s)
    return f"pass to {good:g} ms, fail above {bad:g} ms, if beyond three sigma"


CAMERA_TIME = CheckRule(
    name="Time offset of the camera",
    measure=_camera_time,
    limit=_camera_time_limit,
    good="Pictures and inertial sensors show turns at the same time: their clocks agree.",
    bad="The pictures show turns later or earlier than the inertial sensors: their clocks differ.",
)
