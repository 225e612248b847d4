"""Rows of a fleet, their journal and tables, and what a comparison says of two of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.cli.batch_text import batch_text
from fusion.evaluation.checks import CHECKS
from fusion.fleet.batch import Fleet
from fusion.fleet.comparison import Change, compare_fleets
from fusion.fleet.journal import JOURNAL, Journal, read_journal
from fusion.fleet.page import LISTED, render_page
from fusion.fleet.quantities import QUANTITIES, worst_first_key
from fusion.fleet.row import CHECK_NAMES, COLUMNS, CheckOutcome, FleetRow, column_facts, flat, row_from
from fusion.fleet.tables import read_fleet, write_tables
from fusion.result.summary import Level
from tests.files import ROOT, written
from vision import InputError

GOOD = FleetRow(
    flight="hall",
    verdict="pass",
    vehicle="owl",
    date="2026-03-01T10:00:00Z",
    output="flights/hall",
    duration_s=12.5,
    frames=250,
    frames_used_share=0.96,
    tracking_share=0.98,
    failing_checks=0,
    warning_checks=0,
    heading_rmse_rad=0.002,
    heading_std_rad=0.0015,
    longest_without_frame_s=0.4,
    log_hash="aa",
    config_hash="c1",
    version="1",
    checks={"frames_used": CheckOutcome(Level.PASS, "96.0% of 250")},
)
BAD = FleetRow(flight="torn", verdict="unusable", reason='is "empty", \ncopy <it> again', date="2026-03-02")


def rows_strategy() -> st.SearchStrategy[FleetRow]:
    text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8)
    number = st.none() | st.floats(allow_nan=False, allow_infinity=False, width=32)
    return st.builds(
        replace,
        st.just(GOOD),
        reason=text,
        vehicle=text,
        frames=st.none() | st.integers(0, 2**40),
        heading_rmse_rad=number,
        camera_late_s=number,
        lost_workers=st.integers(0, 3),
        checks=st.dictionaries(
            st.sampled_from(list(CHECK_NAMES)),
            st.builds(CheckOutcome, st.sampled_from(list(Level)), text),
            max_size=3,
        ),
    )


@given(rows_strategy())
def test_a_row_comes_back_from_its_columns(row: FleetRow) -> None:
    assert row_from(flat(row)) == row


def test_every_check_has_its_columns() -> None:
    names = [facts.name for facts in column_facts()]
    assert len(CHECK_NAMES) == len(CHECKS)
    assert len(set(names)) == len(names) == len(COLUMNS) + 2 * len(CHECKS)
    assert names == list(flat(GOOD))
    assert all(facts.meaning for facts in column_facts())


def test_columns_of_other_versions_are_passed_over() -> None:
    values: dict[str, Any] = flat(GOOD) | {
        "invented_later": 3,
        "check_of_old_level": "fail",
        "check_of_old_value": "9",
    }
    del values["frames"]
    row = row_from(values)
    assert row.frames is None
    assert row.checks["of_old"] == CheckOutcome(Level.FAIL, "9")


def test_a_journal_survives_a_cut_line(tmp_path: Path) -> None:
    journal = Journal(tmp_path, [GOOD])
    journal.add(BAD)
    journal.add(replace(GOOD, frames=3))
    journal.close()
    assert read_journal(tmp_path) == {"hall": replace(GOOD, frames=3), "torn": BAD}
    data = (tmp_path / JOURNAL).read_bytes()
    for cut in range(0, len(data), 97):
        (tmp_path / JOURNAL).write_bytes(data[:cut])
        assert read_journal(tmp_path).keys() <= {"hall", "torn"}
    Journal(tmp_path, read_journal(tmp_path).values()).close()  # begins anew with whole lines
    assert all(line.endswith("}") for line in (tmp_path / JOURNAL).read_text().splitlines())


def test_tables_come_back(tmp_path: Path) -> None:
    write_tables([GOOD, BAD], tmp_path)
    assert read_fleet(tmp_path) == [GOOD, BAD]
    assert read_fleet(tmp_path / "fleet.csv") == [GOOD, BAD]


def test_parquet_says_what_its_columns_mean(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    write_tables([GOOD, BAD], tmp_path)
    field = pq.read_schema(tmp_path / "fleet.parquet").field("heading_rmse_rad")
    assert field.metadata == {b"unit": b"rad", b"description": b"RMSE of the heading"}
    assert pq.read_table(tmp_path / "fleet.parquet")["reason"].to_pylist() == [None, BAD.reason]


def test_without_pyarrow_there_is_the_csv(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tables([GOOD], tmp_path)
    monkeypatch.setattr("fusion.fleet.tables.has_parquet", lambda: False)
    with pytest.raises(InputError, match=r"pyarrow.*pip install"):
        read_fleet(tmp_path / "fleet.parquet")
    assert read_fleet(tmp_path) == [GOOD]


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "flight,frames\nx,many\n", "flight,check_a_level\nx,superb\n"]
)
def test_what_is_no_fleet_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"table|cannot be read"):
        read_fleet(written(tmp_path / "fleet.csv", text))


def test_the_worst_come_first() -> None:
    rows = [
        GOOD,
        replace(GOOD, flight="off", heading_rmse_rad=0.004),
        replace(GOOD, flight="warned", verdict="warn", warning_checks=1),
        replace(GOOD, flight="failing", verdict="fail", failing_checks=1),
        replace(GOOD, flight="failing twice", verdict="fail", failing_checks=2),
        BAD,
        replace(BAD, flight="died", verdict="error"),
    ]
    ordered = [row.flight for row in sorted(rows, key=worst_first_key)]
    assert ordered == ["died", "torn", "failing twice", "failing", "warned", "off", "hall"]


# Comparison


def became(**changes: Any) -> Change:
    (change,) = compare_fleets([GOOD], [replace(GOOD, **changes)]).changes
    return change.change


def test_what_became_of_a_flight() -> None:
    assert became() is Change.SAME
    assert became(heading_rmse_rad=0.001) is Change.BETTER
    assert became(heading_rmse_rad=0.003) is Change.WORSE
    assert became(heading_rmse_rad=0.00205) is Change.SAME  # 2.5 %
    assert became(heading_rmse_rad=0.001, frames_used_share=0.7) is Change.MIXED
    assert became(heading_rmse_rad=0.001, verdict="warn") is Change.WORSE  # the verdict decides
    assert became(gyro_bias_rad_s=1.0, times_real_time=0.1) is Change.SAME  # neither is better or worse
    assert became(verdict="error", heading_rmse_rad=None) is Change.WORSE


@given(rows_strategy(), rows_strategy())
def test_there_and_back_again_is_the_opposite(a: FleetRow, b: FleetRow) -> None:
    opposite = {Change.BETTER: Change.WORSE, Change.WORSE: Change.BETTER}
    (there,) = compare_fleets([a], [replace(b, verdict="fail")]).changes
    (back,) = compare_fleets([replace(b, verdict="fail")], [a]).changes
    assert back.change is opposite[there.change]
    assert compare_fleets([a], [a]).changes[0].change is Change.SAME


def test_flights_are_known_by_name_or_content() -> None:
    moved = replace(GOOD, flight="moved", heading_rmse_rad=0.004, config_hash="c2")
    found = compare_fleets([GOOD, BAD], [moved, replace(BAD, flight="new")])
    assert [change.flight for change in found.changes] == ["moved"]
    assert (found.only_before, found.only_after) == (("torn",), ("new",))
    assert found.settings == (frozenset({"c1", ""}), frozenset({"c2", ""}))
    (median,) = [m for m in found.medians if m.quantity.column == "heading_rmse_rad"]
    assert (median.flights, median.before, median.after) == (1, np.degrees(0.002), np.degrees(0.004))


def test_a_check_that_came_out_differently_is_told() -> None:
    worse = replace(GOOD, checks={"frames_used": CheckOutcome(Level.FAIL, "10.0% of 250")})
    (change,) = compare_fleets([GOOD], [worse]).changes
    assert change.checks == (("Frames used", Level.PASS, Level.FAIL),)


# The page


def fleet(count: int) -> list[FleetRow]:
    """Flights of three vehicles over a month; the heading error of one of them drifts."""
    rng = np.random.default_rng(1)
    rows = []
    for k in range(count):
        error = 0.002 + (0.0004 * k if k % 3 == 0 else 0.0) + 0.0002 * float(rng.normal())
        date = f"2026-03-{1 + k * 28 // count:02d}"
        row = replace(GOOD, flight=f"f{k}", vehicle=f"mav{k % 3}", date=date, heading_rmse_rad=error)
        rows.append(
            replace(row, output=f"flights/f{k}", camera_late_s=0.001 * k, frames_used_share=0.9 + 0.001 * k)
        )
    return rows


def test_the_page_shows_what_matters(tmp_path: Path) -> None:
    rows = [*fleet(30), BAD, replace(GOOD, flight="<b>", vehicle="&co")]
    text = render_page(rows, tmp_path, 40, [replace(row, heading_rmse_rad=0.1) for row in fleet(30)])
    assert "32 of 40 flights so far" in text
    assert "copy &lt;it&gt; again" in text
    assert "&lt;b&gt;" in text
    assert "<b>" not in text
    for title in (
        "Comparison with the earlier batch",
        "By vehicle",
        "Distributions",
        "Trends over date and vehicle",
    ):
        assert title in text
    assert "30 better" in text
    assert "Trend: median of the earlier half" in text
    assert text.count("<svg role") >= 8
    assert all(quantity.title in text for quantity in QUANTITIES if len(quantity.values(rows)))


def test_terminal_and_page_tell_the_same_medians(tmp_path: Path) -> None:
    errors = (0.001, 0.002, 0.004, 0.009)  # an even number: the median is between the middle two
    rows = [replace(GOOD, flight=f"f{k}", heading_rmse_rad=error) for k, error in enumerate(errors)]
    told = batch_text(Fleet(tuple(rows), 0, 1.0), tmp_path)
    assert "median 0.17°" in told
    assert "worst 0.52°" in told
    assert "<dd>0.17°" in render_page(rows, tmp_path, 4)


@pytest.mark.parametrize(("duration_s", "text"), [(12.0, "12 s"), (240.0, "4 min"), (9000.0, "2.5 h")])
def test_the_time_flown_has_a_unit_of_its_size(tmp_path: Path, duration_s: float, text: str) -> None:
    assert f"{text} of flight" in render_page([replace(GOOD, duration_s=duration_s)], tmp_path, 1)


def test_a_page_of_few_or_bad_flights_is_one_too(tmp_path: Path) -> None:
    for rows in ([], [BAD], [GOOD], [GOOD, BAD], [replace(GOOD, date="when?", heading_rmse_rad=None)] * 4):
        text = render_page(rows, tmp_path, len(rows))
        assert "Flights, worst first" in text
        assert text.rstrip().endswith("</html>")


def test_a_long_list_is_cut(tmp_path: Path) -> None:
    text = render_page(fleet(LISTED + 50), tmp_path, LISTED + 50)
    assert text.count('<th class="name">') == LISTED
    assert f"The worst {LISTED} of {LISTED + 50}" in text


def test_the_documentation_names_every_column() -> None:
    text = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
    missing = [name for name in COLUMNS if f"`{name}`" not in text]
    assert missing == []
