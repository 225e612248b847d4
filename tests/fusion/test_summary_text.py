"""A summary in words: every number where it belongs, and nothing said that is not known."""

from __future__ import annotations

from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion.cli.fuse_text import fusion_text
from fusion.cli.measure_text import measured_text
from fusion.flight import Remark
from fusion.pictures.measure import IMAGE_DTYPE
from fusion.result.summary import (
    Check,
    CorridorStretch,
    Counts,
    ErrorStatistics,
    FlightErrors,
    Level,
    SpeedSummary,
    Summary,
    TableErrors,
)


def quantity(unit: str, rmse: float | None) -> ErrorStatistics:
    if rmse is None:
        return ErrorStatistics(unit, 0)
    return ErrorStatistics(unit, 9, rmse=rmse, mae=0.5 * rmse, max=3 * rmse)


def errors_of(heading_deg: float | None, offset_norm: float | None, metres: ErrorStatistics | None) -> Any:
    heading = quantity("rad", None if heading_deg is None else radians(heading_deg))
    return TableErrors(10, 9, {}, None, heading, metres, quantity("norm", offset_norm), {})


@pytest.fixture
def summary() -> Summary:
    return Summary(
        verdict=Level.WARN,
        checks=(
            Check("Gaps", Level.PASS, "none", "", "Fine."),
            Check("Frames used", Level.WARN, "70%", "", "Few."),
            Check("Offset", Level.FAIL, "40 cm", "", "Far."),
        ),
        flight="hall",
        duration_s=15.0,
        counts=Counts(20, 15, 5, {"ok": 15, "gate": 4, "blur": 1}, 3001),
        timings=SpeedSummary(vision_ms_median=3.44, total_s=1.87, times_real_time=8.04),
        status_share={"tracking": 0.9, "coasting": 0.1},
        corridors=(CorridorStretch(0, 0.0, 0, 1, 20, 15),),
        errors=FlightErrors(
            filter=errors_of(0.2, 0.03, quantity("m", 0.033)),
            smoothed=errors_of(0.1, 0.02, quantity("m", 0.022)),
            vision=errors_of(0.4, 0.05, None),
        ),
        problems=("imu0/data.csv: the last line is cut short, dropped",),
        config={"corridor_width_m": 2.2},
    )


def lines_of(summary: Summary) -> dict[str, str]:
    """What stands behind each name, single spaces between."""
    return {
        line[:14].strip(): " ".join(line[14:].split())
        for line in fusion_text(summary, Path("out/hall")).splitlines()
    }


def test_an_unknown_offset_has_its_reasons(summary: Summary) -> None:
    assert lines_of(summary)["offset"] == "known all the time"
    share = {"width_step": 0.15, "no_offset": 0.1}
    text = fusion_text(replace(summary, lateral_unknown_share=share), Path("out"))
    assert (
        "offset unknown 25.0% of the time: 15.0% frames are held back at a step in width, "
        "10.0% the frames show no offset"
    ) in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 100


def test_what_was_assumed_is_a_note_and_no_problem(summary: Summary) -> None:
    lines = lines_of(replace(summary, problems=(Remark("axes assumed frd"),)))
    assert lines["note"] == "axes assumed frd"
    assert "problem" not in lines


def test_the_table_holds_every_number(summary: Summary) -> None:
    lines = lines_of(summary)
    assert lines["filter"] == "0.20 0.10 0.60 3.30 1.65 9 of 10"
    assert lines["smoother"] == "0.10 0.05 0.30 2.20 1.10 9 of 10"
    assert lines["vision alone"] == "0.40 0.20 1.20 5.50 2.75 9 of 10"
    assert lines["frames used"] == "15 of 20 (75.0%)"
    assert lines["rejected"] == "4 gate, 1 blur"
    assert lines["speed"] == "8.0 times real time: 1.9 s, 3.4 ms a frame (median)"
    assert lines["outputs"] == "out/hall (open out/hall/report.html)"
    assert "cut short" in lines["problem"]


def test_rows_that_were_not_judged_have_a_reason(summary: Summary) -> None:
    assert summary.errors is not None
    errors = replace(
        summary.errors.filter, excluded={"outside_truth": 0, "junction": 1005, "not_tracking": 40}
    )
    lines = lines_of(replace(summary, errors=replace(summary.errors, filter=errors)))
    assert lines["not judged"] == "1005 in a junction, 40 not tracking (rows of the filter)"


def test_what_is_wrong_stands_under_the_verdict_worst_first(summary: Summary) -> None:
    text = fusion_text(summary, Path("out"))
    assert (
        text.index("verdict       warn")
        < text.index("fail: Offset: 40 cm. Far.")
        < text.index("warn: Frames")
    )
    assert "Gaps" not in text


def test_offsets_without_a_width_are_shares_of_it(summary: Summary) -> None:
    none = quantity("m", None)
    errors = FlightErrors(errors_of(0.2, 0.03, none), errors_of(0.1, 0.02, none), errors_of(0.4, 0.05, None))
    lines = lines_of(replace(summary, errors=errors, config={"corridor_width_m": None}))
    assert "%" in lines["error"]
    offsets = [lines[name].split()[3] for name in ("filter", "smoother", "vision alone")]
    assert offsets == ["3.00", "2.00", "5.00"]


def test_without_truth_no_error_is_claimed(summary: Summary) -> None:
    text = fusion_text(replace(summary, errors=None), Path("out"))
    assert "corridor_truth.csv" in text
    assert "RMSE" not in text


def test_the_time_of_compiling_is_told_apart_from_the_speed(summary: Summary) -> None:
    assert summary.timings is not None
    lines = lines_of(replace(summary, timings=replace(summary.timings, compile_s=17.2)))
    assert lines["speed"] == (
        "8.0 times real time: 1.9 s, 3.4 ms a frame (median); plus 17 s of compiling, once"
    )


def test_what_could_not_be_judged_is_a_dash(summary: Summary) -> None:
    assert summary.errors is not None
    errors = replace(summary.errors, vision=errors_of(None, None, None))
    lines = lines_of(replace(summary, errors=errors, timings=SpeedSummary(total_s=1.87)))
    assert lines["vision alone"].startswith("- - - - - 9")
    assert lines["speed"] == "1.9 s"


def test_a_flight_through_two_corridors_names_the_turn(summary: Summary) -> None:
    second = CorridorStretch(1, radians(-65), 1, 2, 7, 7)
    summary = replace(summary, corridors=(*summary.corridors, second))
    assert "0 (20 frames), then 1 (7 frames, 65 degrees left of the first)" in fusion_text(
        summary, Path("out")
    )


def test_pictures_are_counted_by_reason() -> None:
    table = np.zeros(4, IMAGE_DTYPE)
    table["reason"] = ["ok", "unreadable", "ok", "blur"]
    text = measured_text(table, Path("t.csv"), Path("drawn"))
    assert text == "4 pictures: 2 measured, 1 unreadable, 1 blur; table in t.csv; drawings in drawn"
