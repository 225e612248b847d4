"""Whole flights with clock, focal length and mounting spoilt by known amounts; and the command as a user meets it."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from math import isinf, isnan, radians
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion import FusionResult, fuse_flight, load_flight
from fusion.alignment import Quantity, align_flight, apply_alignment, clock_of_frames
from fusion.alignment.mount import mount_rotation
from fusion.alignment.sentences import Known
from fusion.alignment.views import scaled_focal
from fusion.estimator.tilt import COMPLEMENTARY_STD_RAD
from fusion.flight import AttitudeStream, Flight, FrameStream, VectorStream
from fusion.logs.asl import read_ground_truth
from fusion.logs.manifest.file import read_manifest
from fusion.simulate import SimulationConfig, simulate_flight
from tests.command import Corridor
from tests.files import OFFICE
from vision import Camera, InputError


def spoilt(
    flight: Flight,
    offset_s: float = 0.0,
    focal: float = 1.0,
    mount_deg: tuple[float, float, float] = (0, 0, 0),
) -> Flight:
    """Return a flight that an alignment has to correct by just these: roll, pitch, yaw in degrees."""
    camera = scaled_focal(flight.camera, 1.0 / focal)
    R = mount_rotation(np.radians(mount_deg)).T @ camera.R_body_camera
    frames = replace(flight.frames, t_ns=flight.frames.t_ns - round(offset_s * 1e9))
    return replace(flight, frames=frames, camera=replace(camera, R_body_camera=R))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another corridor, a wide lens with distortion, stamps 40 ms late."""
    config = SimulationConfig.model_validate(
        {
            "seed": 9,
            "light_cell_m": 0.5,
            "motion": {"duration_s": 8.0},
            "camera": {
                "width_px": 256,
                "height_px": 192,
                "rate_hz": 12.0,
                "horizontal_fov_rad": 1.7,
                "distortion": "equidistant",
                "coefficients": (0.01, -0.005, 0.002, -0.001),
                "time_offset_s": 0.04,
            },
        }
    )
    return simulate_flight(config, tmp_path_factory.mktemp("simulated") / "wide")


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight without turns."""
    config = SimulationConfig.model_validate(
        {
            "seed": 5,
            "light_cell_m": 0.5,
            "motion": {"duration_s": 5.0, "heading_amplitude_rad": 0.0, "lateral_amplitude_m": 0.0},
            "camera": {"width_px": 240, "height_px": 180, "rate_hz": 12.0},
        }
    )
    return simulate_flight(config, tmp_path_factory.mktemp("straight") / "straight")


@pytest.fixture(scope="module")
def fused(office: Flight) -> FusionResult:
    """The sample flight, fused as it is."""
    return fuse_flight(office)


def within(quantity: Quantity, value: float, limit: float, sigmas: float = 4.0) -> None:
    """The quantity is this value, to the limit and to its own sigma."""
    assert abs(quantity.value - value) < limit, quantity
    assert abs(quantity.value - value) < sigmas * quantity.sigma, quantity


@pytest.mark.parametrize(
    ("offset_s", "focal", "yaw_deg"),
    [(-1.9, 0.95, 0.0), (-0.4, 1.05, 0.0), (0.013, 1.0, -3.0), (1.7, 1.0, 3.0)],
)
def test_what_was_spoilt_is_found(office: Flight, offset_s: float, focal: float, yaw_deg: float) -> None:
    found = align_flight(spoilt(office, offset_s, focal, (0.0, 0.0, yaw_deg)))
    within(found.clock_offset, offset_s, 0.005)
    assert found.clock_offset.sigma < 0.003
    assert found.clock_offset.changes
    within(found.focal_scale, focal, 0.01)
    assert found.focal_scale.changes == (focal != 1.0)
    within(found.mount_yaw, radians(yaw_deg), radians(1.5), sigmas=3.0)
    assert found.mount_yaw.changes == (yaw_deg != 0.0)
    assert found.camera.fx_px == pytest.approx(office.camera.fx_px, rel=0.01)
    assert all(quantity.sentence.endswith(".") for quantity in found.quantities)


def test_a_flight_that_fits_is_left_alone(office: Flight) -> None:
    found = align_flight(office)
    assert not any(quantity.changes for quantity in found.quantities)
    assert found.camera.fx_px == office.camera.fx_px
    np.testing.assert_array_equal(found.camera.R_body_camera, office.camera.R_body_camera)


def test_a_camera_that_nothing_is_known_of(office: Flight) -> None:
    unknown = replace(office, camera=Camera.from_fov(640, 480, radians(110)))
    found = align_flight(unknown, camera_known=False)
    assert found.camera.fx_px == pytest.approx(466.0, rel=0.01)
    assert abs(found.camera.fx_px - 466.0) < 3.0 * found.focal_scale.sigma / found.focal_scale.value * 466.0
    assert found.camera.cx_px == 319.5
    assert "px" in found.focal_scale.sentence


def test_large_errors_of_everything_at_once(office: Flight) -> None:
    found = align_flight(spoilt(office, -1.2, 1.4, (4.0, -10.0, 5.0)))
    within(found.clock_offset, -1.2, 0.005)
    within(found.focal_scale, 1.4, 0.014)
    for quantity, angle_deg in (
        (found.mount_yaw, 5.0),
        (found.mount_pitch, -10.0),
        (found.mount_roll, 4.0),
    ):
        within(quantity, radians(angle_deg), radians(1.5), sigmas=3.0)


def test_another_camera_and_corridor(simulated: Path) -> None:
    flight = load_flight(simulated)
    found = align_flight(spoilt(flight, 0.7, 0.95, (0.0, 0.0, 3.0)))
    within(found.clock_offset, 0.66, 0.01)  # its stamps are 40 ms late already
    within(found.focal_scale, 0.95, 0.015)
    within(found.mount_yaw, radians(3.0), radians(1.5))


def test_without_a_gyroscope_the_attitude_serves(office: Flight) -> None:
    assert office.attitude is not None
    keep = slice(0, 400)  # 8 s, into the magnetic disturbance, which turns the yaw but not the vehicle
    attitude = AttitudeStream(office.attitude.t_ns[keep], office.attitude.q_world_body[keep])
    flight = replace(office, imu=None, attitude=attitude)
    found = align_flight(spoilt(flight, 0.3))
    within(found.clock_offset, 0.3, 0.02)
    assert "attitude" in found.clock_offset.sentence


def test_without_an_attitude_roll_and_pitch_are_as_uncertain_as_the_level(office: Flight) -> None:
    alignment = align_flight(replace(office, attitude=None))
    for quantity in (alignment.mount_roll, alignment.mount_pitch):
        assert quantity.sigma > COMPLEMENTARY_STD_RAD
        assert abs(quantity.value) < 2.0 * quantity.sigma  # the calibration is right
        assert not quantity.changes


def test_a_straight_flight_does_not_tell(straight: Path) -> None:
    found = align_flight(load_flight(straight))
    assert not found.clock_offset.usable
    assert isnan(found.clock_offset.value)
    assert isinf(found.clock_offset.sigma)
    assert not found.focal_scale.usable
    assert "turn" in found.clock_offset.sentence
    assert not found.clock_offset.changes


def test_frames_that_do_not_decode_are_counted(office: Flight) -> None:
    class Torn:
        def read(self, index: int) -> np.ndarray:
            if index % 10 == 3:
                raise InputError("picture does not decode")
            return office.frames.read(index)

    found = align_flight(replace(office, frames=FrameStream(office.frames.t_ns[:100], Torn())))
    assert abs(found.clock_offset.value) < 0.01
    assert found.n_frames == 90
    assert any("10 of 100" in note for note in found.notes)


def test_a_long_flight_is_looked_at_where_it_turns(office: Flight) -> None:
    found = align_flight(spoilt(office, -0.4), max_frames=150)
    assert found.n_frames == 150
    within(found.clock_offset, -0.4, 0.01)
    assert any("150 of 300" in note for note in found.notes)


def test_nothing_inertial_is_refused(office: Flight) -> None:
    with pytest.raises(InputError, match="neither gyroscope nor attitude"):
        align_flight(replace(office, imu=None, attitude=None))


@pytest.mark.parametrize("offset_s", [0.0, -1.0, float("nan"), 100.0])
def test_a_reach_that_is_none_is_refused(office: Flight, offset_s: float) -> None:
    with pytest.raises(InputError, match="max_offset_s"):
        align_flight(office, max_offset_s=offset_s)


class TestCommand:
    """``corridor align``."""

    @pytest.fixture
    def late(self, tmp_path: Path) -> Path:
        """Office with its frames' stamps 1.7 s too small."""
        folder = Path(shutil.copytree(OFFICE, tmp_path / "late"))
        table = folder / "mav0/cam0/data.csv"
        head, *rows = table.read_text().splitlines()
        shifted = [f"{int(row.split(',')[0]) - 1_700_000_000},{row.split(',')[1]}" for row in rows]
        table.write_text("\n".join([head, *shifted, ""]))
        return folder

    def test_writing_brings_the_errors_back(
        self, late: Path, fused: FusionResult, corridor: Corridor
    ) -> None:
        before = sorted(os.listdir(late))
        told = corridor("align", late)
        assert told.code == 0
        assert "1699" in told.out or "1700" in told.out
        assert "nothing written" in told.err
        assert sorted(os.listdir(late)) == before
        out = late.parent / "aligned.toml"
        assert corridor("align", late, "-o", out).code == 0
        assert sorted(os.listdir(late)) == before
        manifest = read_manifest(out)
        assert manifest.camera.clock_offset_s == pytest.approx(1.7, abs=0.005)
        assert manifest.camera.focal_scale == 1.0
        assert manifest.camera.mount_yaw_rad == 0.0
        mended = fuse_flight(load_flight(out))
        for which in ("filter", "smoothed"):
            a, b = (result.summary["errors"][which]["heading"]["rmse_rad"] for result in (fused, mended))
            assert b < 1.1 * a, (which, a, b)
        assert np.mean(mended.frames["accepted"]) > 0.98

    def test_written_into_the_flight_and_found_to_fit_then(self, late: Path, corridor: Corridor) -> None:
        assert corridor("align", late, "--write").code == 0
        assert (late / "flight.toml").exists()
        told = corridor("align", late)  # with the manifest in force
        assert told.code == 0
        assert "no time offset between camera" in told.out
        assert read_manifest(late / "flight.toml").camera.clock_offset_s == pytest.approx(1.7, abs=0.005)

    def test_the_former_manifest_is_kept(self, late: Path, corridor: Corridor) -> None:
        place = late / "flight.toml"
        former = '# by hand\nlog = "."\n[velocity]\nuse = true\n'
        place.write_text(former)
        told = corridor("align", late, "--write")
        assert f"kept the former flight.toml as {place}.bak" in told.err
        assert Path(f"{place}.bak").read_text() == former
        assert "use = true" in place.read_text()
        again = corridor("align", late, "--write")
        assert f"{place}.bak is still the first flight.toml" in again.err
        assert Path(f"{place}.bak").read_text() == former

    def test_without_calibration_one_is_written(self, late: Path, tmp_path: Path, corridor: Corridor) -> None:
        (late / "mav0/cam0/sensor.yaml").unlink()
        out = tmp_path / "found.toml"
        assert corridor("align", late, "-o", out).code == 0
        flight = load_flight(out)
        assert flight.camera.fx_px == pytest.approx(466.0, rel=0.01)
        assert abs(float(flight.camera.R_body_camera[0, 2])) > 0.999  # straight ahead
        assert read_manifest(out).camera.focal_scale == 1.0
        assert "sensor_type: camera" in (tmp_path / "found_camera.yaml").read_text()

    def test_a_straight_flight_is_refused(self, straight: Path, tmp_path: Path, corridor: Corridor) -> None:
        before = sorted(os.listdir(straight))
        told = corridor("align", straight, "--write")
        assert told.code == 2
        assert told.out == ""
        lines = [line for line in told.err.splitlines() if "compiling" not in line]
        assert len(lines) == 1
        assert "turn" in lines[0]
        assert sorted(os.listdir(straight)) == before

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("--write", "-o", "x.toml"), "two places"),
            (("-o", "x.txt"), "not named like a manifest"),
            (("-o", "nowhere/x.toml"), "no such folder"),
            (("--max-offset", "0"), "max_offset_s"),
        ],
        ids=str,
    )
    def test_bad_options_are_one_line(
        self, arguments: tuple[str, ...], words: str, corridor: Corridor
    ) -> None:
        told = corridor("align", OFFICE, *arguments)
        assert told.code == 2
        assert words in told.err
        assert told.out == ""

    def test_another_toml_is_not_written_over(self, tmp_path: Path, corridor: Corridor) -> None:
        config = tmp_path / "config.toml"
        config.write_text("gyro_gap_s = 0.2\n")
        told = corridor("align", OFFICE, "-o", config)
        assert told.code == 2
        assert "is not a manifest" in told.err
        assert config.read_text() == "gyro_gap_s = 0.2\n"

    def test_a_flight_that_is_not_there(self, corridor: Corridor) -> None:
        told = corridor("align", "nowhere", "--write")
        assert told.code == 2
        assert "no such file" in told.err


def test_the_clock_by_headings_that_were_measured_already(office: Flight, fused: FusionResult) -> None:
    late = spoilt(office, 0.06)
    for offset_s, bad, frames in ((0.0, office, fused.frames), (0.06, late, fuse_flight(late).frames)):
        found = clock_of_frames(bad, frames["timestamp_ns"], frames["heading_rad"], frames["heading_std_rad"])
        within(found, offset_s, 0.005)
        assert found.changes == (offset_s != 0.0)


def test_velocity_helps_with_the_mounting_yaw(office: Flight) -> None:
    truth = read_ground_truth(OFFICE)
    body = Rotation.from_quat(np.roll(truth.q_world_body, -1, axis=1)).inv().apply(truth.v_world_m_s)
    moving = replace(office, velocity=VectorStream(truth.t_ns[::10], body[::10]))
    helped = align_flight(spoilt(moving, 0.2, 1.0, (0, 0, 4.0)))
    assert helped.mount_yaw.sigma < radians(0.55)  # 0.61 degrees without
    within(helped.mount_yaw, radians(4.0), radians(1.0))
    assert "velocity" in helped.mount_yaw.sentence


def test_corrections_are_applied_to_a_flight(office: Flight) -> None:
    first = replace(office, frames=FrameStream(office.frames.t_ns[:150], office.frames.source))
    bad = spoilt(first, 0.9, 0.9)
    mended = apply_alignment(bad, align_flight(bad))
    assert abs(mended.frames.t_ns[0] - office.frames.t_ns[0]) < 5_000_000
    assert mended.camera.fx_px == pytest.approx(office.camera.fx_px, rel=0.02)


def test_the_words_are_of_what_the_flight_has() -> None:
    """No attitude stream, no calibration: neither is spoken of."""
    flight = load_flight(OFFICE)
    assert Known.of(replace(flight, attitude=None), False) == ("gyroscope and accelerometer", "assumed")
    assumed = replace(flight, camera=replace(flight.camera, mount_assumed=True))
    assert Known.of(assumed, True).mounted == "assumed"
    assert Known.of(flight, True) == ("the flight's attitude", "calibrated")
