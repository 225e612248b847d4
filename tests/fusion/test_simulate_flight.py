"""Simulated flights: motion, sensors, truth's signs, the folder, and that a seed means the same bytes."""

from __future__ import annotations

from math import degrees, radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.logs import load_flight
from fusion.logs.asl import read_ground_truth
from fusion.simulate import SimulationConfig, random_views, simulate_flight, simulate_frames, single_views
from fusion.simulate.config import AttitudeConfig, ImuConfig, MotionConfig, RangeConfig
from fusion.simulate.imu import read_attitude, read_imu, read_range, sample_times
from fusion.simulate.motion import GRAVITY_M_S2, Trajectory, oscillation, plan_flight
from fusion.simulate.scene.config import JunctionConfig, SceneConfig
from fusion.simulate.scene.plan import Room, floor_plan, outline
from tests.pictures import picture_paths, read_grey
from vision import Camera, InputError
from vision.cameras.camera import Distortion

SMALL: dict[str, Any] = {
    "seed": 4,
    "light_cell_m": 0.5,
    "scene": {"length_m": 10, "people": 1},
    "camera": {"width_px": 64, "height_px": 48},
    "motion": {"duration_s": 0.5, "start_m": 2.0},
}


def config(**changes: Any) -> SimulationConfig:
    sections = {k: {**SMALL[k], **v} if isinstance(SMALL.get(k), dict) else v for k, v in changes.items()}
    return SimulationConfig.from_values({**SMALL, **sections})


def flight_of(scene: SceneConfig, seed: int = 1, **motion: Any) -> Trajectory:
    return plan_flight(MotionConfig(**motion), *floor_plan(scene), seed)


def files(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


# --- motion -------------------------------------------------------------------------------------------------------


def test_body_rates_and_specific_force_are_the_derivatives_of_the_path() -> None:
    trajectory = flight_of(SceneConfig(length_m=60), duration_s=4.0, heading_rate_rad_s=1.5, tilt_rad=0.2)
    t = np.arange(0.0, 4.0, 2e-4)
    truth = trajectory.truth(t)
    turned = Rotation.from_matrix(truth.R_world_body[0])
    middle = trajectory.truth(t[:-1] + 1e-4)
    for step in Rotation.from_rotvec(middle.rate_rad_s * 2e-4):
        turned = turned * step
    final = Rotation.from_matrix(truth.R_world_body[-1])
    assert (turned.inv() * final).magnitude() < 1e-6
    force = np.einsum("nij,nj->ni", middle.R_world_body, middle.specific_force_m_s2)
    force[:, 2] += GRAVITY_M_S2
    assert np.allclose(np.diff(truth.v_world_m_s, axis=0) / 2e-4, force, atol=1e-4)
    assert np.allclose(np.diff(truth.p_world_m, axis=0) / 2e-4, middle.v_world_m_s, atol=1e-6)


@given(st.floats(0.02, 1.0), st.floats(0.8, 6.0), st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_swings_have_the_amplitude_and_rate_asked_for(amplitude: float, quickness: float, seed: int) -> None:
    t, rate = np.arange(0, 20, 0.01), quickness * amplitude
    wave = oscillation(np.random.default_rng(seed), t, amplitude, rate)
    assert np.abs(wave).max() == pytest.approx(amplitude, rel=1e-6)
    assert np.abs(np.gradient(wave, t)).max() == pytest.approx(rate, rel=0.1)


def test_tilt_stays_within_what_was_asked_for_and_pushes_the_vehicle() -> None:
    trajectory = flight_of(
        SceneConfig(length_m=60, width_m=3),
        duration_s=10.0,
        lateral_amplitude_m=0.8,
        lateral_rate_m_s=1.5,
        tilt_rad=0.3,
    )
    t = np.arange(0, 10, 0.01)
    angles = trajectory.angles(t)
    assert 0.2 < np.abs(angles[:, :2]).max() < 0.32
    sideways = trajectory.position(t, 2)[:, 1]
    assert np.corrcoef(sideways, angles[:, 0])[0, 1] > 0.3  # right wing down to go right


@given(
    angle_deg=st.floats(30, 150),
    left=st.booleans(),
    crossing=st.booleans(),
    width_m=st.floats(1.6, 3.0),
)
@settings(max_examples=25, deadline=None)
def test_a_turn_ends_on_the_next_corridors_axis(
    angle_deg: float, left: bool, crossing: bool, width_m: float
) -> None:
    angle = radians(-angle_deg if left else angle_deg)
    junction = JunctionConfig(at_m=12, angle_rad=angle, width_m=width_m, length_m=20, crossing=crossing)
    scene = SceneConfig(length_m=25, junctions=(junction,))
    trajectory = flight_of(
        scene,
        duration_s=22.0,
        route=(2,),
        heading_amplitude_rad=0,
        lateral_amplitude_m=0,
        height_amplitude_m=0,
    )
    truth = trajectory.truth(np.arange(0, 22, 0.02))
    before, after = truth.corridor_id == 1, truth.corridor_id == 2
    assert before[0]
    assert after[-1]
    assert np.count_nonzero(np.diff(truth.corridor_id)) == 1
    settled = after & ~truth.in_junction
    assert settled.any()
    assert np.abs(truth.heading_rad[settled]).max() < 1e-6
    assert np.abs(truth.lateral_offset_m[settled]).max() < 0.01
    assert np.abs(truth.lateral_offset_m[before & ~truth.in_junction]).max() < 0.01
    assert np.allclose(truth.corridor_width_m[after], width_m)
    change = int(np.flatnonzero(np.diff(truth.corridor_id))[0])
    assert truth.in_junction[change]
    # just before the change the vehicle has turned half the angle, just after half of it is missing
    assert truth.heading_rad[change] == pytest.approx(angle / 2, abs=0.1)
    assert truth.heading_rad[change + 1] == pytest.approx(-angle / 2, abs=0.1)
    inside = np.zeros(len(truth.t_s), bool)
    for room in trajectory.rooms:
        inside |= room.contains(truth.p_world_m[:, :2], -0.1)
    assert inside.all()  # never through a wall


@given(
    st.lists(
        st.tuples(
            st.floats(4, 16),
            st.sampled_from(range(30, 151, 15)),
            st.booleans(),
            st.booleans(),
            st.floats(1.2, 4),
        ),
        max_size=3,
    ),
    st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_walls_have_the_inside_on_one_side_only(
    junctions: list[tuple[float, float, bool, bool, float]], hall: bool
) -> None:
    scene = SceneConfig(
        length_m=20,
        open_hall_m=(3, 12) if hall else None,
        junctions=tuple(
            JunctionConfig(
                at_m=s, angle_rad=radians(-a if left else a), crossing=cross, width_m=w, length_m=9
            )
            for s, a, left, cross, w in junctions
        ),
    )
    rooms, _ = floor_plan(scene)
    for wall in outline(rooms):
        if wall.length_m < 0.3:
            continue
        ends = 0.1 / wall.length_m  # in a sharp corner the other room is near
        points = wall.start + np.linspace(ends, 1 - ends, 15)[:, None] * (wall.end - wall.start)

        def inside(at: Any) -> Any:
            return np.any([room.contains(at) for room in rooms], axis=0)

        assert inside(points + 0.004 * wall.inward).all()
        assert not inside(points - 0.004 * wall.inward).any()


def test_coordinates_of_a_turned_room_go_there_and_back() -> None:
    room = Room(2.0, -1.0, radians(30), 10.0, 2.0)
    there = room.to_world(3.0, 0.5)
    assert np.allclose(room.to_room(there), [[3.0, 0.5]])
    assert there[1] > -1.0  # turned right: going ahead leads to the right


# --- sensors ------------------------------------------------------------------------------------------------------


def test_the_imus_noise_is_what_its_density_says() -> None:
    trajectory = flight_of(SceneConfig(length_m=60), duration_s=100.0)
    rates = ImuConfig(
        rate_hz=400,
        gyro_noise_density=0.004,
        accel_noise_density=0.03,
        gyro_random_walk=1e-3,
        gyro_bias_std_rad_s=0.05,
    )
    truth = trajectory.truth(sample_times(100.0, 400))
    imu = read_imu(truth, rates, 3)
    gyro = imu.gyro_rad_s - truth.rate_rad_s - imu.gyro_bias_rad_s
    accel = imu.accel_m_s2 - truth.specific_force_m_s2 - imu.accel_bias_m_s2
    assert gyro.std() / 400**0.5 == pytest.approx(0.004, rel=0.01)
    assert accel.std() / 400**0.5 == pytest.approx(0.03, rel=0.01)
    walked = imu.gyro_bias_rad_s[400::400] - imu.gyro_bias_rad_s[:-400:400]  # over a second each
    assert walked.std() == pytest.approx(1e-3, rel=0.15)
    assert np.abs(imu.gyro_bias_rad_s[0]).max() < 0.2


def test_at_rest_and_level_gravity_points_up_in_the_accelerometer() -> None:
    still = {"heading_amplitude_rad": 0, "lateral_amplitude_m": 0, "height_amplitude_m": 0, "tilt_rad": 0}
    truth = flight_of(SceneConfig(), duration_s=2.0, speed_m_s=0, **still).truth(np.arange(0, 2, 0.1))
    assert np.allclose(truth.specific_force_m_s2, [0, 0, -GRAVITY_M_S2], atol=1e-6)
    assert np.allclose(truth.rate_rad_s, 0, atol=1e-9)


def test_the_attitude_filters_errors_are_what_was_asked_for() -> None:
    trajectory = flight_of(SceneConfig(length_m=60), duration_s=300.0)
    settings_ = AttitudeConfig(
        tilt_std_rad=0.01, tilt_time_s=0.5, yaw_offset_rad=0.7, yaw_drift_rad_s=0.001, yaw_walk=0,
        disturbance_rad=0.3, disturbance_start_s=100, disturbance_s=50,
    )  # fmt: skip
    samples = read_attitude(trajectory, settings_, None, 2)
    error = (
        Rotation.from_quat(np.roll(samples.q_world_body, -1, axis=1))
        * Rotation.from_matrix(trajectory.rotations(samples.t_s)).inv()
    )
    yaw, *tilt = error.as_euler("ZYX").T
    assert np.std(tilt) == pytest.approx(0.01, rel=0.1)
    t = samples.t_s
    expected = 0.7 + 0.001 * t + 0.3 * ((t > 100) & (t < 150))
    calm = (np.abs(t - 100) > 2) & (np.abs(t - 150) > 2)
    assert np.allclose(yaw[calm], expected[calm], atol=2e-4)


def test_a_yaw_that_follows_the_gyroscope_shares_its_error() -> None:
    trajectory = flight_of(SceneConfig(length_m=60), duration_s=30.0)
    imu = read_imu(trajectory.truth(sample_times(30.0, 200)), ImuConfig(gyro_noise_density=0.02), 5)
    settings_ = AttitudeConfig(
        tilt_std_rad=0, yaw_offset_rad=0, yaw_follows_gyro=True, compass_time_s=1e6, yaw_walk=0
    )
    samples = read_attitude(trajectory, settings_, imu, 5)
    error = (
        Rotation.from_quat(np.roll(samples.q_world_body, -1, axis=1))
        * Rotation.from_matrix(trajectory.rotations(samples.t_s)).inv()
    )
    truth = trajectory.truth(imu.t_s)
    wrong = np.einsum(
        "ni,ni->n", imu.gyro_rad_s - truth.rate_rad_s - imu.gyro_bias_rad_s[0], truth.R_world_body[:, 2]
    )
    integrated = np.interp(samples.t_s, imu.t_s, (np.cumsum(wrong) - wrong) / 200)
    yaw = error.as_euler("ZYX")[:, 0]
    assert np.std(integrated) > 0.01
    assert np.allclose(yaw, integrated, atol=3e-4)


# --- pictures and folder ------------------------------------------------------------------------------------------


def brightest_column(image: Any) -> float:
    bright = (image.astype(float) > 0.9 * image.max()).astype(float)
    rows = slice(image.shape[0] // 4, 3 * image.shape[0] // 4)
    return float((bright[rows] * np.arange(image.shape[1])).sum() / bright[rows].sum())


@pytest.mark.parametrize(
    ("heading", "offset", "side"), [(0.2, 0.0, -1), (-0.2, 0.0, 1), (0.0, 0.5, -1), (0.0, -0.5, 1)]
)
def test_turned_or_moved_right_the_corridors_end_stands_left(
    heading: float, offset: float, side: int
) -> None:
    """The end is a bright window, in a corridor without a lamp in sight."""
    scene = {
        "end": "window",
        "lamp_radiance": 0.01,
        "daylight": 8,
        "open_door_share": 0,
        "length_m": 9,
        "width_m": 2.4,
    }
    motion = {"heading_mean_rad": heading, "lateral_mean_m": offset, "heading_amplitude_rad": 0}
    motion |= {
        "lateral_amplitude_m": 0,
        "tilt_rad": 0,
        "height_amplitude_m": 0,
        "duration_s": 0.3,
        "start_m": 2,
    }
    frames = list(
        simulate_frames(config(scene=scene, motion=motion, imaging={"brightness": 0.03, "bloom": 0}))
    )
    assert len(frames) == 7
    for frame in frames:
        assert frame.truth.heading_rad[0] == pytest.approx(heading, abs=1e-6)
        assert frame.truth.lateral_offset_m[0] == pytest.approx(offset, abs=1e-6)
        assert side * (brightest_column(frame.image) - 31.5) > 2


@pytest.mark.parametrize("body_frame", ["flu", "frd"])
def test_a_folder_loads_with_everything_in_it(tmp_path: Path, body_frame: str) -> None:
    lens = {"distortion": "equidistant", "coefficients": [0.01, -0.02, 0.0, 0.0], "horizontal_fov_rad": 2.0}
    mount = {
        "mount_roll_rad": 0.05,
        "mount_pitch_rad": -0.1,
        "mount_yaw_rad": 0.2,
        "position_m": [0.1, 0.02, -0.03],
    }
    asked = config(
        body_frame=body_frame, camera={**lens, **mount, "exposure_s": 0.004}, imaging={"jpeg_quality": None}
    )
    done: list[tuple[int, int]] = []
    root = simulate_flight(asked, tmp_path / "hall", lambda *step: done.append(step))
    flight = load_flight(root)
    assert flight.problems == ()
    assert done[-1] == (11, 11)
    assert len(flight.frames.t_ns) == 11
    camera = asked.camera.camera()
    assert flight.camera.distortion is Distortion.EQUIDISTANT
    assert np.allclose(flight.camera.R_body_camera, camera.R_body_camera, atol=1e-9)
    assert np.allclose(flight.camera.p_body_camera_m, [0.1, 0.02, -0.03])
    assert flight.camera.exposure_s == 0.004
    assert np.allclose(flight.camera.rays([[3, 4]]), camera.rays([[3, 4]]), atol=1e-9)
    assert flight.imu is not None
    assert flight.imu.gyro_noise_density == 0.005
    assert np.median(flight.imu.accel_m_s2[:, 2]) == pytest.approx(-GRAVITY_M_S2, abs=0.5)
    state = read_ground_truth(root)
    trajectory = flight_of(asked.scene, asked.seed, **asked.motion.model_dump())
    truth = trajectory.truth((state.t_ns - asked.start_ns) / 1e9)
    assert np.allclose(state.p_world_m, truth.p_world_m, atol=1e-7)
    assert np.allclose(state.v_world_m_s, truth.v_world_m_s, atol=1e-7)
    R = Rotation.from_quat(np.roll(state.q_world_body, -1, axis=1)).as_matrix()
    assert np.allclose(R, truth.R_world_body, atol=1e-7)
    assert flight.attitude is not None
    attitude = Rotation.from_quat(np.roll(flight.attitude.q_world_body, -1, axis=1)).as_euler("ZYX")
    angles = trajectory.angles((flight.attitude.t_ns - asked.start_ns) / 1e9)
    assert np.abs(attitude[:, :0:-1] - angles[:, :2]).max() < radians(2.5)
    assert flight.truth is not None
    assert np.allclose(flight.truth.heading_rad, truth.heading_rad, atol=1e-8)
    assert np.allclose(flight.truth.lateral_offset_m, truth.lateral_offset_m, atol=1e-6)
    assert "seed 4" in (root / "README.md").read_text()


def test_frames_in_memory_are_the_folders_frames(tmp_path: Path) -> None:
    root = simulate_flight(config(), tmp_path / "a")
    flight = load_flight(root)
    for frame, t, path in zip(
        simulate_frames(config()), flight.frames.t_ns, picture_paths(flight), strict=True
    ):
        assert frame.t_ns == t
        assert np.array_equal(frame.image, read_grey(path))


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not(tmp_path: Path) -> None:
    first, again = (files(simulate_flight(config(), tmp_path / name)) for name in ("a", "b"))
    other = files(simulate_flight(config(seed=5), tmp_path / "c"))
    assert first == again
    for name in first:
        if name.endswith((".jpg", "imu0/data.csv", "attitude0/data.csv", "corridor_truth.csv")):
            assert first[name] != other[name]


def test_random_views_repeat_and_depend_on_the_seed() -> None:
    camera = Camera.from_fov(64, 48, 1.2)
    taken = []
    for seed in (1, 1, 2):
        single_views._built.cache_clear()  # the corridor is built again, too
        taken.append(list(random_views(camera, 3, seed, views_per_scene=2)))
    first, again, other = taken
    for a, b, c in zip(first, again, other, strict=True):
        assert np.array_equal(a.image, b.image)
        assert a.heading_rad == b.heading_rad
        assert not np.array_equal(a.image, c.image)
    assert first[0].scene_seed == first[1].scene_seed != first[2].scene_seed
    assert max(abs(degrees(v.heading_rad)) for v in first) <= 25


def test_an_exposures_blur_does_not_move_a_view() -> None:
    """Blurred evenly about the middle, the mean column of the light stays; the sharpness does not."""
    camera = Camera(64, 48, 60, 60, 31.5, 23.5, exposure_s=0.02)
    plain: dict[str, Any] = {
        "seed": 3,
        "imaging": SimulationConfig().imaging.model_copy(update={"noise": False, "jpeg_quality": None}),
    }
    still = next(random_views(camera, 1, **plain)).image.astype(float)
    moving = next(random_views(camera, 1, yaw_rate_rad_s=5.0, **plain)).image.astype(float)
    sharp, soft = (np.abs(np.diff(i, axis=1)).sum() for i in (still, moving))
    assert soft < 0.8 * sharp
    assert moving[:, 10:-10].mean() == pytest.approx(still[:, 10:-10].mean(), rel=0.05)


def test_stamps_are_late_by_the_offset_and_lost_frames_are_missing(tmp_path: Path) -> None:
    shutter = {
        "time_offset_s": 0.08,
        "lost_frames_share": 0.4,
        "rate_hz": 25,
        "width_px": 16,
        "height_px": 16,
    }
    asked = config(motion={"duration_s": 2.0}, camera=shutter)
    t = np.array([frame.t_ns for frame in simulate_frames(asked)]) - asked.start_ns
    assert 15 < len(t) < 45
    assert np.allclose((t / 1e9 - 0.08) * 25, np.round((t / 1e9 - 0.08) * 25))
    assert np.diff(t).max() > 1.5e9 / 25


def test_without_imu_and_attitude_their_folders_are_not_there(tmp_path: Path) -> None:
    root = simulate_flight(config(imu=None, attitude=None), tmp_path / "a")
    assert sorted(p.name for p in (root / "mav0").iterdir()) == [
        "body.yaml",
        "cam0",
        "state_groundtruth_estimate0",
    ]
    flight = load_flight(root)
    assert flight.imu is None
    assert flight.attitude is None
    assert flight.truth is not None


def test_an_interrupted_flight_leaves_nothing(tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_flight(config(), tmp_path / "a" / "b", stop)
    assert list((tmp_path / "a").iterdir()) == []


def test_a_folder_with_something_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="there already"):
        simulate_flight(config(), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


# --- configuration ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sed = 1", ["unknown setting sed", "did you mean seed"]),
        ("[scene]\nwidht_m = 2", ["unknown setting scene.widht_m", "did you mean width_m"]),
        ("[imu]\nrate_hz = 10", ["imu.rate_hz = 10", "greater than or equal to 25"]),
        ("[scene]\nwidth_m = nan", ["scene.width_m = nan"]),
        ("[motion]\nroute = [2]", ["route leads into corridor 2, the scene has 1"]),
        ("[motion]\nlateral_amplitude_m = 1.0", ["touch a wall"]),
        ("[camera]\ndistortion = 'radtan'", ["takes 4 or 5 or 8 coefficients, not 0"]),
        ("[[scene.junctions]]\nat_m = 5\nangle_rad = 0.1", ["angle_rad = 0.1"]),
        ("[[scene.junctions]]\nat_m = 50", ["at_m = 50", "beyond the end"]),
        ("[scene", ["is not TOML"]),
    ],
)
def test_a_wrong_setting_is_named(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        SimulationConfig.from_toml(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_a_toml_file_sets_what_it_names(tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(
        "seed = 9\n[scene]\nwidth_m = 3.0\n[[scene.junctions]]\nat_m = 10\nangle_rad = 1.0\n"
        "[motion]\nroute = [2]\n[camera]\nwidth_px = 100\n"
    )
    loaded = SimulationConfig.from_toml(path)
    assert (loaded.seed, loaded.scene.width_m, loaded.motion.route, loaded.camera.width_px) == (
        9,
        3.0,
        (2,),
        100,
    )
    assert loaded.camera.height_px == SimulationConfig().camera.height_px
    assert loaded.scene.junctions[0].angle_rad == 1.0


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.toml: cannot be read"):
        SimulationConfig.from_toml(tmp_path / "nowhere.toml")


@pytest.mark.parametrize("fov_deg", [60.0, 160.0])
@pytest.mark.parametrize("distortion", ["none", "radtan", "equidistant"])
def test_the_field_of_view_is_the_one_asked_for(distortion: str, fov_deg: float) -> None:
    coefficients = {"none": (), "radtan": (0.0, 0.0, 0.0, 0.0), "equidistant": (0.02, 0.01, 0.0, 0.0)}[
        distortion
    ]
    values = {"distortion": distortion, "coefficients": coefficients, "horizontal_fov_rad": radians(fov_deg)}
    camera = SimulationConfig.from_values({"camera": values}).camera.camera()
    middle = (camera.height_px - 1) / 2
    left, right = camera.rays([[-0.5, middle], [camera.width_px - 0.5, middle]])
    assert degrees(np.arccos(left @ right)) == pytest.approx(fov_deg, abs=1e-6)
    assert camera.cx_px == (camera.width_px - 1) / 2


@given(st.integers(0, 2**31))
@settings(max_examples=50, deadline=None)
def test_random_corridors_are_valid(seed: int) -> None:
    scene = SceneConfig.random(seed, width_m=2.0)
    assert scene.width_m == 2.0
    assert scene == SceneConfig.random(seed, width_m=2.0)
    flight = SimulationConfig.random(seed, body_frame="frd")
    assert (flight.seed, flight.body_frame) == (seed, "frd")
    assert flight.scene == SceneConfig.random(seed)


def test_a_range_sensor_measures_along_the_bodys_z() -> None:
    trajectory = flight_of(SceneConfig(length_m=60), duration_s=10.0, tilt_rad=0.3)
    place = np.array([0.1, -0.05, 0.02])
    exact = read_range(trajectory, RangeConfig(rate_hz=50, noise_std_m=0.0), place, 1)
    truth = trajectory.truth(exact.t_s)
    for k in range(0, len(exact.t_s), 25):
        end = truth.p_world_m[k] + truth.R_world_body[k] @ (place + np.array([0.0, 0.0, exact.distance_m[k]]))
        assert abs(end[2]) < 1e-9  # on the floor
    noisy = read_range(trajectory, RangeConfig(rate_hz=50, noise_std_m=0.02), place, 1)
    assert np.std(noisy.distance_m - exact.distance_m) == pytest.approx(0.02, rel=0.15)


def test_a_flight_has_a_range_sensor_only_where_it_is_asked_for(tmp_path: Path) -> None:
    plain = files(simulate_flight(config(), tmp_path / "plain"))
    ranged = files(simulate_flight(config(range={"rate_hz": 40}), tmp_path / "ranged"))
    assert {name for name in ranged if name not in plain} == {
        "mav0/range0/data.csv",
        "mav0/range0/sensor.yaml",
    }
    assert all(ranged[name] == data for name, data in plain.items())
    flight = load_flight(tmp_path / "ranged")
    assert flight.range is not None
    assert len(flight.range.t_ns) == 21
    assert np.abs(flight.range.distance_m - 1.4).max() < 0.2
    assert load_flight(tmp_path / "plain").range is None
