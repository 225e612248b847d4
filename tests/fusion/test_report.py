from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from importlib.metadata import version
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from fusion.evaluation.checks import run_checks
from fusion.evaluation.checks_input import yaw_steps
from fusion.evaluation.verdict import overall
from fusion.flight import AttitudeStream, Flight, FrameStream, ImuStream
from fusion.logs.pictures.camera_folder import PictureFiles
from fusion.outputs.provenance import provenance
from fusion.report import interactive, write_report
from fusion.report.page import error_rows
from fusion.report.plots import aligned_imu_yaw, plot_heading, plot_offset
from fusion.report.remeasure import interpolated_attitude
from fusion.report.series import band_envelope, broken, envelope, envelope_indices, thin_points
from fusion.report.strip import choose_frames, show_frames
from fusion.result.result import FusionResult
from fusion.result.summary import Check, Level
from fusion.result.table_rows import lateral_unknown_text, runs
from tests.fusion.fused import T0_NS, Fused, make_flight, table_with
from tests.pictures import picture_paths
from vision import InputError

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def by_name(result: FusionResult, flight: Flight) -> dict[str, Check]:
    return {check.name: check for check in run_checks(result, flight)}


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Fused:
    return make_flight(tmp_path_factory.mktemp("swing"))


@pytest.fixture(scope="module")
def page(swing: Fused, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(*swing, path)
    return path.read_text(encoding="utf-8")


def first_group(pattern: str, text: str) -> str:
    """What the first group matches at the first place where the pattern does."""
    match = re.search(pattern, text)
    assert match is not None, pattern
    return match[1]


def test_the_page_states_the_verdict_and_every_check(swing: Fused, page: str) -> None:
    checks = by_name(*swing)
    assert checks["Steps of the IMU's yaw"].level is Level.WARN  # the step that was built in
    assert overall(tuple(checks.values())) is Level.WARN
    assert re.search(r'class="verdict warn" id="verdict">Verdict: warn', page)
    for name in checks:
        assert name.replace("'", "&#39;") in page
    assert page.count('class="badge ') == len(checks)


def test_settings_are_worded_as_in_a_file_of_settings(page: str) -> None:
    assert "noise density of the gyroscope. Not set: as declared in the log" in page
    assert "None:" not in page


def test_the_page_stands_alone(page: str) -> None:
    assert "Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src" in page
    assert re.findall(r"<script[^>]*>", page) == [
        '<script type="application/json" id="flight-data">',
        "<script>",
    ]
    without_script = re.sub(r"(?s)<script>.*?</script>", "", page)
    assert "http:" not in without_script
    assert "https:" not in without_script
    assert not re.search(r'(?:src|href)="(?!data:|#)', without_script)
    assert not re.search(r"url\((?!#)", page)
    ids = re.findall(r'\sid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(#|href="#)([^")]+)', page)) <= set(ids)


def test_the_page_escapes_names_and_shows_numbers_in_degrees(swing: Fused, page: str) -> None:
    assert "<h1>swing &lt;one&gt;</h1>" in page
    rmse_deg = float(first_group(r"<dt>Heading error</dt><dd>([\d.]+)°", page))
    assert rmse_deg == pytest.approx(0.30, abs=0.02)
    assert "corridor_width_m" in page
    assert re.search(r'<tr class="changed"><th><code>corridor_width_m</code></th><td>2</td>', page)


def test_the_page_says_why_the_offset_is_unknown(swing: Fused, page: str) -> None:
    share = swing[0].overview.lateral_unknown_share
    unknown = swing[0].estimates["lateral_status"] == "unknown"
    assert sum(share.values()) == pytest.approx(float(unknown.mean()))
    assert lateral_unknown_text(share) in page


def test_every_plot_comes_wide_and_narrow_with_readable_text(page: str) -> None:
    assert page.count('<div class="wide">') == page.count('<div class="narrow">') == 5
    for kind, across_px, least_px in (("wide", 1000, 10), ("narrow", 360, 8)):
        svg = first_group(rf'(?s)<div class="{kind}">(<svg.*?</svg>)', page)
        width = float(first_group(r'viewBox="0 0 ([\d.]+)', svg))
        sizes = [float(v) for v in re.findall(r"font(?:-size)?: ([\d.]+)px", svg)]
        assert sizes
        assert min(sizes) * across_px / width > least_px
        assert "Time, s" in svg
        assert "Heading, degrees right" in svg


def test_what_scripts_draw_is_what_the_plots_show(swing: Fused, page: str) -> None:
    result, _ = swing
    data = json.loads(first_group(r'(?s)id="flight-data">(.*?)</script>', page))
    assert set(data["charts"]) == {"heading", "offset", "innovations", "states", "errors"}
    heading = data["charts"]["heading"][0]
    assert heading["label"] == "Heading, degrees right"
    series = {s["label"]: s for s in heading["series"]}
    assert next(iter(series)) == "two sigma"
    assert {"filter", "frame used", "truth", "IMU yaw less its offset"} <= set(series)
    table = result.estimates
    t_s = (table["timestamp_ns"] - table["timestamp_ns"][0]) / 1e9
    for name, low, high in (("filter", 0.0, 0.0), ("two sigma", -2.0, 2.0)):
        for key, sigmas in (("y", low), ("high", high)):
            values = np.array(series[name].get(key, series[name]["y"]), dtype=float)
            expected = np.degrees(table["heading_rad"] + sigmas * table["heading_std_rad"])
            x = np.array(series[name]["x"])
            known = np.isfinite(values)
            assert np.allclose(values[known], np.interp(x[known], t_s, expected), atol=0.02)
    for charts in data["charts"].values():
        assert all((np.diff(s["x"]) > 0).all() for chart in charts for s in chart["series"])
    assert data["status"][0][2] == "initialising"
    times = [picture["t"] for picture in data["pictures"]]
    assert times == sorted(times)
    assert len(times) > 10


def test_a_band_in_pieces_keeps_its_hole() -> None:
    ax = Figure().subplots()
    y = np.array([0.0, 1.0, np.nan, 2.0, 3.0, 4.0])
    ax.fill_between(np.arange(6.0), y - 1.0, y + 1.0, color="#0072b2", label="band")
    (band,) = interactive._chart(ax)["series"]
    assert band["x"] == pytest.approx([0.0, 1.0, 3.0 - interactive.GAP_S, 3.0, 4.0, 5.0], abs=2e-4)
    assert band["y"] == [-1.0, 0.0, None, 1.0, 2.0, 3.0]
    assert band["high"] == [1.0, 2.0, None, 3.0, 4.0, 5.0]


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to open the page in")
@pytest.mark.parametrize("width_px", [400, 1280])
def test_a_browser_draws_every_chart_and_the_cursor(swing: Fused, tmp_path: Path, width_px: int) -> None:
    write_report(*swing, tmp_path / "report.html")
    assert CHROMIUM is not None
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", f"--window-size={width_px},900"]
    command = [CHROMIUM, *options, f"--user-data-dir={tmp_path}", "--virtual-time-budget=5000", "--dump-dom"]
    done = subprocess.run(
        [*command, (tmp_path / "report.html").as_uri()], capture_output=True, text=True, timeout=120
    )
    assert done.stdout.count("<canvas") == 8
    assert re.search(r'<html lang="en" class="scripted">', done.stdout)
    assert re.search(r"<output>0\.00 s, initialising; picture of 0\.00 s: ok</output>", done.stdout)


def test_colours_of_the_plots_follow_the_scheme(page: str) -> None:
    svgs = re.findall(r"<svg role=.*?</svg>", page, flags=re.S)
    assert len(svgs) == 10
    css = set(re.findall(r"(--[\w-]+):", page))
    assert {name for svg in svgs for name in re.findall(r"var\((--[\w-]+)\)", svg)} <= css
    texts = [style for svg in svgs for style in re.findall(r'<text style="([^"]*)"', svg)]
    assert texts
    assert all("fill: var(--ink)" in style for style in texts)
    left = {c for svg in svgs for c in re.findall(r"#[0-9a-f]{6}\b", svg)}
    assert left <= {"#000000", "#ffffff"}


def test_the_strip_shows_pictures_of_what_happened(swing: Fused, page: str) -> None:
    result, _ = swing
    pictures = re.findall(
        r'<img src="data:image/jpeg;base64,[\w+/=]{2000,}" alt="Frame at ([\d.]+) s, ([^"]+)"', page
    )
    assert len(pictures) == 12
    assert [float(t) for t, _ in pictures] == sorted(float(t) for t, _ in pictures)
    worst = np.argmax(np.abs(result.frames["innovation_rad"])) / 10.0
    assert any(why == "largest residual accepted" for _, why in pictures)
    assert min(abs(float(t) - worst) for t, _ in pictures) <= 0.25


def test_rejections_turns_and_switches_reach_the_strip(swing: Fused) -> None:
    result, flight = swing
    frames = table_with(
        result.frames,
        accepted=(slice(40, 50), False),
        reason=(slice(40, 50), "gate"),
    )
    frames = table_with(frames, accepted=(80, False), reason=(80, "blur"))
    estimates = table_with(result.estimates, corridor_index=(slice(500, None), 1))
    chosen = {
        c.row: c.why for c in choose_frames(replace(result, frames=frames, estimates=estimates), flight)
    }
    assert chosen[0] == "first frame used"
    assert chosen[44] == "rejected"  # the middle of its stretch
    assert chosen[80] == "rejected"
    assert chosen[100] == "a new corridor begins"  # estimate 500 at 50 Hz is frame 100 at 10 Hz
    assert len(chosen) == 12
    assert min(np.diff(sorted(chosen))) >= 2


def test_a_drawn_frame_carries_the_recorded_verdict(swing: Fused) -> None:
    result, flight = swing
    frames = table_with(result.frames, accepted=(60, False), reason=(60, "gate"))
    result = replace(result, frames=frames)
    (shown,) = show_frames(result, flight, [c for c in choose_frames(result, flight) if c.row == 60])
    assert shown.t_s == pytest.approx(6.0)
    assert shown.picture is not None
    assert shown.picture.startswith("data:image/jpeg;base64,")
    assert shown.filter_heading_rad == pytest.approx(radians(12) * np.sin(2 * np.pi * 6 / 8), abs=0.03)


def test_a_picture_that_is_gone_leaves_the_page_whole(tmp_path: Path) -> None:
    result, flight = make_flight(tmp_path, duration_s=3.0, pictures=False)
    write_report(result, flight, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("no picture</div>") >= 3
    assert "<img" not in page


def test_ten_minutes_stay_under_six_megabytes(swing: Fused, tmp_path: Path) -> None:
    _, short = swing
    result, flight = make_flight(tmp_path, duration_s=600.0, imu_hz=200.0, frame_hz=30.0, pictures=False)
    pictures = picture_paths(short)
    paths = tuple(pictures[k % len(pictures)] for k in range(len(flight.frames.t_ns)))
    refused = np.random.default_rng(1).random(len(paths)) < 0.1
    result.frames["accepted"][refused], result.frames["reason"][refused] = False, "gate"
    flight = replace(flight, frames=FrameStream(flight.frames.t_ns, PictureFiles(paths)))
    write_report(result, flight, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 6e6


def test_an_earlier_report_survives_a_failure(swing: Fused, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("earlier")
    result, flight = swing
    with pytest.raises(AttributeError):
        write_report(replace(result, overview=None), flight, path)  # type: ignore[arg-type]
    assert path.read_text() == "earlier"
    with pytest.raises(InputError, match="cannot be written"):
        write_report(result, flight, path / "report.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_a_bare_flight_is_reported_without_truth_imu_attitude_or_a_single_used_frame(tmp_path: Path) -> None:
    result, flight = make_flight(tmp_path, duration_s=3.0)
    nan_columns = {
        n: (slice(None), np.nan) for n in ("lateral_offset_m", "lateral_offset_std_m", "gyro_bias_rad_s")
    }
    for name in (
        "heading_rad",
        "heading_std_rad",
        "lateral_offset_norm",
        "lateral_offset_norm_std",
        "vision_age_s",
    ):
        nan_columns[name] = (slice(None), np.nan)
    estimates = table_with(result.estimates, status=(slice(None), "initialising"), **nan_columns)
    frames = table_with(
        result.frames,
        accepted=(slice(None), False),
        reason=(slice(None), "too_few_lines"),
        innovation_rad=(slice(None), np.nan),
        test_ratio=(slice(None), np.nan),
        heading_rad=(slice(None), np.nan),
        lateral_offset_norm=(slice(None), np.nan),
    )
    result = replace(result, estimates=estimates, smoothed=estimates.copy(), frames=frames)
    flight = replace(flight, truth=None, imu=None, attitude=None)
    checks = by_name(result, flight)
    assert checks["Frames used"].level is Level.FAIL
    assert "too few lines" in checks["Frames used"].meaning
    assert checks["Longest time without a used frame"].level is Level.FAIL
    for name in ("Heading against truth", "Gyro bias", "Steps of the IMU's yaw", "Innovations over the gate"):
        assert checks[name].level is Level.NOT_JUDGED
    write_report(result, flight, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert 'class="verdict fail"' in page
    assert "nan" not in re.sub(r"base64,[\w+/=]+", "", page).lower().replace("nano", "")


def level_with(swing: Fused, name: str, *, table: str = "frames", **columns: tuple[Any, Any]) -> Level:
    result, flight = swing
    changed: dict[str, Any] = {table: table_with(getattr(result, table), **columns)}
    return by_name(replace(result, **changed), flight)[name].level


def test_each_check_turns_with_what_it_judges(swing: Fused) -> None:
    n = 120
    assert level_with(swing, "Frames used", accepted=(slice(0, 12), False)) is Level.PASS
    assert level_with(swing, "Frames used", accepted=(slice(0, 36), False)) is Level.WARN
    assert level_with(swing, "Frames used", accepted=(slice(0, 80), False)) is Level.FAIL
    gate = "Innovations over the gate"
    assert level_with(swing, gate, test_ratio=(slice(0, 5), 2.0)) is Level.PASS
    assert level_with(swing, gate, test_ratio=(slice(0, 12), 2.0)) is Level.WARN
    assert level_with(swing, gate, test_ratio=(slice(0, n // 2), 2.0)) is Level.FAIL
    ratio = swing[0].frames["test_ratio"]
    sigma = "Innovations against their sigma"
    assert level_with(swing, sigma) is Level.PASS
    assert level_with(swing, sigma, test_ratio=(slice(None), 4.0 * ratio)) is Level.WARN
    assert level_with(swing, sigma, test_ratio=(slice(None), 16.0 * ratio)) is Level.FAIL
    coast = "Longest time without a used frame"
    assert level_with(swing, coast, table="estimates", vision_age_s=(300, 1.9)) is Level.PASS
    assert level_with(swing, coast, table="estimates", vision_age_s=(300, 4.0)) is Level.WARN
    assert level_with(swing, coast, table="estimates", vision_age_s=(300, 11.0)) is Level.FAIL
    assert level_with(swing, coast, table="estimates", status=(slice(300, 310), "lost")) is Level.WARN
    along = "Flying along the corridor"
    assert level_with(swing, along, table="estimates", heading_rad=(slice(100, 240), -1.1)) is Level.PASS
    assert level_with(swing, along, table="estimates", heading_rad=(slice(100, 260), -1.1)) is Level.WARN
    known = "Offset known"
    assert (
        level_with(swing, known, table="estimates", lateral_offset_norm_std=(slice(0, 100), np.nan))
        is Level.PASS
    )
    assert (
        level_with(swing, known, table="estimates", lateral_offset_norm_std=(slice(0, 300), 0.3))
        is Level.WARN
    )
    bias = "Gyro bias"
    assert level_with(swing, bias, table="smoothed", gyro_bias_rad_s=(slice(None), radians(-2))) is Level.WARN
    assert level_with(swing, bias, table="smoothed", gyro_bias_rad_s=(slice(None), radians(6))) is Level.FAIL
    wide = {"heading_std_rad": (slice(None), radians(0.1))}
    assert level_with(swing, "Errors against their sigma") is Level.PASS
    assert level_with(swing, "Errors against their sigma", table="estimates", **wide) is Level.FAIL
    off = {"heading_rad": (slice(None), swing[0].estimates["heading_rad"] + radians(1))}
    assert level_with(swing, "Heading against truth", table="estimates", **off) is Level.WARN
    aside = {"lateral_offset_m": (slice(None), swing[0].estimates["lateral_offset_m"] + 0.4)}
    assert level_with(swing, "Offset against truth", table="estimates", **aside) is Level.FAIL


def test_holes_and_problems_of_the_log_are_told(swing: Fused) -> None:
    result, flight = swing
    assert flight.imu is not None
    imu, there = flight.imu, np.ones(len(flight.imu.t_ns), bool)
    there[(imu.t_ns > T0_NS + 6_000_000_000) & (imu.t_ns < T0_NS + 8_000_000_000)] = False
    accel = None if imu.accel_m_s2 is None else imu.accel_m_s2[there]
    hole = replace(flight, imu=ImuStream(imu.t_ns[there], imu.gyro_rad_s[there], accel))
    check = by_name(result, hole)["Gaps in the log"]
    assert check.level is Level.WARN
    assert "IMU, at 6.0 s" in check.value
    assert "1 gap in" in check.meaning
    torn = replace(flight, problems=("imu0/data.csv: 3 rows of NaN dropped",))
    check = by_name(replace(result, problems=("imu0/data.csv: 3 rows of NaN dropped", "other")), torn)[
        "Input"
    ]
    assert check.level is Level.WARN
    assert check.value == "2 problems"
    assert check.meaning == "The first: imu0/data.csv: 3 rows of NaN dropped."


def test_yaw_steps_are_found_with_time_and_size(swing: Fused) -> None:
    steps = yaw_steps(swing[0].smoothed, radians(3))
    assert [round(t) for t, _ in steps] == [6, 8]
    assert [size for _, size in steps] == pytest.approx([radians(12), -radians(12)], abs=1e-6)
    drifting = swing[0].smoothed.copy()
    drifting["imu_yaw_offset_rad"] = np.linspace(0.0, radians(24), len(drifting))  # 2 degrees a second
    assert yaw_steps(drifting, radians(3)) == []


def test_the_imu_yaw_is_aligned_by_its_offset_but_not_by_the_constant(swing: Fused) -> None:
    result, flight = swing
    assert flight.attitude is not None
    assert flight.truth is not None
    aligned, raw = aligned_imu_yaw(flight.attitude, result.estimates)
    truth = flight.truth.heading_rad
    assert np.abs(aligned - truth).max() < 1e-6
    t = (result.estimates["timestamp_ns"] - T0_NS) / 1e9
    disturbed = (t > 6.1) & (t < 7.9)
    assert np.abs((raw - truth)[~disturbed & (t < 6)]).max() < radians(0.3)
    assert np.mean((raw - truth)[disturbed]) == pytest.approx(radians(12), abs=radians(0.3))


def test_attitude_is_taken_between_its_samples_and_only_near_them(swing: Fused) -> None:
    _, flight = swing
    roll = np.radians([10.0, 12.0])
    q = np.column_stack([np.cos(roll / 2), np.sin(roll / 2), 0 * roll, 0 * roll])
    q[1] *= -1  # the same rotation
    stream = AttitudeStream(np.array([T0_NS, T0_NS + 20_000_000]), q)
    flight = replace(flight, attitude=stream)
    between = interpolated_attitude(flight, T0_NS + 5_000_000)
    assert between is not None
    assert between.roll_rad == pytest.approx(radians(10.5), abs=1e-4)
    assert interpolated_attitude(flight, T0_NS + 520_000_000 + 1_000_000_000) is None
    assert interpolated_attitude(replace(flight, attitude=None), T0_NS) is None


def test_thinning_keeps_extremes_ends_and_holes() -> None:
    t = np.linspace(0.0, 100.0, 200_000)
    y = np.sin(t)
    y[123_456], y[77_777] = 9.0, -9.0
    y[150_000:150_100] = np.nan
    x, thin = envelope(t, y, bins=500)
    assert len(x) <= 2002
    assert np.nanmax(thin) == 9.0
    assert np.nanmin(thin) == -9.0
    assert (x[0], x[-1]) == (t[0], t[-1])
    assert np.isnan(thin).any()
    assert np.all(np.diff(x) >= 0)
    x, low, high = band_envelope(t, y - 1, y + 1, bins=500)
    assert (np.nanmin(low), np.nanmax(high)) == (-10.0, 10.0)
    x, few = thin_points(t, y, limit=1000)
    assert len(x) <= 1010
    assert (few.min(), few.max()) == (-9.0, 9.0)
    assert np.isfinite(few).all()


def test_a_thinned_scatter_still_looks_like_the_whole_one() -> None:
    t, y = np.arange(50_000.0), np.random.default_rng(2).normal(0.0, 1.0, 50_000)
    _, few = thin_points(t, y, limit=3000)
    assert np.mean(np.abs(few) < 0.5) > 0.15  # 0.38 of all; of the extremes of 100 samples nearly none


def test_short_series_are_left_as_they_are() -> None:
    t, y = np.arange(5.0), np.array([1.0, np.nan, 3.0, 2.0, 0.0])
    assert envelope(t, y)[1].tolist()[2:] == [3.0, 2.0, 0.0]
    assert thin_points(t, y)[1].tolist() == [1.0, 3.0, 2.0, 0.0]
    x, cut = broken(t, np.arange(5.0), np.array([2]))
    assert x.tolist() == [0.0, 1.0, 2.0, 2.0, 3.0, 4.0]
    assert np.isnan(cut[2])
    assert runs(np.array([True, True, False, True])) == [(0, 2), (3, 4)]
    assert runs(np.zeros(3, dtype=bool)) == []


@pytest.mark.parametrize("seed", range(20))
def test_an_envelope_keeps_start_extremes_and_first_hole_of_every_interval(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, bins = int(rng.integers(100, 400)), int(rng.integers(2, 20))
    t = np.sort(rng.integers(0, 60, n).astype(float))
    y = rng.normal(size=n).round(1)
    y[rng.uniform(size=n) < rng.choice([0.0, 0.2, 0.9])] = np.nan
    edges = np.searchsorted(t, np.linspace(t[0], t[-1], bins + 1)[1:-1])
    expected = {0, n - 1}
    for start, stop in zip([0, *edges.tolist()], [*edges.tolist(), n], strict=True):
        seen = [k for k in range(start, stop) if not np.isnan(y[k])]
        holes = [k for k in range(start, stop) if np.isnan(y[k])]
        expected |= {*range(start, stop)[:1], *holes[:1]}
        if seen:
            expected |= {min(seen, key=lambda k: y[k]), max(seen, key=lambda k: y[k])}
    assert envelope_indices(t, y, bins).tolist() == (sorted(expected) if n > 4 * bins else list(range(n)))


def test_frames_are_drawn_in_the_metres_of_their_own_corridor(swing: Fused) -> None:
    result, flight = swing
    table, frames = result.estimates.copy(), result.frames.copy()
    later = table["timestamp_ns"] >= T0_NS + 6_000_000_000
    table["corridor_index"][later] = 1
    table["lateral_offset_std_m"] = np.where(later, 1.5, 1.0) * table["lateral_offset_norm_std"]
    frames["lateral_offset_norm"] = 0.5
    ax = Figure().subplots()
    config = result.config.model_copy(update={"corridor_width_m": None})
    told = replace(result, config=config, estimates=table, frames=frames)
    plot_offset(ax, told, replace(flight, truth=None))
    (dots,) = (patch for patch in ax.patches if not patch.get_fill())
    t_s, offset_m = np.asarray(dots.get_path().vertices).T
    np.testing.assert_allclose(offset_m, np.where(t_s < 6.0, 0.5, 0.75))
    walls = [line for line in ax.lines if line.get_label() == "wall"]
    assert sorted({abs(float(y)) for line in walls for y in np.asarray(line.get_ydata()) if y == y}) == [
        1.0,
        1.5,
    ]


def test_a_filter_that_leaves_the_axis_is_marked_at_its_edge(swing: Fused) -> None:
    result, flight = swing
    table = result.estimates.copy()
    wild = slice(100, 120)  # 2.0 to 2.4 s
    table["status"][wild] = "lost"
    table["heading_rad"][wild] = radians(80)
    ax = Figure().subplots()
    plot_heading(ax, replace(result, estimates=table), flight)
    (edge,) = (line for line in ax.lines if line.get_label() == "filter beyond the scale")
    x, y = np.asarray(edge.get_xdata()), np.asarray(edge.get_ydata())
    low, high = ax.get_ylim()
    assert high < 80
    assert (x[y == y].min(), x[y == y].max()) == pytest.approx((2.0, 2.4))
    assert (y[y == y] > low + 0.9 * (high - low)).all()
    ax = Figure().subplots()
    plot_heading(ax, result, flight)
    assert all(line.get_label() != "filter beyond the scale" for line in ax.lines)


def test_offsets_are_in_one_unit_where_the_width_is_known(swing: Fused, page: str) -> None:
    result, flight = swing
    table = first_group(r"(?s)<h2>Errors against truth</h2>(.*?)</table>", page)
    assert table.count(" cm") == 9
    assert "%</td>" not in table
    captions = re.findall(r"Filter [^<]*", page)
    assert captions
    assert all(re.search(r"\d cm (right|left) of the centre line", caption) for caption in captions)
    estimates = result.estimates.copy()
    for name in ("lateral_offset_m", "lateral_offset_std_m"):
        estimates[name] = np.nan
    config = result.config.model_copy(update={"corridor_width_m": None})
    told = replace(result, estimates=estimates, smoothed=estimates, config=config)
    rows = dict(error_rows(told, flight))
    assert all(cell.endswith("%") for cells in rows.values() for cell in cells[5:])


def test_the_page_says_what_made_it(swing: Fused, tmp_path: Path) -> None:
    result, flight = swing
    write_report(result, flight, tmp_path / "report.html", provenance(flight, "corridor fuse <hall> -o out"))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    rows = first_group(r"(?s)<h2>Provenance</h2>(.*?)</table>", page)
    assert "corridor fuse &lt;hall&gt; -o out" in rows
    assert f"{flight.camera.width_px}x{flight.camera.height_px} px" in rows
    assert version("corridor-fusion") in rows


def test_every_heading_cell_of_a_table_has_words(page: str) -> None:
    assert not re.search(r"<th[^>]*>\s*</th>", page)
    assert page.count("<main>") == page.count("</main>") == 1
