"""Selected frames of the report: those at events, not at regular intervals."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fusion.estimator.tables import Table
from fusion.evaluation.errors import interpolate_truth
from fusion.flight import Flight, FloatArray
from fusion.report.remeasure import delay_ns, measure_frame_again
from fusion.result.result import FusionResult
from fusion.result.table_rows import row_before, runs
from vision.rotations import wrap

MAX_WIDTH_PX, JPEG_QUALITY = 640, 78
SMALL_WIDTH_PX, SMALL_QUALITY = 320, 55  # for the many pictures at the time cursor


@dataclass(frozen=True, slots=True)
class ChosenFrame:
    """A row of the frames table and the reason for its selection."""

    row: int
    why: str


@dataclass(frozen=True, slots=True)
class DrawnFrame:
    """A drawing of a chosen frame; ``picture`` is a data URI, None if the file cannot be decoded."""

    row: int
    why: str
    t_s: float
    picture: str | None
    filter_heading_rad: float
    filter_offset_norm: float
    filter_offset_m: float


def choose_frames(result: FusionResult, flight: Flight, limit: int = 12) -> list[ChosenFrame]:
    """Choose up to ``limit`` frames, in order of time, with a minimum distance.

    Each kind of event offers its frames, the most relevant first; the kinds alternate until the strip is full.
    """
    frames = result.frames
    if not len(frames) or not len(result.estimates):
        return []
    t_s = (frames["timestamp_ns"] - frames["timestamp_ns"][0]) / 1e9
    apart_s = max(0.2, float(t_s[-1]) / (4 * limit))
    offers = [offer for offer in _offers(result, flight) if offer]
    chosen: dict[int, str] = {}
    while offers and len(chosen) < limit:
        for offer in offers:
            while offer:
                row, why = offer.pop(0)
                if all(abs(t_s[row] - t_s[other]) >= apart_s for other in chosen):
                    chosen[row] = why
                    break
            if len(chosen) == limit:
                break
        offers = [offer for offer in offers if offer]
    return [ChosenFrame(row, chosen[row]) for row in sorted(chosen)]


def show_frames(result: FusionResult, flight: Flight, chosen: list[ChosenFrame]) -> Iterator[DrawnFrame]:
    """Measure the chosen frames again, for their lines, and draw the measurements, one frame at a time."""
    table, frames = result.estimates, result.frames
    for item in chosen:
        t_ns = int(frames["timestamp_ns"][item.row])
        k = row_before(table, t_ns - delay_ns(result))
        yield DrawnFrame(
            row=item.row,
            why=item.why,
            t_s=(t_ns - int(frames["timestamp_ns"][0])) / 1e9,
            picture=_picture(result, flight, item.row, MAX_WIDTH_PX, JPEG_QUALITY),
            filter_heading_rad=float(table["heading_rad"][k]),
            filter_offset_norm=float(table["lateral_offset_norm"][k]),
            filter_offset_m=float(table["lateral_offset_m"][k]),
        )


def small_pictures(result: FusionResult, flight: Flight, count: int) -> Iterator[tuple[int, str]]:
    """Draw evenly spaced frames: row of the frames table and picture, without those that cannot be decoded."""
    rows = np.linspace(0, len(result.frames) - 1, min(count, len(result.frames))).round()
    for row in rows.astype(int).tolist():
        picture = _picture(result, flight, row, SMALL_WIDTH_PX, SMALL_QUALITY)
        if picture is not None:
            yield row, picture


def _offers(result: FusionResult, flight: Flight) -> list[list[tuple[int, str]]]:
    frames, table = result.frames, result.estimates
    t_ns = frames["timestamp_ns"]
    used = np.flatnonzero(frames["accepted"])
    everything: list[list[tuple[int, str]]] = [[(int(used[0]), "first frame used")] if used.size else []]
    switches = np.flatnonzero(np.diff(table["corridor_index"])) + 1
    nearest = np.clip(np.searchsorted(t_ns, table["timestamp_ns"][switches]), 0, len(frames) - 1)
    everything.append([(int(k), "a new corridor begins") for k in nearest])
    everything += _rejections(frames)
    ratio = np.where(frames["accepted"], frames["test_ratio"], np.nan)
    everything.append(_largest(ratio, "largest residual accepted", 4))
    rate = np.interp(t_ns, table["timestamp_ns"], np.abs(table["yaw_rate_rad_s"]))
    everything.append(_largest(rate, "turning fastest", 6))
    if flight.truth is not None:
        error = np.abs(wrap(frames["heading_rad"] - interpolate_truth(flight.truth, t_ns).heading_rad))
        everything.append(_largest(np.where(frames["accepted"], error, np.nan), "furthest from the truth", 4))
    offset = np.where(frames["accepted"], np.abs(frames["lateral_offset_norm"]), np.nan)
    everything.append(_largest(offset, "furthest from the centre line", 2))
    if used.size:
        typical = used[np.argsort(frames["heading_std_rad"][used])[used.size // 2]]
        everything.append([(int(typical), "a typical frame")])
    everything.append([(len(frames) - 1, "last frame")])
    return everything


def _rejections(frames: Table) -> list[list[tuple[int, str]]]:
    """For each reason of rejection, the middles of its stretches, longest first."""
    offers = []
    for reason in np.unique(frames["reason"][~frames["accepted"]]):
        stretches = sorted(runs(frames["reason"] == reason), key=lambda run: run[0] - run[1])
        offers.append([((a + b - 1) // 2, "rejected") for a, b in stretches[:6]])
    return offers


def _largest(values: FloatArray, why: str, count: int) -> list[tuple[int, str]]:
    known = np.flatnonzero(np.isfinite(values))
    order = known[np.argsort(-values[known], kind="stable")]
    # More than are shown, because neighbours of a chosen frame are skipped.
    return [(int(k), why) for k in order[: 40 * count]]


def _picture(
    result: FusionResult, flight: Flight, row: int, max_width_px: int, jpeg_quality: int
) -> str | None:
    import cv2

    from vision.overlay import draw_overlay

    seen = measure_frame_again(result, flight, row)
    if seen is None or seen.measurement is None:
        return None
    picture = draw_overlay(seen.image, flight.camera, seen.measurement, footer=False)
    if picture.shape[1] > max_width_px:
        size = (max_width_px, round(picture.shape[0] * max_width_px / picture.shape[1]))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    ok, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode() if ok else None
