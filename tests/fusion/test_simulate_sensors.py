"""Inertial and image sensors with the errors of real ones, flights on slopes and past steps, and random flights."""

from __future__ import annotations

from math import tan
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.simulate import (
    CameraConfig,
    ImagingConfig,
    ImuConfig,
    SceneConfig,
    SimulationConfig,
    random_views,
    simulate_flight,
)
from fusion.simulate.config import MotionConfig, RangeConfig, least_half_width_m
from fusion.simulate.imu import read_imu, read_range, rotor_vibration, sample_times
from fusion.simulate.motion import Trajectory, plan_flight
from fusion.simulate.render.view import View
from fusion.simulate.scene.plan import floor_plan
from fusion.simulate.scene.random_scene import is_night
from fusion.simulate.sensor import Sensor
from vision import Camera, InputError

FloatArray = npt.NDArray[np.float64]

SILENT: dict[str, Any] = {
    "gyro_noise_density": 0, "gyro_bias_std_rad_s": 0, "gyro_random_walk": 0,
    "accel_noise_density": 0, "accel_bias_std_m_s2": 0, "accel_random_walk": 0,
}  # fmt: skip


def flight_of(scene: SceneConfig, seed: int = 1, **motion: Any) -> Trajectory:
    return plan_flight(MotionConfig(**motion), *floor_plan(scene), seed)


# --- inertial sensors ---------------------------------------------------------------------------------------------


def test_vibration_has_the_size_and_the_folded_frequencies_that_were_asked_for() -> None:
    config = ImuConfig(rate_hz=200, vibration_m_s2=1.5, rotor_hz=140, vibration_harmonics=2)
    t = sample_times(60.0, 200)
    shaken = rotor_vibration(t, config, np.random.default_rng(1))
    assert np.sqrt(np.mean(shaken**2, axis=0)) == pytest.approx([1.5, 1.5, 3.0])
    power = np.abs(np.fft.rfft(shaken[:, 0])) ** 2
    frequency = np.fft.rfftfreq(len(t), 1 / 200)
    # 140 Hz and 280 Hz at 200 samples a second: 60 and 80 Hz, each within its rotors' spread
    near = (np.abs(frequency - 60) < 140 * 0.09) | (np.abs(frequency - 80) < 280 * 0.09)
    assert power[near].sum() > 0.97 * power.sum()
    assert power[np.abs(frequency - 60) < 140 * 0.09].sum() > 0.5 * power.sum()


def test_vibration_only_adds_to_the_accelerometer() -> None:
    truth = flight_of(SceneConfig(), duration_s=5.0).truth(sample_times(5.0, 200))
    still, shaken = (read_imu(truth, ImuConfig(vibration_m_s2=size), 3) for size in (0.0, 2.0))
    assert np.array_equal(still.gyro_rad_s, shaken.gyro_rad_s)
    added = shaken.accel_m_s2 - still.accel_m_s2
    assert added[:, 1].std() == pytest.approx(2.0, rel=0.01)
    assert np.array_equal(still.accel_bias_m_s2, shaken.accel_bias_m_s2)


def test_scale_errors_and_misalignment_are_a_matrix_near_one() -> None:
    truth = flight_of(SceneConfig(length_m=60), duration_s=30.0, tilt_rad=0.4).truth(sample_times(30.0, 200))
    scales, skews = [], []
    for seed in range(150):
        config = ImuConfig(**SILENT, gyro_scale_std=0.02, accel_scale_std=0.01, misalignment_std_rad=0.005)
        imu = read_imu(truth, config, seed)
        for read, exact in ((imu.gyro_rad_s, truth.rate_rad_s), (imu.accel_m_s2, truth.specific_force_m_s2)):
            E = np.linalg.lstsq(exact, read, rcond=None)[0].T - np.eye(3)
            assert np.allclose(read, exact @ (np.eye(3) + E).T, atol=1e-9)
            scales.append(np.diag(E))
            skews.append(E[~np.eye(3, dtype=bool)])
    assert np.std(scales[0::2]) == pytest.approx(0.02, rel=0.12)
    assert np.std(scales[1::2]) == pytest.approx(0.01, rel=0.12)
    assert np.std(skews) == pytest.approx(0.005, rel=0.1)


# --- the image sensor ---------------------------------------------------------------------------------------------

GREY: dict[str, Any] = {
    "brightness": 0.2, "full_well_electrons": 8000, "read_noise_electrons": 5, "defocus_px": 0, "bloom": 0,
    "vignetting": 0, "gamma": 1.0,
}  # fmt: skip
FLAT = np.ones((100, 200), np.float32)
VIEW = View.of(Camera.from_fov(200, 100, 0.2))


def pictures(count: int, **changes: Any) -> FloatArray:
    sensor = Sensor.of(ImagingConfig(**(GREY | changes)), VIEW, 1.0, seed=4)
    return np.array([sensor.develop(FLAT, np.random.default_rng(k)) for k in range(count)], float)


def test_gain_makes_the_same_light_noisier() -> None:
    electrons = {gain: 0.2 * 8000 / gain for gain in (1.0, 16.0)}
    for gain, mean in electrons.items():
        noise = pictures(1, gain=gain)
        expected = 255 * np.hypot(np.sqrt(mean), 5) * gain / 8000
        assert noise.mean() == pytest.approx(51, abs=0.6)
        assert noise.std() == pytest.approx(np.hypot(expected, 12**-0.5), rel=0.05)


def test_the_fixed_pattern_stays_and_rows_flicker() -> None:
    calm = {"read_noise_electrons": 0.0, "gain": 8.0}
    mean = pictures(60, **calm, fixed_pattern_electrons=30).mean(axis=0)
    assert mean.std() == pytest.approx(255 * 30 * 8 / 8000, rel=0.1)
    assert pictures(60, **calm).mean(axis=0).std() < 0.3 * mean.std()
    rows = pictures(2, **calm, row_noise_electrons=20).mean(axis=2)
    assert rows.std(axis=1) == pytest.approx([255 * 20 * 8 / 8000] * 2, rel=0.25)
    assert abs(np.corrcoef(rows)[0, 1]) < 0.4
    unequal = pictures(60, **calm, response_std=0.1).mean(axis=0)
    assert unequal.std() == pytest.approx(0.1 * 51, rel=0.15)


# --- flights ------------------------------------------------------------------------------------------------------


def test_on_a_slope_the_flight_climbs_and_heading_and_offset_stay() -> None:
    flat, steep = (flight_of(SceneConfig(slope_rad=slope), duration_s=8.0) for slope in (0.0, 0.1))
    t = sample_times(8.0, 100)
    level, climbing = flat.truth(t), steep.truth(t)
    assert np.array_equal(level.heading_rad, climbing.heading_rad)
    assert np.allclose(level.lateral_offset_m, climbing.lateral_offset_m, atol=1e-12)
    rise = level.p_world_m[:, 2] - climbing.p_world_m[:, 2]
    assert np.allclose(rise, tan(0.1) * level.p_world_m[:, 0], atol=1e-7)
    climb = climbing.v_world_m_s[:, 2] - level.v_world_m_s[:, 2]
    assert np.allclose(climb, -tan(0.1) * level.v_world_m_s[:, 0], atol=1e-7)
    place = np.array([0.1, -0.05, 0.02])
    distance = read_range(steep, RangeConfig(rate_hz=50, noise_std_m=0.0), place, 1)
    truth = steep.truth(distance.t_s)
    down = place + distance.distance_m[:, None] * np.array([0.0, 0.0, 1.0])
    ends = truth.p_world_m + np.einsum("nij,nj->ni", truth.R_world_body, down)
    assert np.allclose(ends[:, 2], -tan(0.1) * ends[:, 0], atol=1e-9)


@pytest.mark.parametrize(("moves", "middle_m"), [("both", 0.0), ("left", 0.3), ("right", -0.3)])
def test_past_a_step_truth_has_the_new_width_and_middle(moves: str, middle_m: float) -> None:
    step = {"at_m": 8.0, "width_m": 1.8, "moves": moves}
    scene = SceneConfig.model_validate({"width_m": 2.4, "width_step": step})
    truth = flight_of(scene, duration_s=15.0).truth(sample_times(15.0, 50))
    behind = truth.p_world_m[:, 0] > 8.0
    assert 0.2 < behind.mean() < 0.8
    assert np.array_equal(truth.corridor_width_m, np.where(behind, 1.8, 2.4))
    aside = truth.p_world_m[:, 1] - np.where(behind, middle_m, 0.0)
    assert np.allclose(truth.lateral_offset_m, aside, atol=1e-9)
    assert (truth.corridor_id == 1).all()
    assert least_half_width_m(scene) == pytest.approx(0.9 if moves == "both" else 0.6)
    with pytest.raises(InputError, match="touch a wall"):
        SimulationConfig.from_values({"scene": {"width_step": step}, "motion": {"lateral_amplitude_m": 0.75}})


@pytest.mark.parametrize("margin_m", [1.0, 2.0])
def test_a_flight_stops_as_near_to_the_end_as_it_may(margin_m: float) -> None:
    trajectory = flight_of(SceneConfig(length_m=12), duration_s=20.0, start_m=3.0, end_margin_m=margin_m)
    assert trajectory.position(20.0)[0] == pytest.approx(12 - margin_m, abs=0.03)


# --- drawn at random ----------------------------------------------------------------------------------------------


@given(st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_random_flights_are_valid_and_repeat(seed: int) -> None:
    flight = SimulationConfig.random(seed, motion={"duration_s": 20.0})
    assert flight == SimulationConfig.random(seed, motion={"duration_s": 20.0})
    assert flight.motion.duration_s == 20.0
    assert abs(flight.camera.mount_pitch_rad) <= np.radians(6.0) + 1e-9
    if is_night(seed):
        assert flight.camera.exposure_s == 0.02
        assert flight.imaging.gain >= 2
    rays = flight.camera.camera().rays([[0.0, 120.0], [160.0, 120.0], [319.0, 120.0]])
    assert np.isfinite(rays).all()
    trajectory = plan_flight(flight.motion, *floor_plan(flight.scene), seed)
    truth = trajectory.truth(np.arange(0, 20, 0.1))
    clear = truth.corridor_width_m / 2 - np.abs(truth.lateral_offset_m)
    assert clear[~truth.in_junction].min() > 0.15
    height = -truth.p_world_m[:, 2] - tan(flight.scene.slope_rad) * truth.p_world_m[:, 0]
    assert height.min() > 0.2
    assert height.max() < flight.scene.height_m - 0.2


def test_random_flights_have_several_lenses_imus_and_ways() -> None:
    flights = [SimulationConfig.random(seed) for seed in range(200)]
    shares = {
        "fisheye": [f.camera.distortion == "equidistant" for f in flights],
        "radtan": [f.camera.distortion == "radtan" for f in flights],
        "mount": [abs(f.camera.mount_pitch_rad) > 0.03 for f in flights],
        "rolling": [f.camera.line_delay_s > 0 for f in flights],
        "shaken": [f.imu is not None and f.imu.vibration_m_s2 > 0.3 for f in flights],
        "aside": [abs(f.motion.lateral_mean_m) > 0.15 for f in flights],
        "slow": [f.motion.speed_m_s < 0.5 for f in flights],
        "low": [f.motion.height_m < 0.8 for f in flights],
        "to the end": [
            f.motion.start_m + 15 * f.motion.speed_m_s > f.scene.length_m - f.motion.end_margin_m - 0.01
            for f in flights
        ],
    }
    for name, found in shares.items():
        assert 0.1 < np.mean(found) < 0.8, name


def test_what_is_fixed_of_a_section_stays_and_the_rest_is_drawn() -> None:
    small = {"width_px": 64, "height_px": 48}
    flight = SimulationConfig.random(5, scene={"width_m": 3.0}, camera=small, attitude=None)
    assert (flight.scene.width_m, flight.camera.width_px, flight.attitude) == (3.0, 64, None)
    assert flight.scene == SceneConfig.random(5, width_m=3.0)
    assert flight.camera == CameraConfig.random(5, width_px=64, height_px=48)
    assert flight.imu == ImuConfig.random(5)
    assert SimulationConfig.random(5, imu=None).imu is None


@pytest.mark.parametrize("seed", [1, 22])
def test_a_random_flight_is_the_same_byte_for_byte(tmp_path: Path, seed: int) -> None:
    small = {"width_px": 64, "height_px": 48, "rate_hz": 5.0}
    config = SimulationConfig.random(seed, camera=small, motion={"duration_s": 0.6}, light_cell_m=0.5)
    first, again = (simulate_flight(config, tmp_path / name) for name in ("a", "b"))
    names = sorted(str(p.relative_to(first)) for p in first.rglob("*") if p.is_file())
    assert len(names) > 8
    for name in names:
        assert (first / name).read_bytes() == (again / name).read_bytes()


def test_random_views_tell_the_cross_section_where_they_stand() -> None:
    step = {"at_m": 5.0, "width_m": 1.6, "moves": "left"}
    scene = SceneConfig.model_validate(
        {"length_m": 10, "width_m": 2.4, "slope_rad": 0.06, "width_step": step}
    )
    camera = Camera.from_fov(32, 24, 1.2)
    views = list(
        random_views(camera, 12, 1, scene=scene, min_ahead_m=1.0, views_per_scene=12, light_cell_m=0.5)
    )
    ahead = np.array([v.ahead_m for v in views])
    assert ahead.min() > 0.99
    assert [v.width_m for v in views] == [1.6 if a <= 5.0 else 2.4 for a in ahead]
    assert len({v.width_m for v in views}) == 2
    assert all(0.3 * 2.6 <= v.height_m <= 0.75 * 2.6 for v in views)
    assert {(v.slope_rad, v.ceiling_m) for v in views} == {(0.06, 2.6)}
