"""The article's published figures, and the benchmark that recomputes them."""

from __future__ import annotations

import importlib.util
import math
import sys
from types import ModuleType

import numpy as np
import pytest

from tests.files import HALLWAY, OFFICE, ROOT
from vision.paper.measure import equation_8, position_of

MISPRINTS = [(10, 5), (10, 13), (10, 34), (10, 35), (10, 36), (10, 37), (10, 38), (11, 23)]


@pytest.fixture(scope="module")
def article() -> ModuleType:
    """The benchmark as a module; `benchmarks` is no package."""
    spec = importlib.util.spec_from_file_location("benchmark_article", ROOT / "benchmarks" / "article.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def rows(article: ModuleType) -> np.ndarray:
    loaded: np.ndarray = article.load_rows("frames.csv")
    return loaded


@pytest.fixture(scope="module")
def tables(article: ModuleType) -> np.ndarray:
    loaded: np.ndarray = article.load_rows("tables.csv")
    return loaded


def test_equation_8_gives_279_of_the_287_printed_yaws(rows: np.ndarray) -> None:
    assert len(rows) == 287
    yaw = equation_8(rows["vp_x_px"], rows["vp_y_px"], rows["width_px"], rows["height_px"])
    off = np.abs(np.degrees(yaw) - rows["paper_yaw_deg"])
    assert np.sum(off <= 0.06) == 279
    assert np.sum(off <= 0.02) == 279  # there is a gulf between rounding and a misprint
    wrong = rows[off > 0.06]
    assert list(zip(wrong["figure"].tolist(), wrong["frame"].tolist(), strict=True)) == MISPRINTS


def test_the_horizontal_distance_of_the_text_does_not_give_them(rows: np.ndarray) -> None:
    yaw = equation_8(rows["vp_x_px"], rows["height_px"] / 2, rows["width_px"], rows["height_px"])
    assert np.sum(np.abs(np.degrees(yaw) - rows["paper_yaw_deg"]) <= 0.06) < 20


@pytest.mark.parametrize("figure", range(10, 20))
def test_each_figure_is_as_printed(
    article: ModuleType, rows: np.ndarray, tables: np.ndarray, figure: int
) -> None:
    (line,) = tables[tables["figure"] == figure]
    mine = rows[rows["figure"] == figure]
    assert len(mine) == line["frames"]
    assert mine["frame"].tolist() == list(range(1, line["frames"] + 1))
    for name in ("width_px", "height_px", "toward"):
        assert set(mine[name]) == {line[name]}
    found_rmse, found_mae = article.figure_errors(rows, figure)
    assert article.truncate(found_rmse) == pytest.approx(line["rmse_deg"])
    assert article.truncate(found_mae) == pytest.approx(line["mae_deg"])


def test_overall_is_as_printed(article: ModuleType, tables: np.ndarray) -> None:
    # Left, right, both.
    assert [f"{v:.2f}" for v in article.overall_errors(tables, "rmse_deg")] == ["0.27", "0.31", "0.29"]
    assert [f"{v:.2f}" for v in article.overall_errors(tables, "mae_deg")] == ["0.22", "0.25", "0.24"]


def test_truncation_cuts_and_survives_binary_fractions(article: ModuleType) -> None:
    assert article.truncate(0.3799) == 0.37
    assert article.truncate(0.29) == 0.29


def test_table_1(article: ModuleType) -> None:
    table = article.load_rows("table_1.csv")
    np.testing.assert_allclose(article.computed_yaw_deg(table), table["paper_yaw_deg"], atol=0.06)
    sides = [position_of(row["vp_x_px"], row["width_px"]) for row in table]
    assert sides == table["position"].tolist()


def test_the_printed_article_names_what_counts(
    article: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert article.main([]) == 0
    out = capsys.readouterr().out
    assert "of the printed yaw: 279" in out
    for figure, row in MISPRINTS:
        assert f"    {figure:>6}  {row:>3}  " in out
    assert "RMSE 1.208891, MAE 1.098333" in out  # table 2, the grid method
    assert "RMSE 0.072572, MAE 0.066667" in out  # and the article's


def test_errors_on_a_flight_with_truth(article: ModuleType) -> None:
    if not OFFICE.is_dir():
        pytest.skip("data/office is not in this checkout")
    reference = article.reference_of(OFFICE)
    assert not reference.less_constant
    assert len(reference.frames.t_ns) == len(reference.heading_rad) == len(reference.attitudes) >= 200
    assert math.radians(10) < np.abs(reference.heading_rad).max() < math.radians(45)
    np.testing.assert_allclose(reference.errors_rad(reference.heading_rad + 0.1), 0.1)
    few = article.Reference(
        reference.frames.chosen(range(3)),
        reference.heading_rad[:3],
        False,
        reference.camera,
        reference.attitudes[:3],
    )
    heading, milliseconds = article.measure_all(few, (320, 240))
    assert np.isfinite(heading).all()
    assert (milliseconds > 0).all()
    again, _ = article.measure_all(few, (320, 240))
    np.testing.assert_array_equal(heading, again)


def test_errors_on_a_flight_without_truth_are_less_one_constant(article: ModuleType) -> None:
    if not HALLWAY.is_dir():
        pytest.skip("the flight mononav_hallway is not beside this checkout")
    reference = article.reference_of(HALLWAY)
    assert reference.less_constant
    assert len(reference.frames.t_ns) == 42
    assert reference.errors_rad(reference.heading_rad + 0.3) == pytest.approx(np.zeros(42))
    assert np.ptp(reference.heading_rad) < math.radians(20)  # one corridor, before the turn


def test_slope_ignores_frames_without_an_answer(article: ModuleType) -> None:
    known = np.array([0.0, 0.1, 0.2, 0.3])
    measured = np.array([1.0, 1.05, np.nan, 1.15])
    assert article.slope(measured, known) == pytest.approx(0.5)


def test_default_flights_are_each_there_once(article: ModuleType) -> None:
    names = [folder.name for folder in article.default_flights()]
    assert len(names) == len(set(names))
    if OFFICE.is_dir():
        assert article.default_flights()[0] == OFFICE
