"""Checks of the camera's frames: how many were used, why others were not, and whether their clock fits the IMU's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fusion.alignment import clock_of_frames
from fusion.evaluation.verdict import Check, Level, Limits, level_of, not_judged, worst_of
from fusion.flight import Flight
from vision import InputError

if TYPE_CHECKING:
    from fusion.offline.fuse import FusionResult

REASON_WORDS = {
    "ok": "used",
    "too_few_lines": "fewer than four lines meet",
    "ambiguous": "two directions fit equally well",
    "uncertain": "heading too uncertain to use",
    "blur": "turning too fast for the exposure",
    "gate": "disagrees with the filter",
    "unreadable": "picture does not decode",
    "late": "came too late",
}
REASON_ACTION = {
    "too_few_lines": "Look for dark, blank or blurred stretches: light or a wider lens help.",
    "ambiguous": "Log the attitude too if it is missing: doors and shelves then no longer compete.",
    "uncertain": "Few long lines run along the corridor in these views: aim the camera along it.",
    "blur": "Shorten the exposure or turn more slowly.",
    "gate": "Check the camera's focal length, mounting and time offset first: all three look like this.",
    "unreadable": "Pictures are damaged: copy the flight again from the vehicle.",
    "late": "Frames came later than the estimator waits for: set a longer buffer_s in the configuration.",
}
_DAMAGE = ("unreadable", "late")  # no picture of a good log is either


def check_frames_used(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge the share of frames that corrected the filter."""
    frames, name = result.frames, "Frames used"
    limit = f"pass from {limits.accepted_share[0]:.0%}, fail below {limits.accepted_share[1]:.0%}"
    if not len(frames):
        return Check(
            name, Level.FAIL, "No frames", limit, "Vision had nothing to say.", "Check the camera folder."
        )
    share = float(np.mean(frames["accepted"]))
    level = level_of(share, limits.accepted_share)
    value = f"{share:.1%} of {len(frames)}"
    if level is Level.PASS:
        return Check(name, level, value, limit, "Enough frames show the corridor to hold heading and offset.")
    rejected = frames["reason"][~frames["accepted"]]
    words, counts = np.unique(rejected, return_counts=True)
    worst = str(words[np.argmax(counts)])
    meaning = (
        f"Most of the rejected frames are “{worst.replace('_', ' ')}”: {counts.max()} of {len(rejected)}."
    )
    return Check(name, level, value, limit, meaning, REASON_ACTION.get(worst, ""))


def check_rejections(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge the frames that were not used by reason: each has another cause and another remedy."""
    frames, name = result.frames, "Rejected frames by reason"
    good, bad = limits.one_reason_share
    limit = f"pass to {good:.0%}, fail above {bad:.0%} for one reason; damaged or late: pass without any"
    if not len(frames):
        return not_judged(name, limit, "The flight has no frames.")
    words, counts = np.unique(frames["reason"][~frames["accepted"]], return_counts=True)
    if not len(words):
        return Check(name, Level.PASS, "None", limit, "Every frame was used.")
    levels = {}
    for word, count in zip(words.tolist(), counts.tolist(), strict=True):
        level = level_of(count / len(frames), limits.one_reason_share)
        levels[word] = worst_of(level, Level.WARN) if word in _DAMAGE else level
    order = [str(words[k]) for k in np.argsort(-counts, kind="stable")]
    share = dict(zip(words.tolist(), (counts / len(frames)).tolist(), strict=True))
    value = ", ".join(f"{word.replace('_', ' ')} {share[word]:.1%}" for word in order)
    level = worst_of(*levels.values())
    if level is Level.PASS:
        return Check(name, level, value, limit, "No single cause cost many frames.")
    word = next(word for word in order if levels[word] is level)
    meaning = f"“{word.replace('_', ' ').capitalize()}” means: {REASON_WORDS.get(word, word)}."
    return Check(name, level, value, limit, meaning, REASON_ACTION.get(word, ""))


def check_camera_time(result: FusionResult, flight: Flight, limits: Limits) -> Check:
    """Judge whether frames and IMU tell of the same time, by when either turns."""
    good, bad = (1e3 * v for v in limits.late_s)
    name, limit = (
        "Time offset of the camera",
        f"pass to {good:g} ms, fail above {bad:g} ms, if beyond three sigma",
    )
    frames, delay_s = result.frames, result.config.camera_delay_s
    try:
        found = clock_of_frames(
            flight,
            frames["timestamp_ns"] - round(delay_s * 1e9),
            np.where(frames["accepted"], frames["heading_rad"], np.nan),
            frames["heading_std_rad"],
        )
    except InputError:
        return not_judged(
            name, limit, "There is nothing to compare: no frames, or no gyroscope and attitude."
        )
    late_s, std_s = -found.value, found.sigma
    if not found.usable or not std_s <= max(limits.late_std_s, abs(late_s) / 5):
        return not_judged(name, limit, found.sentence)
    value = (
        f"Frames stamped {abs(1e3 * late_s):.0f} ± {1e3 * std_s:.0f} ms {'late' if late_s >= 0 else 'early'}"
    )
    level = level_of(abs(late_s), limits.late_s)
    if level is Level.PASS or abs(late_s) < 3 * std_s:
        meaning = "Pictures and inertial sensors turn at the same time: they share a clock."
        return Check(name, Level.PASS, value, limit, meaning)
    meaning = "The pictures turn later or earlier than the vehicle does: their clocks are not the same."
    now = f", on top of camera_delay_s = {delay_s:g}" if delay_s else ""
    action = f"Run `corridor align --write` on the flight: it measures this offset and puts it right{now}."
    return Check(name, level, value, limit, meaning, action)
