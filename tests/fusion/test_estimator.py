from __future__ import annotations

from dataclasses import replace
from math import degrees, exp, isfinite, isnan, nan, pi, radians
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimator import CorridorEstimator
from fusion.estimator.faults import Fault
from fusion.estimator.hypotheses import SHORT_S
from tests.fusion.simulated import (
    Run,
    Scene,
    config_for,
    frame,
    heading_error,
    quaternion,
    run,
    simulate,
    turning,
    weaving,
    wrap,
)
from vision.cameras.camera import Camera
from vision.errors import InputError
from vision.measurement import FrameMeasurement, Reason
from vision.rotations import wrap_axis

MS = 1_000_000
S = 1_000_000_000
QUICK: dict[str, Any] = {"gyro_hz": 100.0, "frame_hz": 20.0, "delay_s": 0.08}


AT_REST = (0.0, 0.0, -9.80665)


def steady(seconds: float = 2.0, heading: float = 0.2, **config: Any) -> tuple[CorridorEstimator, int]:
    """An estimator that has flown straight on for a while, and the time it is at."""
    estimator = CorridorEstimator(FusionConfig(**config))
    t = 0
    for i in range(int(seconds * 100)):
        t = i * 10 * MS
        estimator.add_imu(t, (0.0, 0.0, 0.0), AT_REST)
        if i % 5 == 0:
            estimator.add_measurement(t, frame(heading, lateral=0.3, lateral_std=0.02))
    return estimator, t


def noisy(seconds: float) -> tuple[CorridorEstimator, int]:
    """As `steady`, by frames that scatter as they say: frames without noise may all be off by the same."""
    estimator, rng, t = CorridorEstimator(FusionConfig()), np.random.default_rng(0), 0
    for i in range(int(seconds * 100)):
        t = i * 10 * MS
        estimator.add_imu(t, (0.0, 0.0, 0.0), AT_REST)
        if i % 5 == 0:
            estimator.add_measurement(t, frame(0.2 + float(rng.normal(0.0, radians(0.5)))))
    return estimator, t


def go_on(
    estimator: CorridorEstimator, t: int, seconds: float, heading: float | None, rate: float = 0.0
) -> int:
    for i in range(int(seconds * 100)):
        t += 10 * MS
        estimator.add_imu(t, (0.0, 0.0, rate))
        if heading is not None and i % 3 == 0:
            seen = heading + 1e-6 * (i % 2)  # equal bit for bit only from a frozen camera
            estimator.add_measurement(t, frame(seen, lateral=0.3, lateral_std=0.02))
    return t


# Consistency


def test_errors_are_as_large_as_the_filter_says() -> None:
    """Mean NEES over runs lies within the 99.9 % band of chi-square; rows a second apart are about independent."""
    ratios = []
    for seed in range(24):
        simulated = simulate(Scene(seed=seed, duration_s=14, heading=weaving(seed), gross=0.05, **QUICK))
        result = run(simulated, every=100)
        error = heading_error(result, simulated)
        rows = result.t_s > 1.5
        ratios.append((error / result.std)[rows] ** 2)
    nees = np.concatenate(ratios)
    assert abs(nees.mean() - 1) < 3.3 * np.sqrt(2 / nees.size)


@pytest.mark.parametrize(("accel", "known_share"), [(True, 0.97), (False, 0.8)])
def test_errors_of_the_offset_are_no_larger_than_the_filter_says(accel: bool, known_share: float) -> None:
    """Frames err as the model has it, alike for a quarter of a second, and one in twenty shows another place."""
    errors, ratios, known = [], [], []
    for seed in range(8):
        scene = Scene(
            seed=seed,
            duration_s=14,
            heading=weaving(seed),
            lateral=weaving(seed + 50, 0.5, 9.0),
            gross=0.05,
            frame_correlation=0.82,
            attitude_hz=25,
            accel=accel,
            **QUICK,
        )
        simulated = simulate(scene)
        result = run(simulated, every=50)
        error = result.lateral - np.interp(result.t_s, simulated.t_s, simulated.lateral)
        rows = result.t_s > 2.0
        known.append(np.isfinite(error[rows]))
        errors.append(error[rows][known[-1]])
        ratios.append((error / result.lateral_std)[rows][known[-1]] ** 2)
    assert np.concatenate(known).mean() > known_share
    assert np.abs(np.concatenate(errors)).max() < 0.1
    # The simulated offset is smoother than the model allows for: sigma may be too large, but not boundless.
    assert 0.1 < np.concatenate(ratios).mean() < 1.2


@pytest.mark.parametrize("gross", [0.0, 0.05, 0.5])
def test_gross_errors_do_no_harm(gross: float) -> None:
    errors = []
    for seed in range(3):
        simulated = simulate(Scene(seed=seed, duration_s=15, heading=weaving(seed), gross=gross, **QUICK))
        result = run(simulated)
        errors.append(heading_error(result, simulated)[result.t_s > 3.0])
    error = np.concatenate(errors)
    assert degrees(np.sqrt(np.mean(error**2))) < 0.45
    assert degrees(np.abs(error).max()) < 2.0


def test_drop_out_of_five_seconds() -> None:
    simulated = simulate(Scene(seed=4, duration_s=16, heading=weaving(4), dropouts=[(6.0, 11.0)], **QUICK))
    result = run(simulated)
    error = heading_error(result, simulated)
    blind = (result.t_s > 6.5) & (result.t_s < 11.0)
    assert (result.status[blind] == "coasting").all()
    assert (result.status[result.t_s > 11.5] == "tracking").all()
    assert (np.abs(error) < 4 * result.std)[result.t_s > 1.0].all()
    assert (np.diff(result.std[blind]) > 0).all()
    assert degrees(np.abs(error[blind]).max()) < 3.0


def test_turning_round_and_round_crosses_half_a_turn() -> None:
    spin = turning((3, 8, 2 * pi), (12, 8, -3 * pi))
    simulated = simulate(Scene(seed=1, duration_s=22, heading=spin, tilt_rad=radians(3), **QUICK))
    result = run(simulated)
    rows = result.t_s > 1.0
    assert degrees(np.abs(heading_error(result, simulated)[rows]).max()) < 1.5
    assert (np.abs(result.heading[rows]) <= pi).all()
    assert (result.corridor == 0).all()


def test_delay_is_rolled_back_not_ignored() -> None:
    def rmse(stamped_late_s: float, told_s: float) -> float:
        scene = Scene(seed=2, duration_s=15, heading=weaving(2, radians(25), 3.0), **QUICK)
        simulated = simulate(scene)
        for sample in simulated.samples:
            if sample.kind == "frame":
                sample.t_ns += round(stamped_late_s * 1e9)
        result = run(simulated, config_for(scene, camera_delay_s=told_s))
        return float(np.sqrt(np.mean(heading_error(result, simulated)[result.t_s > 1.5] ** 2)))

    told = rmse(0.08, 0.08)
    assert told == pytest.approx(rmse(0.0, 0.0), rel=0.05)
    assert rmse(0.08, 0.0) > 2 * told


# Start


def test_start_is_not_one_frame() -> None:
    estimator = CorridorEstimator()
    headings = [0.9, 0.1, 0.1, -0.7, 0.1, 0.1, 0.1]
    for i, heading in enumerate(headings):
        estimator.add_imu(i * 50 * MS, (0, 0, 0))
        assert estimator.estimate().status == "initialising"
        estimator.add_measurement(i * 50 * MS, frame(heading))
    estimate = estimator.estimate()
    assert estimate.status == "tracking"
    assert estimate.heading_rad == pytest.approx(0.1, abs=0.01)


def test_start_is_carried_on_by_the_gyroscope() -> None:
    estimator = CorridorEstimator()
    for i in range(60):
        t = i * 10 * MS
        estimator.add_imu(t, (0, 0, 0.5))
        if i % 10 == 0:
            estimator.add_measurement(t, frame(0.1 + 0.5 * t * 1e-9))
    estimate = estimator.estimate()
    assert estimate.status == "tracking"
    assert estimate.heading_rad == pytest.approx(0.1 + 0.5 * 0.59, abs=0.02)


@pytest.mark.parametrize("frame_hz", [0.5, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("bias_deg_s", [-1.5, 0.0, 1.5])
def test_start_with_a_slow_camera(frame_hz: float, bias_deg_s: float) -> None:
    """The gyroscope's bias drifts by degrees between two frames, and is not known before they agree."""
    settings = QUICK | {"frame_hz": frame_hz}
    scene = Scene(seed=2, duration_s=20, heading=weaving(2), gyro_bias=radians(bias_deg_s), **settings)
    simulated = simulate(scene)
    result = run(simulated)
    started = result.status != "initialising"
    assert result.t_s[started][0] < 5.5 / frame_hz + 0.5
    error = heading_error(result, simulated)[started]
    assert (np.abs(error) < 4.0 * result.std[started]).all()


@pytest.mark.parametrize("bias_deg_s", [-2.5, 1.0, 2.5])
def test_start_across_a_gap(bias_deg_s: float) -> None:
    """Of the frames that agree most are old: what the gyroscope may have drifted since then is in the sigma."""
    estimator = CorridorEstimator()
    frames = {round(1e9 * t) for t in (0.5, 0.54, 0.58, 0.62, 3.4)}
    for k in range(341):
        t = k * 10 * MS
        estimator.add_imu(t, (0.0, 0.0, radians(bias_deg_s)), AT_REST)
        if t in frames:
            estimator.add_measurement(t, frame(0.1 + 1e-6 * (k % 7)))
    found = estimator.estimate()
    assert found.status == "tracking"
    assert abs(found.heading_rad - 0.1) < 3.0 * found.heading_std_rad


def test_a_sigma_near_zero_does_no_harm_while_the_clock_is_weighed() -> None:
    """Its square is 0: the frames are late by 0.15 s from some time on, and it is judged whether they are."""
    estimator = CorridorEstimator()
    for k in range(800):
        t, rate = k * 10 * MS, 0.3
        estimator.add_imu(t, (0.0, 0.0, rate), AT_REST)
        if k % 4 == 0:
            late = 150 * MS if k > 600 else 0
            seen = frame(float(wrap_axis(rate * (t - late) * 1e-9)))
            std = 1e-170 if k > 620 and k % 8 == 0 else 0.01
            estimator.add_measurement(t - late, replace(seen, heading_std_rad=std))
    assert isfinite(estimator.estimate().heading_rad)


def test_nothing_is_said_before_anything_is_known() -> None:
    estimator = CorridorEstimator()
    assert isnan(estimator.estimate().heading_rad)
    estimator.add_imu(0, (0, 0, 0))
    estimate = estimator.estimate()
    assert estimate.status == "initialising"
    assert isnan(estimate.heading_rad)
    assert estimate.position == ""


# Errors, faults and recovery


@pytest.mark.parametrize("error_deg", [30, -60, 90, -150])
def test_injected_error_is_recovered_in_half_a_second(error_deg: float) -> None:
    estimator, t = steady(5.0)
    timeline = estimator._timeline
    x = timeline.state.x + np.array([radians(error_deg), 0, 0])
    timeline.state = timeline.state._replace(x=x)
    go_on(estimator, t, 0.5, 0.2)
    estimate = estimator.estimate()
    assert degrees(abs(estimate.heading_rad - 0.2)) < 0.5
    assert estimate.corridor_index == 0
    assert estimate.reset_count == 1
    assert degrees(estimate.reset_heading_rad) == pytest.approx(-error_deg, abs=2)


def test_false_turn_of_the_gyroscope_is_no_junction() -> None:
    """The gyroscope claims 60 degrees while the picture stands still."""
    estimator, t = steady(5.0)
    t = go_on(estimator, t, 0.5, 0.2, rate=radians(120))
    go_on(estimator, t, 0.6, 0.2)
    estimate = estimator.estimate()
    assert degrees(abs(estimate.heading_rad - 0.2)) < 1.0
    assert estimate.corridor_index == 0


def test_wrong_start_is_recovered() -> None:
    estimator = CorridorEstimator()
    t = go_on(estimator, 0, 0.3, 1.0)
    go_on(estimator, t, 1.5, -0.1)
    assert estimator.estimate().heading_rad == pytest.approx(-0.1, abs=0.02)


def test_nine_agreeing_rejected_frames_change_nothing() -> None:
    estimator, t = steady(5.0, axis_jump_hold_s=0.3)
    for _ in range(9):
        t += 40 * MS
        estimator.add_imu(t, (0, 0, 0))
        result = estimator.add_measurement(t, frame(0.2 + radians(15)))
        assert result.reason is Reason.GATE
        assert result.test_ratio > 1
        assert degrees(result.innovation_rad) == pytest.approx(15, abs=1)
    before = estimator.estimate()
    assert before.heading_rad == pytest.approx(0.2, abs=0.01)
    estimator.add_measurement(t + 40 * MS, frame(0.2 + radians(15)))
    after = estimator.estimate()
    assert degrees(after.heading_rad - 0.2) == pytest.approx(15, abs=1)
    assert after.reset_count == 1


def test_covariance_is_widened_not_the_state_overwritten() -> None:
    """After recovery the heading is as uncertain as the frames that brought it, not as sure as before."""
    estimator, t = noisy(5.0)
    before = estimator.estimate().heading_std_rad
    for i in range(10):
        estimator.add_measurement(t + (i + 1) * 40 * MS, frame(0.5, std_rad=radians(1)))
    assert estimator.estimate().heading_std_rad > 3 * before


def test_rejected_frames_that_disagree_change_nothing() -> None:
    estimator, t = steady(5.0)
    rng = np.random.default_rng(0)
    for _ in range(60):
        t += 30 * MS
        estimator.add_imu(t, (0, 0, 0))
        wrong = 0.2 + rng.choice([-1, 1]) * rng.uniform(radians(8), radians(70))
        estimator.add_measurement(t, frame(float(wrong)))
    assert estimator.estimate().heading_rad == pytest.approx(0.2, abs=0.02)
    assert estimator.estimate().status == "coasting"
    assert estimator.estimate().reason == "frames are rejected"


@pytest.mark.parametrize("hz", [10.0, 30.0, 120.0])
def test_the_share_of_refused_frames_grows_with_time_and_not_with_their_number(hz: float) -> None:
    estimator, t = steady(3.0)
    step = round(1e9 / hz)
    for k in range(round(0.25 * hz) * 2):
        t += step
        estimator.add_imu(t, (0.0, 0.0, 0.0))
        estimator.add_measurement(t + 1, frame(0.2 + radians(30) + 1e-6 * (k % 2)))
    share = estimator._timeline.state.axis.diagnosis.rejected_share
    spent_s = 2 * round(0.25 * hz) / hz
    assert share == pytest.approx(1.0 - exp(-spent_s / SHORT_S), abs=0.03)


def test_frames_are_turned_down_for_their_reason() -> None:
    estimator, t = steady()
    cases = [
        (frame(0.2, n_inliers=3), Reason.TOO_FEW_LINES),
        (frame(0.2, accepted=False, reason=Reason.BLUR), Reason.BLUR),
        (frame(nan), Reason.UNCERTAIN),
        (frame(0.2, std_rad=0.0), Reason.UNCERTAIN),
        (frame(0.2, std_rad=nan), Reason.UNCERTAIN),
    ]
    before = estimator.estimate().heading_rad
    for i, (measurement, reason) in enumerate(cases):
        result = estimator.add_measurement(t + i, measurement)
        assert (result.accepted, result.reason) == (False, reason)
    assert estimator.add_unreadable_frame(t + 10).reason is Reason.UNREADABLE
    assert estimator.estimate().heading_rad == pytest.approx(before, abs=1e-9)
    assert estimator.counters["frame_too_few_lines"] == 1
    assert estimator.counters["frame_unreadable"] == 1


@pytest.mark.parametrize(
    ("image", "cause"),
    [
        (np.zeros((240, 320), np.uint8), "picture is 320x240, the camera's 640x480"),
        (np.zeros((480, 640), np.float32), "image is of type float32"),
    ],
)
def test_a_picture_of_no_use_says_why(image: np.ndarray, cause: str) -> None:
    estimator = CorridorEstimator(None, Camera.from_fov(640, 480, 1.2))
    estimator.add_imu(0, (0, 0, 0))
    result = estimator.add_frame(0, image)
    assert (result.reason, result.cause) == (Reason.UNREADABLE, cause)
    assert estimator.last_frame == result
    assert estimator.estimate().reason == f"no usable frame yet; {cause}"
    estimator.add_measurement(50_000_000, frame(0.0))
    assert cause not in estimator.estimate().reason


def test_the_path_of_a_calibration_is_no_camera() -> None:
    with pytest.raises(InputError, match=r"camera = 'cam\.yaml' is no Camera .*from_yaml"):
        CorridorEstimator(FusionConfig(), "cam.yaml")  # type: ignore[arg-type]


def test_bad_samples_are_counted_and_poison_nothing() -> None:
    estimator, t = steady()
    estimator.add_imu(t + 1, (nan, 0, 0))
    estimator.add_imu(t + 2, (0, float("inf"), 0))
    estimator.add_imu(t + 3, (0, 0, 0), (nan, 0, 0))
    estimator.add_attitude(t + 4, (0, 0, 0, 0))
    estimator.add_attitude(t + 5, (nan, 0, 0, 1))
    estimator.add_velocity(t + 6, (0, nan, 0))
    go_on(estimator, t, 0.5, 0.2)
    estimate = estimator.estimate()
    assert estimate.heading_rad == pytest.approx(0.2, abs=0.01)
    assert estimator.counters["imu_not_finite"] == 2
    assert estimator.counters["attitude_not_unit"] == 2
    assert estimator.counters["velocity_not_finite"] == 1


def test_a_gap_in_the_gyroscope_widens_the_heading() -> None:
    estimator, t = steady(3.0)
    before = estimator.estimate().heading_std_rad
    estimator.add_imu(t + 400 * MS, (0, 0, 0))
    after = estimator.estimate().heading_std_rad
    assert after > 3 * before
    go_on(estimator, t + 400 * MS, 1.0, 0.2)
    assert estimator.estimate().heading_rad == pytest.approx(0.2, abs=0.01)


def test_an_hour_of_silence_is_survived() -> None:
    estimator, t = steady(3.0)
    t += 3600 * 1000 * MS
    estimator.add_imu(t, (0, 0, 0))
    assert estimator.estimate().status == "tracking"  # one stamp an hour ahead may be wrong
    estimator.add_imu(t + 10 * MS, (0, 0, 0))
    assert estimator.estimate().status == "lost"
    go_on(estimator, t, 1.5, -0.4)
    estimate = estimator.estimate()
    assert estimate.status == "tracking"
    assert estimate.heading_rad == pytest.approx(-0.4, abs=0.02)


# The IMU's yaw


def yaw_scene(**changes: Any) -> Scene:
    return replace(
        Scene(seed=6, duration_s=15, heading=weaving(6), attitude_hz=25, attitude_std_rad=0.0, **QUICK),
        **changes,
    )


def test_steps_of_the_imu_yaw_never_reach_the_heading() -> None:
    def steps(t: np.ndarray) -> np.ndarray:
        return 0.7 + np.where(t > 5, radians(15), 0.0) - np.where(t > 9, radians(20), 0.0)

    with_steps, without = (run(simulate(scene)) for scene in (yaw_scene(yaw_offset=steps), yaw_scene()))
    np.testing.assert_allclose(with_steps.heading, without.heading, rtol=0, atol=1e-12)
    offset = with_steps.estimator.estimate().imu_yaw_offset_rad
    assert degrees(abs(wrap(offset - steps(np.array(14.9))))) < 1.5


def test_coupled_imu_yaw_helps_in_a_drop_out_and_its_steps_do_little() -> None:
    def run_with(**changes: Any) -> list[tuple[Run, np.ndarray]]:
        scene = yaw_scene(dropouts=[(6.0, 11.0)], gyro_bias_walk=3e-3, **changes)
        simulated = simulate(scene)
        results = [
            run(
                simulated,
                config_for(scene, imu_yaw_use="always" if on else "never", imu_yaw_std_rad=radians(0.3)),
            )
            for on in (False, True)
        ]
        return [(r, heading_error(r, simulated)) for r in results]

    (alone, _), (helped, helped_error) = run_with()
    blind = (alone.t_s > 8) & (alone.t_s < 11)
    assert helped.std[blind].mean() < 0.9 * alone.std[blind].mean()
    assert (np.abs(helped_error) < 4.5 * helped.std)[helped.t_s > 1].all()
    (_, _), (stepped, error) = run_with(yaw_offset=lambda t: 0.7 + np.where(t > 4, radians(15), 0.0))
    seeing = (stepped.t_s > 1) & (stepped.t_s < 6)
    assert degrees(np.abs(error[seeing]).max()) < 1.5


@pytest.mark.parametrize("seconds", [0.5, 2.0, 4.0])
def test_coupled_imu_yaw_that_is_pulled_away_in_a_drop_out_takes_the_heading_along_but_little(
    seconds: float,
) -> None:
    """Steel in passing: the yaw goes off by 20 degrees over a while, just where no frame can say so."""

    def pulled(t: np.ndarray) -> np.ndarray:
        return 0.7 + radians(20) * np.clip((np.asarray(t, float) - 7.0) / seconds, 0, 1)

    scene = yaw_scene(dropouts=[(6.0, 11.0)], yaw_offset=pulled)
    simulated = simulate(scene)
    result = run(simulated, config_for(scene, imu_yaw_use="always", imu_yaw_std_rad=radians(0.3)))
    error = heading_error(result, simulated)[result.t_s > 1]
    assert degrees(np.abs(error).max()) < 2.5
    assert (np.abs(error) < 3.5 * result.std[result.t_s > 1]).all()


# Streams that are missing


def test_attitude_increments_carry_the_heading_without_a_gyroscope() -> None:
    simulated = simulate(
        yaw_scene(attitude_hz=50, yaw_std_rad=radians(0.1), dropouts=[(7.0, 10.0)], delay_s=0.0)
    )
    result = run(simulated, kinds=("attitude", "frame"), every=5)
    error = heading_error(result, simulated)[result.t_s > 1.5]
    assert degrees(np.sqrt(np.mean(error**2))) < 0.6
    assert degrees(np.abs(error).max()) < 2.0
    assert isnan(result.estimator.estimate().gyro_bias_rad_s)


def test_vision_alone() -> None:
    scene = Scene(seed=8, duration_s=15, heading=weaving(8, radians(8)), frame_hz=20, gross=0.05)
    simulated = simulate(scene)
    result = run(simulated, kinds=("frame",), every=1)
    error = heading_error(result, simulated)[result.t_s > 1.5]
    assert degrees(np.sqrt(np.mean(error**2))) < 1.0
    assert (result.status[result.t_s > 1.5] == "tracking").mean() > 0.95
    truth = np.gradient(simulated.heading, simulated.t_s)[-1]
    assert result.estimator.estimate().yaw_rate_rad_s == pytest.approx(truth, abs=0.3)


def test_tilt_from_the_accelerometer_without_attitude() -> None:
    simulated = simulate(Scene(seed=9, duration_s=20, heading=weaving(9), accel=True, **QUICK))
    result = run(simulated)
    error = heading_error(result, simulated)[result.t_s > 2]
    assert degrees(np.sqrt(np.mean(error**2))) < 0.45


def test_gyroscope_that_dies_is_replaced_and_comes_back() -> None:
    simulated = simulate(yaw_scene(attitude_hz=50, yaw_std_rad=radians(0.1), gyro_bias=0.03, delay_s=0.0))
    samples = [s for s in simulated.samples if not (s.kind == "imu" and 5e9 < s.t_ns < 9e9)]
    result = run(replace(simulated, samples=samples), kinds=("frame", "imu", "attitude"), every=2)
    error = heading_error(result, simulated)
    assert degrees(np.abs(error[result.t_s > 1.5]).max()) < 2.5
    estimate = result.estimator.estimate()
    assert estimate.gyro_bias_rad_s == pytest.approx(simulated.bias[-1], abs=0.02)


def test_silent_gyroscope_is_told_of() -> None:
    estimator, t = steady(3.0)
    for i in range(1, 30):
        estimator.add_measurement(t + i * 20 * MS, frame(0.2, lateral=0.3, lateral_std=0.02))
    estimate = estimator.estimate()
    assert estimate.reason == "gyroscope is silent"
    assert estimate.gyro_age_s == pytest.approx(0.58)
    assert estimate.heading_rad == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize("gyro_hz", [25.0, 1000.0])
def test_other_gyroscope_rates(gyro_hz: float) -> None:
    scene = Scene(
        seed=10, duration_s=8, heading=weaving(10), gyro_hz=gyro_hz, tilt_rad=radians(5), frame_hz=20
    )
    simulated = simulate(scene)
    result = run(simulated)
    assert degrees(np.sqrt(np.mean(heading_error(result, simulated)[result.t_s > 1.5] ** 2))) < 0.5


@pytest.mark.parametrize("frame_hz", [1.0, 5.0, 120.0])
def test_other_frame_rates(frame_hz: float) -> None:
    scene = Scene(
        seed=11, duration_s=20, heading=weaving(11), gyro_hz=50, frame_hz=frame_hz, frame_correlation=0.0
    )
    simulated = simulate(scene)
    result = run(simulated)
    late = result.t_s > 12
    assert (np.abs(heading_error(result, simulated)) < 4.5 * result.std)[late].all()
    assert (result.status[late] == "tracking").all()


@pytest.mark.parametrize(("turns", "seconds"), [(0.5, 2.0), (1.0, 4.0), (3.0, 9.0)])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_scale_s_error_adds_up_in_a_long_turn_without_frames(
    turns: float, seconds: float, sense: float
) -> None:
    """It is constant: three turns are off by 10.8 degrees if the scale is off by 1 %."""
    estimator, t = steady(3.0, gyro_scale_std=0.01)
    rate = sense * 2 * pi * turns / seconds
    for ms in range(5, round(1000 * seconds) + 1, 5):
        estimator.add_imu(t + ms * MS, (0.0, 0.0, rate))
    std = estimator.estimate().heading_std_rad
    by_scale = 0.01 * 2 * pi * turns
    assert 0.6 * by_scale < std < 1.5 * by_scale


def test_turns_within_half_a_turn_of_a_frame_add_a_random_walk_s_variance() -> None:
    variances = []
    for share in (0.0, 0.01):
        estimator, t = steady(3.0, gyro_scale_std=share)
        for ms in range(5, 5001, 5):
            rate = 1.0 if ms % 2000 < 1000 else -1.0
            estimator.add_imu(t + ms * MS, (0.0, 0.0, rate))
        variances.append(estimator.estimate().heading_std_rad ** 2)
    assert variances[1] - variances[0] == pytest.approx(0.01**2 * 0.5 * 5.0, rel=0.05)


# Status


def test_status_tells_of_a_source_that_died_within_a_fifth_of_a_second() -> None:
    estimator, t = steady(3.0)
    assert estimator.estimate(t + 100 * MS).status == "tracking"
    estimate = estimator.estimate(t + 300 * MS)
    assert estimate.status == "coasting"
    assert estimate.reason == "no frames arrive; gyroscope is silent"
    assert estimate.vision_age_s == pytest.approx(0.3, abs=0.06)
    assert estimator.estimate(t + 20_000 * MS).status == "lost"
    assert estimator.estimate().status == "tracking"  # asking changes nothing


SOURCES = {"imu": "gyroscope", "attitude": "attitude", "velocity": "velocity", "frame": "frames"}


def all_sources(estimator: CorridorEstimator, start: int, seconds: float, dead: str = "") -> int:
    """Feed every source but one; gyroscope at 100 Hz, attitude 50, velocity 25, frames 20. Returns the last time."""
    t = start
    for i in range(1, int(seconds * 100) + 1):
        t = start + i * 10 * MS
        if dead != "imu":
            estimator.add_imu(t, (0.0, 0.0, 0.0))
        if i % 2 == 0 and dead != "attitude":
            estimator.add_attitude(t, (1.0, 0.0, 0.0, 0.0))
        if i % 4 == 0 and dead != "velocity":
            estimator.add_velocity(t, (1.0, 0.0, 0.0))
        if i % 5 == 0 and dead != "frame":
            estimator.add_measurement(t, frame(0.1, lateral=0.3, lateral_std=0.02))
    return t


@pytest.mark.parametrize("dead", SOURCES)
def test_each_source_that_dies_is_told_of_within_a_fifth_of_a_second(dead: str) -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    died = all_sources(estimator, 0, 3.0)
    alive = estimator.estimate()
    assert (alive.status, alive.reason) == ("tracking", "")
    assert estimator.estimate(died + 40 * MS).reason == ""
    now = all_sources(estimator, died, 0.21, dead)
    said = estimator.estimate(now)
    assert SOURCES[dead] in said.reason
    assert said.status == ("coasting" if dead == "frame" else "tracking")
    assert said.reason.count(";") == 0  # and of no other
    all_sources(estimator, now, 0.5)
    assert (estimator.estimate().status, estimator.estimate().reason) == ("tracking", "")


def test_frames_without_a_lateral_offset_are_told_of() -> None:
    estimator, t = steady(3.0)
    for i in range(1, 30):
        estimator.add_imu(t + i * 20 * MS, (0.0, 0.0, 0.0))
        estimator.add_measurement(t + i * 20 * MS, frame(0.2))
    estimate = estimator.estimate()
    assert (estimate.status, estimate.reason) == ("tracking", "frames show no lateral offset")
    assert estimate.lateral_age_s > 0.5


def test_slow_cameras_are_not_always_coasting() -> None:
    estimator = CorridorEstimator()
    for i in range(100):
        estimator.add_imu(i * 20 * MS, (0, 0, 0))
        if i % 10 == 0:
            estimator.add_measurement(i * 20 * MS, frame(0.0))
    assert estimator.estimate().status == "tracking"


# Lateral offset


@pytest.mark.parametrize("width_m", [2.0, 5.0])
def test_rate_of_the_offset_is_that_of_the_vehicle_with_and_without_a_velocity_stream(width_m: float) -> None:
    """Ten degrees to the right at 1 m/s, while drifting 0.1 m/s to the left: 0.074 m/s to the right in all."""
    heading, forward, drift = radians(10), 1.0, -0.1
    rate = forward * np.sin(heading) + drift * np.cos(heading)
    for known in ("nothing", "forward", "all"):
        estimator = CorridorEstimator(FusionConfig(corridor_width_m=width_m))
        for i in range(400):
            t, offset = i * 10 * MS, (rate * i * 0.01) / (width_m / 2)
            estimator.add_imu(t, (0.0, 0.0, 0.0), AT_REST)
            if known != "nothing" and i % 4 == 0:
                estimator.add_velocity(t, (forward, drift if known == "all" else 0.0, 0.0))
            if i % 5 == 0:
                estimator.add_measurement(t, frame(heading, lateral=offset, lateral_std=0.01))
        e = estimator.estimate()
        tolerance = {"nothing": 0.05, "forward": 0.05, "all": 0.02}[known]
        assert e.lateral_velocity_m_s == pytest.approx(rate, abs=tolerance)
        assert e.lateral_velocity_norm_s == pytest.approx(e.lateral_velocity_m_s / (width_m / 2))
        assert e.lateral_velocity_std_m_s == pytest.approx(e.lateral_velocity_norm_s_std * width_m / 2)
        assert abs(e.lateral_velocity_m_s - rate) < 3 * e.lateral_velocity_std_m_s
        along = forward * np.cos(heading) - (drift if known == "all" else 0.0) * np.sin(heading)
        assert e.along_velocity_m_s == pytest.approx(
            nan if known == "nothing" else along, abs=0.01, nan_ok=True
        )


def test_rate_of_an_unknown_offset_is_unknown() -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    for i in range(200):
        estimator.add_imu(i * 10 * MS, (0.0, 0.0, 0.0))
        if i % 5 == 0:
            estimator.add_velocity(i * 10 * MS, (1.0, 0.0, 0.0))
            estimator.add_measurement(i * 10 * MS, frame(0.1))
    estimate = estimator.estimate()
    assert isnan(estimate.lateral_velocity_m_s)
    assert isnan(estimate.lateral_velocity_norm_s_std)
    assert estimate.along_velocity_m_s == pytest.approx(np.cos(0.1), abs=0.01)


def test_offset_in_metres_needs_a_width() -> None:
    bare, _ = steady()
    estimate = bare.estimate()
    assert estimate.lateral_offset_norm == pytest.approx(0.3, abs=0.01)
    assert isnan(estimate.lateral_offset_m)
    assert estimate.position == "right"
    wide, _ = steady(corridor_width_m=3.0)
    assert wide.estimate().lateral_offset_m == pytest.approx(0.45, abs=0.02)
    assert wide.estimate().lateral_offset_std_m == pytest.approx(
        1.5 * wide.estimate().lateral_offset_norm_std
    )


def test_width_from_the_cameras_height() -> None:
    estimator = CorridorEstimator(FusionConfig(camera_height_m=1.5))
    for i in range(60):
        ratio = 1.6 if i % 10 else 5.0  # one in ten far off
        estimator.add_measurement(
            i * 50 * MS, frame(0.0, lateral=0.5, lateral_std=0.02, width_per_height=ratio)
        )
    assert estimator.estimate().lateral_offset_m == pytest.approx(0.5 * 1.2, rel=0.06)


@settings(max_examples=10, deadline=None)
@given(st.floats(0.3, 5.0))
def test_offset_in_metres_grows_with_the_width_and_its_scale_free_form_does_not(factor: float) -> None:
    base, _ = steady(2.0, corridor_width_m=2.0)
    scaled, _ = steady(2.0, corridor_width_m=2.0 * factor)
    a, b = base.estimate(), scaled.estimate()
    assert b.lateral_offset_norm == pytest.approx(a.lateral_offset_norm, abs=0.01)
    assert b.lateral_offset_m == pytest.approx(a.lateral_offset_m * factor, abs=0.01 * factor)


def test_wrong_corners_are_rejected_and_lasting_ones_believed() -> None:
    estimator, t = steady(3.0)
    for i in range(12):
        t += 30 * MS
        estimator.add_imu(t, (0, 0, 0), AT_REST)
        wrong = -0.4 if i % 2 else 0.3
        estimator.add_measurement(t, frame(0.2, lateral=wrong, lateral_std=0.02))
        assert estimator.estimate().lateral_offset_norm == pytest.approx(0.3, abs=0.03)
    first, known = t, []
    while t < first + 6 * S:
        t += 30 * MS
        estimator.add_imu(t, (0, 0, 0), AT_REST)
        estimator.add_measurement(t, frame(0.2, lateral=-0.1, lateral_std=0.02))
        found = estimator.estimate()
        known.append(((t - first) / S, found.lateral_offset_norm))
        if 2.0 < known[-1][0] < 3.2:
            assert "jumped" in found.reason
            assert found.faults & Fault.NO_LATERAL_OFFSET
    # the first place, then none while either may be wrong, then the second; never between them
    assert all(isnan(y) or abs(y - 0.3) < 0.03 for t_s, y in known if t_s < 0.5)
    assert all(isnan(y) for t_s, y in known if 0.5 < t_s < 3.2)
    assert all(abs(y + 0.1) < 0.03 for t_s, y in known if t_s > 4.5)


@settings(max_examples=8, deadline=None)
@given(st.floats(0.25, 0.6), st.sampled_from([-1.0, 1.0]), st.floats(0.4, 3.0))
def test_an_offset_that_jumps_without_motion_is_unknown_until_it_returns(
    jump: float, side: float, seconds: float
) -> None:
    estimator, t = steady(3.0)
    for place, length_s in ((0.3 - side * jump, seconds), (0.3, 2.5)):
        end = t + round(length_s * S)
        while t < end:
            t += 30 * MS
            estimator.add_imu(t, (0, 0, 0), AT_REST)
            estimator.add_measurement(t, frame(0.2, lateral=place, lateral_std=0.02))
            found = estimator.estimate()
            assert isnan(found.lateral_offset_norm) or abs(found.lateral_offset_norm - 0.3) < 0.05
    assert estimator.estimate().lateral_offset_norm == pytest.approx(0.3, abs=0.05)


@settings(max_examples=6, deadline=None)
@given(st.sampled_from([0.8, 1.5, 3.0]), st.floats(-0.03, 0.03))
def test_sigma_covers_what_the_gyroscopes_scale_adds_up_in_a_turn(rate: float, scale: float) -> None:
    """A turn that frames do not see, by a gyroscope whose scale is off by up to three of its sigmas."""
    estimator, t = steady(3.0)
    before = estimator.estimate()
    for _ in range(50):
        t += 10 * MS
        estimator.add_imu(t, (0.0, 0.0, rate * (1.0 + scale)), AT_REST)
    found = estimator.estimate()
    error = (found.heading_rad - before.heading_rad - 0.5 * rate + np.pi) % (2 * np.pi) - np.pi
    assert found.heading_std_rad > 0.9 * FusionConfig().gyro_scale_std * rate * 0.5
    assert abs(error) < 4.0 * found.heading_std_rad


def test_a_slow_turn_costs_no_certainty() -> None:
    sigma = []
    for share in (0.0, 0.01):
        estimator, t = steady(3.0, gyro_scale_std=share)
        for i in range(100):
            t += 10 * MS
            estimator.add_imu(t, (0.0, 0.0, 0.1), AT_REST)
            if i % 5 == 0:
                estimator.add_measurement(t, frame(0.2 + 0.1 * (i + 1) * 0.01))
        sigma.append(estimator.estimate().heading_std_rad)
    assert sigma[0] <= sigma[1] < 1.01 * sigma[0]


def set_off(
    estimator: CorridorEstimator, t: int, forward: float, right: float, roll: float, accel: bool
) -> None:
    """Gain a level speed, m/s, within half a second and keep it for another, without frames, rolled."""

    def body(forward: float, right: float, down: float) -> tuple[float, float, float]:
        c, s = float(np.cos(roll)), float(np.sin(roll))
        return forward, c * right + s * down, c * down - s * right

    for i in range(1, 101):
        t += 10 * MS
        gained, rate = min(i / 50, 1.0), 2.0 if i <= 50 else 0.0
        estimator.add_attitude(t, quaternion(roll, 0.0, 0.5))
        estimator.add_velocity(t, body(gained * forward, gained * right, 0.0))
        force = body(rate * forward, rate * right, -9.80665)
        estimator.add_imu(t, (0.0, 0.0, 0.0), force if accel else None)


WAY_M = 0.75  # at 1 m/s


@pytest.mark.parametrize("accel", [True, False])
def test_forward_speed_moves_the_offset(accel: bool) -> None:
    estimator, t = steady(3.0, heading=0.2, corridor_width_m=2.0, velocity_std_m_s=0.02)
    before = estimator.estimate().lateral_offset_m
    set_off(estimator, t, 1.0, 0.0, 0.0, accel)
    now = estimator.estimate()
    assert now.lateral_status == "coasting"
    assert now.lateral_offset_m - before == pytest.approx(WAY_M * np.sin(0.2), abs=0.02)


@pytest.mark.parametrize(("accel", "lag_m"), [(True, 0.03), (False, 0.08)])
def test_velocity_is_levelled(accel: bool, lag_m: float) -> None:
    estimator, t = steady(3.0, heading=0.0, corridor_width_m=2.0, velocity_std_m_s=0.02)
    before = estimator.estimate().lateral_offset_m
    set_off(estimator, t, 0.0, -1.0, radians(20), accel)
    now = estimator.estimate()
    assert now.lateral_status == "coasting"
    assert estimator._timeline.state.velocity.sideways_m_s == pytest.approx(-1.0, abs=0.01)
    assert now.lateral_offset_m - before == pytest.approx(-WAY_M, abs=lag_m)


def test_flying_back_the_offset_keeps_its_side() -> None:
    scene = Scene(
        seed=12,
        duration_s=14,
        heading=turning((5, 3, pi)),
        lateral=lambda t: np.full_like(np.asarray(t, float), 0.4),
        tilt_rad=radians(3),
        accel=True,
        **QUICK,
    )
    result = run(simulate(scene))
    for rows in ((result.t_s > 1) & (result.t_s < 5), result.t_s > 8):  # along the axis, and back
        known = np.isfinite(result.lateral) & rows
        assert known.sum() > 0.95 * rows.sum()
        assert result.lateral[known] == pytest.approx(0.4, abs=0.1)
    assert degrees(abs(wrap(result.heading[-1] - pi))) < 1.5


def test_camera_mount_is_learned_and_handed_on() -> None:
    estimator = CorridorEstimator()
    for i in range(400):
        t = i * 50 * MS
        estimator.add_attitude(t, quaternion(0.0, 0.0, 0.3))
        estimator.add_measurement(t, frame(0.0, elevation_rad=radians(-2.2), elevation_std_rad=radians(0.2)))
    prior = estimator._engine.frame_fusion.expected(estimator._timeline.state, t)
    assert degrees(prior.elevation_rad) == pytest.approx(-2.2, abs=0.15)
    assert degrees(prior.elevation_std_rad) < 0.5


# The interface


def test_the_filter_to_look_at_is_filterpys() -> None:
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    assert isinstance(estimator.ekf, ExtendedKalmanFilter)
    go_on(estimator, 0, 2.0, 0.2)
    ekf, estimate = estimator.ekf, estimator.estimate()
    assert float(ekf.x[0]) == pytest.approx(estimate.heading_rad)
    assert np.sqrt(ekf.P[0, 0]) == pytest.approx(estimate.heading_std_rad)
    assert float(ekf.x[1]) == pytest.approx(estimate.gyro_bias_rad_s)
    assert ekf.F[0, 1] < 0.0  # a bias turns the heading back
    assert ekf.Q[0, 0] > 0.0
    assert ekf.K.shape == (3, 1)
    assert 0.0 < ekf.K[0, 0] < 1.0
    assert ekf.likelihood > 0.0
    assert ekf.mahalanobis == pytest.approx(abs(ekf.y[0]) / np.sqrt(ekf.S[0, 0]))


def test_pictures_need_a_camera() -> None:
    with pytest.raises(InputError, match="has no camera"):
        CorridorEstimator().add_frame(0, np.zeros((48, 64), np.uint8))


def test_unknown_method_is_refused() -> None:
    with pytest.raises(InputError, match="method 'magic' is unknown"):
        CorridorEstimator(method="magic")


def test_a_camera_ahead_of_the_centre_does_not_move_the_vehicle() -> None:
    camera = replace(Camera.from_fov(320, 240, 1.2), p_body_camera_m=np.array([0.3, 0.0, 0.0]))
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0), camera)
    for k in range(400):
        t_ns = k * 5_000_000
        estimator.add_imu(t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.81))
        if k % 10 == 0:  # turned right by 0.3 rad, the centre of the body on the centre line
            seen = 0.3 * np.sin(0.3) / 1.0
            measured = FrameMeasurement(
                True,
                Reason.OK,
                20,
                12,
                heading_rad=0.3,
                heading_std_rad=0.005,
                lateral_offset_norm=seen,
                lateral_offset_norm_std=0.02,
            )
            estimator.add_measurement(t_ns, measured)
    assert estimator.estimate().lateral_offset_m == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "value"), [("heading_rad", None), ("heading_std_rad", "0.1"), ("elevation_rad", None)]
)
def test_what_is_no_number_of_a_measurement_is_refused(name: str, value: object) -> None:
    changes: dict[str, Any] = {name: value}
    with pytest.raises(InputError, match=f"{name} = {value!r} is not a number .*NaN"):
        CorridorEstimator().add_measurement(0, replace(frame(0.1), **changes))


@pytest.mark.parametrize("measurement", [None, {"heading_rad": 0.1}])
def test_what_is_no_measurement_is_refused(measurement: Any) -> None:
    estimator = CorridorEstimator()
    with pytest.raises(InputError, match=f"measurement is of type {type(measurement).__name__}"):
        estimator.add_measurement(0, measurement)
    assert estimator.add_measurement(0, frame(float(np.float32(0.1)))).accepted


def test_settings_of_another_type_are_refused() -> None:
    settings_of_a_file: Any = {"corridor_width_m": 2.2}
    with pytest.raises(InputError, match=r"config is of type dict .*FusionConfig\(\*\*settings\)"):
        CorridorEstimator(settings_of_a_file)
