"""A summary in words: every number where it belongs, and nothing said that is not known."""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion.offline.summary_text import fusion_text, measured_text
from fusion.pictures.measure import IMAGE_DTYPE


def quantity(unit: str, rmse: float | None) -> dict[str, Any]:
    scale = (1.0, 0.5, 3.0)
    words = zip(("rmse", "mae", "max"), scale, strict=True)
    return {"count": 0 if rmse is None else 9} | {
        f"{word}_{unit}": None if rmse is None else rmse * factor for word, factor in words
    }


@pytest.fixture
def summary() -> dict[str, Any]:
    def source(heading_deg: float, offset_norm: float, offset_m: float | None) -> dict[str, Any]:
        return {
            "rows": 10,
            "judged": 9,
            "heading": quantity("rad", radians(heading_deg)),
            "lateral_offset_norm": quantity("norm", offset_norm),
            "lateral_offset_m": quantity("m", offset_m),
        }

    vision = source(0.4, 0.05, None)
    del vision["lateral_offset_m"]
    return {
        "verdict": "warn",
        "checks": [
            {"level": "pass", "name": "Gaps", "value": "none", "meaning": "Fine."},
            {"level": "warn", "name": "Frames used", "value": "70%", "meaning": "Few."},
            {"level": "fail", "name": "Offset", "value": "40 cm", "meaning": "Far."},
        ],
        "flight": "hall",
        "method": "geometric",
        "duration_s": 15.0,
        "counts": {
            "frames": 20,
            "accepted": 15,
            "estimates": 3001,
            "by_reason": {"ok": 15, "gate": 4, "blur": 1},
        },
        "timings": {"times_real_time": 8.04, "vision_ms_median": 3.44, "total_s": 1.87},
        "status_share": {"tracking": 0.9, "coasting": 0.1},
        "corridors": [{"index": 0, "turn_rad": 0.0, "frames": 20}],
        "errors": {
            "filter": source(0.2, 0.03, 0.033),
            "smoothed": source(0.1, 0.02, 0.022),
            "vision": vision,
        },
        "problems": ["imu0/data.csv: the last line is cut short, dropped"],
        "config": {"corridor_width_m": 2.2},
    }


def lines_of(summary: dict[str, Any]) -> dict[str, str]:
    """What stands behind each name, single spaces between."""
    return {
        line[:14].strip(): " ".join(line[14:].split())
        for line in fusion_text(summary, Path("out/hall")).splitlines()
    }


def test_the_table_holds_every_number(summary: dict[str, Any]) -> None:
    lines = lines_of(summary)
    assert lines["filter"] == "0.20 0.10 0.60 3.30 1.65 9 of 10"
    assert lines["smoother"] == "0.10 0.05 0.30 2.20 1.10 9 of 10"
    assert lines["vision alone"] == "0.40 0.20 1.20 5.50 2.75 9 of 10"
    assert lines["frames used"] == "15 of 20 (75.0%)"
    assert lines["rejected"] == "4 gate, 1 blur"
    assert lines["speed"] == "8.0 times real time: 1.9 s, 3.4 ms a frame (median)"
    assert lines["outputs"] == "out/hall (open out/hall/report.html)"
    assert "cut short" in lines["problem"]


def test_what_is_wrong_stands_under_the_verdict_worst_first(summary: dict[str, Any]) -> None:
    text = fusion_text(summary, Path("out"))
    assert (
        text.index("verdict       warn")
        < text.index("fail: Offset: 40 cm. Far.")
        < text.index("warn: Frames")
    )
    assert "Gaps" not in text


def test_offsets_without_a_width_are_shares_of_it(summary: dict[str, Any]) -> None:
    for source in ("filter", "smoothed"):
        summary["errors"][source]["lateral_offset_m"] = quantity("m", None)
    summary["config"]["corridor_width_m"] = None
    lines = lines_of(summary)
    assert "%" in lines["error"]
    offsets = [lines[name].split()[3] for name in ("filter", "smoother", "vision alone")]
    assert offsets == ["3.00", "2.00", "5.00"]


def test_without_truth_no_error_is_claimed(summary: dict[str, Any]) -> None:
    summary["errors"] = None
    text = fusion_text(summary, Path("out"))
    assert "corridor_truth.csv" in text
    assert "RMSE" not in text


def test_what_could_not_be_judged_is_a_dash(summary: dict[str, Any]) -> None:
    summary["errors"]["vision"]["heading"] = quantity("rad", None)
    summary["errors"]["vision"]["lateral_offset_norm"] = quantity("norm", None)
    summary["timings"] |= {"times_real_time": None, "vision_ms_median": None}
    lines = lines_of(summary)
    assert lines["vision alone"].startswith("- - - - - 9")
    assert lines["speed"] == "1.9 s"


def test_a_flight_through_two_corridors_names_the_turn(summary: dict[str, Any]) -> None:
    summary["corridors"].append({"index": 1, "turn_rad": radians(-65), "frames": 7})
    assert "0 (20 frames), then 1 (7 frames, 65 degrees left of the first)" in fusion_text(
        summary, Path("out")
    )


def test_pictures_are_counted_by_reason() -> None:
    table = np.zeros(4, IMAGE_DTYPE)
    table["reason"] = ["ok", "unreadable", "ok", "blur"]
    text = measured_text(table, Path("t.csv"), Path("drawn"))
    assert text == "4 pictures: 2 measured, 1 unreadable, 1 blur; table in t.csv; drawings in drawn"
