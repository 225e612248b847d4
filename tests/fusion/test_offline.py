from __future__ import annotations

import gc
import json
import time
from collections.abc import Callable
from dataclasses import replace
from math import degrees, radians
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from fusion import FusionConfig, FusionResult, evaluate, fuse_flight, load_flight
from fusion.estimator.tables import ESTIMATE_DTYPE, FRAME_DTYPE
from fusion.flight import AttitudeStream, Flight, FrameStream, ImuStream
from fusion.logs import open_log
from fusion.logs.pictures.camera_folder import PictureFiles
from fusion.offline.fuse import NEW_OBJECTS
from fusion.offline.stopwatch import stopwatch
from tests.files import HALLWAY, OFFICE
from tests.pictures import picture_paths
from vision.errors import InputError
from vision.rotations import yaw_of

CONFIG = FusionConfig(corridor_width_m=2.2)


@pytest.fixture(scope="module")
def fused(office: Flight) -> FusionResult:
    return fuse_flight(office, CONFIG)


def short(flight: Flight, n: int = 40) -> Flight:
    """The first frames of a flight, and its other streams as long as they last."""
    end = flight.frames.t_ns[n - 1]
    assert flight.imu is not None
    assert flight.attitude is not None
    i, a = flight.imu.t_ns <= end, flight.attitude.t_ns <= end
    return replace(
        flight,
        frames=FrameStream(flight.frames.t_ns[:n], PictureFiles(picture_paths(flight)[:n])),
        imu=replace(
            flight.imu,
            t_ns=flight.imu.t_ns[i],
            gyro_rad_s=flight.imu.gyro_rad_s[i],
            accel_m_s2=flight.imu.accel_m_s2[i],
        ),
        attitude=AttitudeStream(flight.attitude.t_ns[a], flight.attitude.q_world_body[a]),
    )


def rmse_deg(result: FusionResult, which: str = "filter") -> float:
    return degrees(result.summary["errors"][which]["heading"]["rmse_rad"])


def test_errors_on_the_sample_flight(fused: FusionResult) -> None:
    assert rmse_deg(fused) < 0.20
    assert rmse_deg(fused, "smoothed") < 0.12
    assert rmse_deg(fused, "smoothed") < rmse_deg(fused)
    assert fused.summary["errors"]["filter"]["lateral_offset_m"]["rmse_m"] < 0.05
    assert fused.frames["accepted"].mean() >= 0.95
    assert 0.5 < fused.summary["errors"]["filter"]["heading"]["nees_mean"] < 2.0


@pytest.mark.parametrize(
    ("which", "rmse_m", "known_share"), [("estimates", 0.020, 0.90), ("smoothed", 0.015, 0.97)]
)
def test_the_lateral_offset_of_the_sample_flight_is_known_and_right(
    fused: FusionResult, office: Flight, which: str, rmse_m: float, known_share: float
) -> None:
    table, truth = getattr(fused, which), office.truth
    assert truth is not None
    known = np.isfinite(table["lateral_offset_norm"])
    np.testing.assert_array_equal(known, table["lateral_status"] != "unknown")
    offset_m, width_m = (
        np.interp(table["timestamp_ns"], truth.t_ns, values)
        for values in (truth.lateral_offset_m, truth.corridor_width_m)
    )
    error_m = table["lateral_offset_norm"] * width_m / 2 - offset_m
    assert known.mean() >= known_share
    assert np.sqrt(np.mean(error_m[known] ** 2)) <= rmse_m
    assert (np.abs(error_m[known]) <= 0.1 * width_m[known] / 2).all()


def test_tables_have_a_row_per_sample(fused: FusionResult, office: Flight) -> None:
    assert office.imu is not None
    for table in (fused.estimates, fused.smoothed):
        assert table.dtype == ESTIMATE_DTYPE
        np.testing.assert_array_equal(table["timestamp_ns"], office.imu.t_ns)
    assert fused.frames.dtype == FRAME_DTYPE
    np.testing.assert_array_equal(fused.frames["timestamp_ns"], office.frames.t_ns)
    started = fused.estimates["status"] != "initialising"
    assert np.isfinite(fused.estimates["heading_rad"][started]).all()
    assert np.isfinite(fused.smoothed["heading_rad"]).all()  # the start too, from what came after
    assert (fused.smoothed["heading_std_rad"] <= fused.estimates["heading_std_rad"] + 1e-12)[started].all()


def test_noise_comes_from_the_log_unless_set(fused: FusionResult, office: Flight) -> None:
    assert office.imu is not None
    assert fused.config.gyro_noise == office.imu.gyro_noise_density
    result = fuse_flight(short(office, 5), CONFIG.model_copy(update={"gyro_noise_density": 0.02}))
    assert result.config.gyro_noise == 0.02


def test_summary_is_plain_and_complete(fused: FusionResult) -> None:
    text = json.dumps(fused.summary)
    assert json.loads(text)["flight"] == "office"
    assert fused.summary["verdict"] in ("pass", "warn", "fail")
    counts = fused.summary["counts"]
    assert counts["frames"] == counts["accepted"] + counts["rejected"] == sum(counts["by_reason"].values())
    assert fused.summary["rates"]["imu_hz"] == pytest.approx(200, rel=0.01)
    assert fused.summary["corridors"][0]["index"] == 0


def test_same_bits_every_time(office: Flight) -> None:
    first, second = fuse_flight(short(office, 12), CONFIG), fuse_flight(short(office, 12), CONFIG)
    assert first.estimates.tobytes() == second.estimates.tobytes()
    assert first.smoothed.tobytes() == second.smoothed.tobytes()


@pytest.mark.parametrize("method", ["geometric", "paper"])
def test_any_number_of_threads_gives_the_same_bits(office: Flight, tmp_path: Path, method: str) -> None:
    flight = short(office, 12)
    paths = list(picture_paths(flight))
    (broken := tmp_path / "broken.jpg").write_bytes(b"no picture")
    paths[7] = broken
    flight = replace(flight, frames=replace(flight.frames, source=PictureFiles(tuple(paths))))
    one, two, five = (fuse_flight(flight, CONFIG, method=method, jobs=jobs) for jobs in (1, 2, 5))
    assert one.frames["reason"][7] == "unreadable"
    assert np.isfinite(one.frames["heading_rad"]).sum() >= 8
    for other in (two, five):
        assert other.estimates.tobytes() == one.estimates.tobytes()
        assert other.smoothed.tobytes() == one.smoothed.tobytes()
        for name in set(FRAME_DTYPE.names or ()) - {"vision_ms"}:
            np.testing.assert_array_equal(other.frames[name], one.frames[name])


def test_fewer_threads_than_one_are_refused(office: Flight) -> None:
    with pytest.raises(InputError, match=r"jobs = 0.*give 1 or more"):
        fuse_flight(office, jobs=0)


def with_imu(flight: Flight, **changed: Any) -> Flight:
    assert flight.imu is not None
    return replace(flight, imu=replace(flight.imu, **changed))


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda flight: "flights/hall", r"flight is of type str \(give a Flight"),
        (lambda flight: None, "flight is of type NoneType"),
        (lambda flight: replace(flight, frames=None), "flight.frames is of type NoneType .*FrameStream"),
        (
            lambda flight: replace(flight, imu=flight.attitude),
            "flight.imu is of type AttitudeStream .*ImuStream",
        ),
        (lambda flight: replace(flight, velocity=[1.0]), "flight.velocity is of type list"),
        (lambda flight: replace(flight, truth={}), "flight.truth is of type dict"),
        (lambda flight: replace(flight, camera="camera.yaml"), "camera"),
        (lambda flight: with_imu(flight, t_ns=flight.imu.t_ns / 1e9), "flight.imu.t_ns is float64"),
        (lambda flight: with_imu(flight, t_ns=flight.imu.t_ns[::-1]), "flight.imu.t_ns goes back in row 1"),
        (
            lambda flight: with_imu(flight, gyro_rad_s=flight.imu.gyro_rad_s[:-5]),
            r"flight.imu.gyro_rad_s is float64 of shape \(2996, 3\) \(give a numpy array .* shape \(3001, 3\)",
        ),
        (
            lambda flight: with_imu(flight, gyro_rad_s=flight.imu.gyro_rad_s.tolist()),
            "flight.imu.gyro_rad_s is of type list .*numpy array",
        ),
        (lambda flight: with_imu(flight, accel_m_s2=None), "flight.imu.accel_m_s2 is of type NoneType"),
        (
            lambda flight: with_imu(flight, gyro_rad_s=flight.imu.gyro_rad_s.astype(str)),
            "flight.imu.gyro_rad_s is <U",
        ),
        (
            lambda flight: replace(
                flight, attitude=AttitudeStream(flight.attitude.t_ns, flight.attitude.q_world_body[:, :3])
            ),
            "flight.attitude.q_world_body .*shape",
        ),
    ],
)
def test_a_flight_of_wrong_types_or_shapes_is_refused_in_one_line(
    office: Flight, make: Callable[[Flight], Any], match: str
) -> None:
    with pytest.raises(InputError, match=match) as caught:
        fuse_flight(make(office))
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_other_arguments_of_wrong_types_are_refused_in_one_line(fused: FusionResult, office: Flight) -> None:
    anything: Any = {"corridor_width_m": 2.2}
    nothing: Any = None
    for call, match in (
        (lambda: fuse_flight(office, anything), r"config is of type dict \(give a FusionConfig"),
        (lambda: fuse_flight(office, nothing or {}), "config is of type dict"),  # type: ignore[arg-type]
        (lambda: load_flight(nothing), r"no pictures are named \(give a flight, or video and imu"),
        (lambda: load_flight(b"flight"), "path is of type bytes"),  # type: ignore[arg-type]
        (lambda: load_flight(OFFICE, camera=anything), "camera is of type dict"),
        (lambda: open_log(nothing), "path is of type NoneType"),
        (lambda: evaluate(fused, office), r"table is of type FusionResult \(give .*result.estimates"),  # type: ignore[arg-type]
        (lambda: evaluate(fused.estimates, office), r"truth is of type Flight \(give flight.truth"),  # type: ignore[arg-type]
        (lambda: evaluate(fused.estimates, nothing), "truth is of type NoneType"),
    ):
        with pytest.raises(InputError, match=match) as caught:
            call()
        assert caught.value.remedy
        assert "\n" not in str(caught.value)


def test_a_table_without_the_columns_is_not_evaluated(fused: FusionResult, office: Flight) -> None:
    assert office.truth is not None
    for table, match in (
        (fused.estimates[["timestamp_ns", "heading_rad"]], "table has no column heading_std_rad"),
        (fused.estimates[["timestamp_ns", "heading_rad", "heading_std_rad"]], "no column status or accepted"),
        (fused.estimates["heading_rad"], "table has no column heading_rad, heading_std_rad, timestamp_ns"),
    ):
        with pytest.raises(InputError, match=match):
            evaluate(table, office.truth)


@pytest.mark.parametrize("threshold", [(700, 10, 10), (0, 10, 10), (100_000, 5, 5)])
def test_the_garbage_collector_looks_seldom_and_then_as_before(
    office: Flight, threshold: tuple[int, int, int]
) -> None:
    seen: set[int] = set()
    before = gc.get_threshold()
    gc.unfreeze()  # a live session of another test froze what there was
    try:
        gc.set_threshold(*threshold)
        fuse_flight(short(office), CONFIG, progress=lambda *_: seen.add(gc.get_threshold()[0]))
        assert gc.get_threshold() == threshold
    finally:
        gc.set_threshold(*before)
    assert seen == {threshold[0] and max(threshold[0], NEW_OBJECTS)}
    assert gc.get_freeze_count() == 0


def test_progress_counts_frames(office: Flight) -> None:
    seen: list[tuple[int, int]] = []
    fuse_flight(short(office, 6), CONFIG, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i + 1, 6) for i in range(6)]


def test_pictures_that_do_not_decode_are_rows(office: Flight, tmp_path: Path) -> None:
    torn = tmp_path / "torn.jpg"
    torn.write_bytes(picture_paths(office)[10].read_bytes()[:900])
    part = short(office, 30)
    paths = list(picture_paths(part))
    paths[10], paths[11] = torn, tmp_path / "missing.jpg"
    result = fuse_flight(
        replace(part, frames=FrameStream(part.frames.t_ns, PictureFiles(tuple(paths)))), CONFIG
    )
    assert result.frames["reason"][10] == result.frames["reason"][11] == "unreadable"
    assert not result.frames["accepted"][10:12].any()
    assert np.isnan(result.frames["heading_rad"][10])
    assert result.summary["counts"]["by_reason"]["unreadable"] == 2
    assert rmse_deg(result) < 0.3


def test_attitude_carries_where_there_is_no_gyroscope(office: Flight) -> None:
    part = short(office)
    assert part.attitude is not None
    result = fuse_flight(replace(part, imu=None), CONFIG)
    np.testing.assert_array_equal(result.estimates["timestamp_ns"], part.attitude.t_ns)
    assert rmse_deg(result) < 0.4
    assert np.isnan(result.estimates["gyro_bias_rad_s"]).all()


def test_accelerometer_levels_where_there_is_no_attitude(office: Flight) -> None:
    assert rmse_deg(fuse_flight(replace(short(office), attitude=None), CONFIG)) < 0.4


def test_rows_go_on_where_the_gyroscope_dies_and_the_verdict_says_so(office: Flight) -> None:
    imu = office.imu
    assert imu is not None
    n = len(imu.t_ns) * 2 // 5
    cut = replace(imu, t_ns=imu.t_ns[:n], gyro_rad_s=imu.gyro_rad_s[:n], accel_m_s2=imu.accel_m_s2[:n])
    for flight in (replace(office, imu=cut), replace(office, imu=cut, attitude=None)):
        result = fuse_flight(flight)
        t_ns = result.estimates["timestamp_ns"]
        assert t_ns[-1] >= office.frames.t_ns[-1]
        assert np.diff(t_ns).max() < 0.35e9
        assert len(result.smoothed) == len(t_ns)
        assert result.overview is not None
        assert result.overview.verdict == "fail"


@pytest.mark.parametrize("with_attitude", [True, False])
def test_a_gyroscope_without_one_number_makes_no_rows_and_keeps_none_back(
    office: Flight, with_attitude: bool
) -> None:
    assert office.imu is not None
    assert office.attitude is not None
    imu = replace(office.imu, gyro_rad_s=np.full_like(office.imu.gyro_rad_s, np.nan))
    frames = office.frames.chosen(np.arange(40))
    attitude = office.attitude if with_attitude else None
    found = fuse_flight(replace(office, imu=imu, attitude=attitude, frames=frames))
    assert len(found.estimates) == (len(office.attitude.t_ns) if with_attitude else 40)
    assert found.problems


def test_vision_alone_makes_a_row_per_frame(office: Flight) -> None:
    part = replace(short(office), imu=None, attitude=None)
    result = fuse_flight(part, CONFIG)
    np.testing.assert_array_equal(result.estimates["timestamp_ns"], part.frames.t_ns)
    assert rmse_deg(result) < 0.6


def test_bad_samples_become_problems(office: Flight) -> None:
    part = short(office, 20)
    assert part.imu is not None
    assert part.attitude is not None
    gyro = part.imu.gyro_rad_s.copy()
    gyro[50] = np.nan
    q = part.attitude.q_world_body.copy()
    q[7] = 0
    spoilt = replace(
        part,
        imu=replace(part.imu, gyro_rad_s=gyro),
        attitude=AttitudeStream(part.attitude.t_ns, q),
        problems=("the reader's own",),
    )
    result = fuse_flight(spoilt, CONFIG)
    assert result.problems[0] == "the reader's own"
    assert any(problem.startswith("1 gyroscope sample") for problem in result.problems)
    assert any(problem.startswith("1 attitude") for problem in result.problems)
    assert rmse_deg(result) < 0.3


def test_flight_without_frames_is_refused(office: Flight) -> None:
    with pytest.raises(InputError, match="has no camera frames"):
        fuse_flight(replace(office, frames=FrameStream(np.zeros(0, np.int64), PictureFiles(()))), CONFIG)


def test_flight_without_one_good_frame_still_has_its_tables(office: Flight) -> None:
    part = short(office, 10)
    nothing = tuple(path.with_suffix(".gone") for path in picture_paths(part))
    result = fuse_flight(replace(part, frames=FrameStream(part.frames.t_ns, PictureFiles(nothing))), CONFIG)
    assert (result.frames["reason"] == "unreadable").all()
    assert (result.estimates["status"] == "initialising").all()
    assert np.isnan(result.estimates["heading_rad"]).all()
    assert np.isnan(result.smoothed["heading_rad"]).all()
    assert result.summary["verdict"] == "fail"


def test_paper_method_runs_and_is_worse(office: Flight) -> None:
    part = short(office, 30)
    paper, geometric = fuse_flight(part, CONFIG, method="paper"), fuse_flight(part, CONFIG)
    assert paper.summary["method"] == "paper"
    assert np.isfinite(paper.frames["paper_yaw_rad"]).any()
    vision = [r.summary["errors"]["vision"]["heading"] for r in (paper, geometric)]
    assert vision[0]["count"] == 0 or vision[0]["rmse_rad"] > vision[1]["rmse_rad"]


def test_other_stamps_of_the_camera(office: Flight) -> None:
    """Frames stamped 100 ms late are as good as any, once the delay is told; the rows keep the log's stamps."""
    part = short(office)
    late = replace(part, frames=FrameStream(part.frames.t_ns + 100_000_000, part.frames.source))
    told = fuse_flight(late, CONFIG.model_copy(update={"camera_delay_s": 0.1}))
    plain = fuse_flight(part, CONFIG)
    np.testing.assert_array_equal(told.frames["timestamp_ns"], late.frames.t_ns)
    np.testing.assert_allclose(told.estimates["heading_rad"], plain.estimates["heading_rad"], atol=1e-12)


def test_a_corridor_begins_in_the_smoothed_table_where_the_vehicle_turned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A simulated turn of 90 degrees through the whole offline path, with measurements in place of pictures."""
    from tests.fusion.simulated import Scene, simulate, turning
    from vision.cameras import camera as camera_module

    angle = radians(90)
    scene = Scene(
        duration_s=16,
        heading=turning((7, 2, angle)),
        axis=lambda t: np.where(np.asarray(t) < 8, 0.0, angle),
        gyro_hz=100,
        frame_hz=20,
        tilt_rad=radians(2),
    )
    simulated = simulate(scene)
    imu = [s for s in simulated.samples if s.kind == "imu"]
    frames = {s.t_ns: s.values[0] for s in simulated.samples if s.kind == "frame"}
    camera = camera_module.Camera.from_fov(64, 48, radians(70))
    flight = Flight(
        "turn",
        camera,
        FrameStream(np.array(list(frames)), PictureFiles(tuple(Path(str(t)) for t in frames))),
        imu=ImuStream(
            np.array([s.t_ns for s in imu]),
            np.array([s.values[0] for s in imu]),
            np.full((len(imu), 3), np.nan),
            scene.gyro_noise,
            scene.gyro_bias_walk,
        ),
    )
    monkeypatch.setattr("fusion.logs.pictures.camera_folder.read_image", lambda path: path)
    monkeypatch.setattr("fusion.offline.fuse.examine_lens", lambda frames, camera: None)
    monkeypatch.setattr(
        "fusion.offline.fuse.extract_features", lambda image, camera, method: frames[int(image.name)]
    )
    result = fuse_flight(flight, FusionConfig(corridor_width_m=2.2, heading_correlation_s=0.0))
    t = result.estimates["timestamp_ns"] * 1e-9
    causal = t[np.argmax(result.estimates["corridor_index"])]
    begun = t[np.argmax(result.smoothed["corridor_index"])]
    assert causal > 8.3
    assert begun == pytest.approx(8.0, abs=0.1)
    truth = simulated.heading - np.where(t < begun, 0.0, angle)
    error = result.smoothed["heading_rad"] - truth
    assert degrees(np.abs(error).max()) < 1.5
    assert (np.abs(error) < 5 * result.smoothed["heading_std_rad"]).all()
    assert [c["index"] for c in result.summary["corridors"]] == [0, 1]
    assert degrees(result.summary["corridors"][1]["turn_rad"]) == pytest.approx(90, abs=1.5)


def test_the_real_flight_without_a_gyroscope() -> None:
    """Ninety-one frames of a nano drone: the second corridor gets its own index, vision follows the vehicle's yaw."""
    path = HALLWAY
    if not path.exists():
        pytest.skip("the real flight mononav_hallway is not beside the repository")
    flight = load_flight(path)
    assert flight.attitude is not None
    result = fuse_flight(flight)
    yaw = np.unwrap(yaw_of(flight.attitude.q_world_body))
    for table in (result.estimates, result.smoothed):
        assert (table["corridor_index"][:42] == 0).all()
        assert (table["corridor_index"][64:] == 1).all()
        for rows in (slice(4, 42), slice(64, 91)):
            difference = table["heading_rad"][rows] - yaw[rows]
            assert degrees(np.std(difference)) < 0.6
    assert degrees(result.estimates["corridor_turn_rad"][-1]) == pytest.approx(-90, abs=4)


def test_the_clock_stands_still_while_loops_are_compiled() -> None:
    double: Any = numba.njit(lambda x: 2.0 * x)
    with stopwatch() as clock:
        outer_s, before_s, inner_s = time.perf_counter(), clock.seconds(), time.perf_counter()
        assert double(21.0) == 42.0
        inner_s = time.perf_counter() - inner_s
        without_s = clock.seconds() - before_s
        outer_s = time.perf_counter() - outer_s
        assert clock.compile_s > 0.0
        assert inner_s <= without_s + clock.compile_s + 1e-9
        assert without_s + clock.compile_s <= outer_s + 1e-9
        compiled_s = clock.compile_s
        double(2.0)
        assert clock.compile_s == compiled_s
