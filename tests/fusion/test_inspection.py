"""What a log holds: from arrays with known answers, a log made up for it, and files as people have them."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.cli import app as cli
from fusion.flight import AttitudeStream, FrameStream, ImuStream, RangeStream, VectorStream
from fusion.inspection.advice import Matter
from fusion.inspection.imu import inspect_imu
from fusion.inspection.log import Inspection, inspect_log
from fusion.inspection.sources import inspect_path
from fusion.inspection.text import inspection_text, inspection_values
from fusion.inspection.times import share_covered, time_stream
from fusion.logs import load_flight
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.samples import WithProblems
from fusion.result.summary_json import summary_json
from tests.files import HALLWAY, OFFICE, SHARED
from tests.pictures import read_grey
from vision import Camera, InputError

T0 = 1_600_000_000_000_000_000
SECOND = 10**9


def texts(found: Inspection, matter: Matter) -> list[str]:
    return [sentence.text for sentence in found.advice if sentence.matter is matter]


def test_the_star_is_explained_where_every_stream_has_one() -> None:
    lines = inspection_text(inspect_path(OFFICE)).splitlines()
    assert [line for line in lines if line.startswith("* ")]
    assert "(* would be fused)" in lines


def test_a_gyroscope_alone_is_said_to_be_that(tmp_path: Path) -> None:
    rows = "".join(f"{T0 + k * 5_000_000},0.1,0,{0.01 * (k % 5)}\n" for k in range(100))
    (tmp_path / "imu.csv").write_text("timestamp_ns,gx,gy,gz\n" + rows)
    better = " ".join(texts(inspect_path(tmp_path / "imu.csv"), Matter.BETTER))
    assert "neither accelerometer nor attitude: roll and pitch come from the gyroscope alone" in better
    assert "accelerometer and attitude" not in better
    assert "attitude alone" not in better


# --- times --------------------------------------------------------------------------------------------------------


@settings(max_examples=100)
@given(
    start_ns=st.integers(-(10**18), 2 * 10**18),
    step_ns=st.integers(10**6, 2 * 10**8),
    count=st.integers(30, 300),
    data=st.data(),
)
def test_rate_gaps_and_repeats_are_what_was_put_in(
    start_ns: int, step_ns: int, count: int, data: st.DataObject
) -> None:
    lost = data.draw(st.integers(3, 12))
    place = data.draw(st.integers(5, count - lost - 5)) if count > lost + 10 else None
    t_ns = start_ns + step_ns * np.arange(count, dtype=np.int64)
    if place is not None:
        t_ns = np.delete(t_ns, np.arange(place, place + lost))
    again = data.draw(st.integers(0, 3))
    shuffled = data.draw(st.permutations(range(4)))
    t_ns = np.concatenate([t_ns, t_ns[[shuffled[i] for i in range(again)]]])
    found = time_stream(t_ns)
    assert found.samples == len(t_ns)
    assert (found.first_ns, found.last_ns) == (start_ns, start_ns + step_ns * (count - 1))
    assert found.rate_hz == pytest.approx(1e9 / step_ns)
    assert found.jitter_s == 0.0
    assert found.repeated == again
    if place is None:
        assert found.gap_count == 0
    else:
        assert found.gap_count == 1
        assert found.gaps[0].after_ns == start_ns + step_ns * (place - 1)
        assert found.gaps[0].length_s == pytest.approx((lost + 1) * step_ns * 1e-9)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_streams_of_hardly_any_samples(count: int) -> None:
    found = time_stream(np.arange(count, dtype=np.int64) * SECOND)
    assert found.samples == count
    assert found.rate_hz == (1.0 if count == 2 else None)
    assert time_stream(np.zeros(5, np.int64)).repeated == 4


def test_jitter_is_of_the_steps() -> None:
    rng = np.random.default_rng(1)
    t_ns = T0 + 10**7 * np.arange(20_000) + rng.normal(0.0, 1e5, 20_000).astype(np.int64)
    found = time_stream(t_ns)
    assert found.rate_hz == pytest.approx(100.0, rel=0.01)
    assert found.jitter_s == pytest.approx(
        1.96 * np.sqrt(2.0) * 1e-4, rel=0.05
    )  # a step is a difference of two


def test_a_clock_that_is_set_is_a_jump_and_no_gap() -> None:
    t_ns = T0 + 10**7 * np.arange(1000)
    t_ns[400:] += 3600 * SECOND
    t_ns[700:] -= 7200 * SECOND
    found = time_stream(t_ns)
    assert found.jump_count == 2
    assert [round(jump.length_s) for jump in found.jumps] == [3600, -7200]
    assert found.jumps[0].after_ns == t_ns[399]
    assert found.gap_count == 0
    assert found.backwards == 1


def test_the_share_of_frames_that_a_stream_covers() -> None:
    frames = np.arange(10, dtype=np.int64)
    assert share_covered(frames, np.array([2, 7])) == 0.6
    assert share_covered(frames, np.array([], np.int64)) == 0.0
    assert share_covered(frames, np.array([20, 30])) == 0.0


# --- IMU ----------------------------------------------------------------------------------------------------------

RATE_HZ, GYRO_NOISE, ACCEL_NOISE = 200.0, 0.003, 0.02
BIAS = np.array([0.011, -0.02, 0.004])


def imu_at_rest_then_flying(seed: int = 3, gyro_noise: float = GYRO_NOISE) -> ImuStream:
    """20 s at rest, 20 s weaving, 10 s at rest."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(50 * RATE_HZ)) / RATE_HZ
    flying = ((t >= 20.0) & (t < 40.0))[:, None]
    turning = flying * np.stack([0.2 * np.sin(7 * t), 0.1 * np.cos(5 * t), 0.8 * np.sin(1.3 * t)], axis=1)
    shaking = flying * rng.normal(0.0, 2.0, (len(t), 3))
    gyro = BIAS + turning + rng.normal(0.0, gyro_noise * np.sqrt(RATE_HZ), (len(t), 3))
    accel = (
        np.array([0.1, -0.1, -9.8]) + shaking + rng.normal(0.0, ACCEL_NOISE * np.sqrt(RATE_HZ), (len(t), 3))
    )
    return ImuStream(T0 + (t * 1e9).astype(np.int64), gyro, accel)


def test_noise_and_bias_are_measured_while_it_stands() -> None:
    found = inspect_imu(imu_at_rest_then_flying())
    assert found is not None
    assert [(round((p.start_ns - T0) * 1e-9), round((p.end_ns - T0) * 1e-9)) for p in found.still] == [
        (0, 20),
        (40, 50),
    ]
    assert found.still_total_s == pytest.approx(30.0, abs=0.1)
    assert found.at_rest is not None
    assert found.at_rest.gyro == pytest.approx(GYRO_NOISE, rel=0.15)
    assert found.at_rest.accel == pytest.approx(ACCEL_NOISE, rel=0.15)
    assert found.gyro_bias_rad_s is not None
    np.testing.assert_allclose(found.gyro_bias_rad_s, BIAS, atol=0.002)
    assert found.gravity_m_s2 == pytest.approx(9.801, abs=0.005)
    assert found.in_flight.gyro is not None
    assert found.in_flight.gyro > 0.9 * GYRO_NOISE
    assert found.fastest_rad_s == pytest.approx(0.83, abs=0.05)


@settings(max_examples=15, deadline=None)
@given(noise=st.floats(1e-5, 0.01))
def test_white_noise_of_any_size_is_measured(noise: float) -> None:
    found = inspect_imu(imu_at_rest_then_flying(gyro_noise=noise))
    assert found is not None
    assert found.at_rest is not None
    assert found.at_rest.gyro == pytest.approx(noise, rel=0.15)


def test_an_imu_in_flight_is_never_still_and_its_noise_is_bounded() -> None:
    flight = load_flight(OFFICE)
    assert flight.imu is not None
    found = inspect_imu(flight.imu)
    assert found is not None
    assert found.still == ()
    assert found.at_rest is None
    assert found.in_flight.gyro == pytest.approx(0.005, rel=0.5)
    assert found.in_flight.gyro is not None
    assert found.in_flight.gyro > 0.0045  # a bound: what it was simulated with is less
    assert found.declared_gyro_noise == 0.005


def test_an_imu_without_accelerometer_or_with_few_samples() -> None:
    good = imu_at_rest_then_flying()
    found = inspect_imu(replace(good, accel_m_s2=np.full_like(good.accel_m_s2, np.nan)))
    assert found is not None
    assert found.usual_accel_m_s2 is None
    assert found.gravity_m_s2 is None
    assert found.still_total_s == pytest.approx(30.0, abs=1.0)
    assert inspect_imu(ImuStream(good.t_ns[:5], good.gyro_rad_s[:5], good.accel_m_s2[:5])) is None


def test_a_slow_imu_is_not_judged_still() -> None:
    good = imu_at_rest_then_flying()
    found = inspect_imu(ImuStream(good.t_ns[::40], good.gyro_rad_s[::40], good.accel_m_s2[::40]))
    assert found is not None
    assert found.still == ()


# --- a log made up for it -----------------------------------------------------------------------------------------


class Pictures:
    """Grey pictures of one value each; some do not decode, and reading is counted."""

    def __init__(self, broken: set[int], sizes: dict[int, tuple[int, int]]) -> None:
        self.broken, self.sizes, self.reads = broken, sizes, 0

    def read(self, index: int) -> npt.NDArray[np.uint8]:
        self.reads += 1
        if index in self.broken:
            raise InputError("picture does not decode")
        width, height = self.sizes.get(index, (64, 48))
        return np.full((height, width), 40 + index % 100, np.uint8)


@dataclass
class MadeUp(LogContents):
    """A log in memory, as `LogContents`; a topic in ``torn`` cannot be read."""

    imus: dict[str, ImuStream] = field(default_factory=dict)
    attitudes: dict[str, AttitudeStream] = field(default_factory=dict)
    velocities: dict[str, VectorStream] = field(default_factory=dict)
    cameras: dict[str, npt.NDArray[np.int64]] = field(default_factory=dict)
    calibration: Camera | None = field(default_factory=lambda: Camera.from_fov(64, 48, 1.2))
    broken: set[int] = field(default_factory=set)
    sizes: dict[int, tuple[int, int]] = field(default_factory=dict)
    torn: set[str] = field(default_factory=set)
    problems: tuple[str, ...] = ()
    path: Path = Path("made_up.log")
    format: str = "made-up log"

    def __post_init__(self) -> None:
        self.pictures = Pictures(self.broken, self.sizes)
        streams: dict[Kind, dict[str, Any]] = {
            Kind.IMU: self.imus,
            Kind.ATTITUDE: self.attitudes,
            Kind.VELOCITY: self.velocities,
        }
        made = [Topic(name, kind, s.t_ns) for kind, found in streams.items() for name, s in found.items()]
        self.topics = (*made, *(Topic(name, Kind.FRAMES, t_ns) for name, t_ns in self.cameras.items()))

    def _whole(self, topic: str) -> None:
        if topic in self.torn:
            raise InputError(f"{topic} is torn", file=self.path, remedy="copy it again")

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        self._whole(topic)
        return WithProblems(FrameStream(self.cameras[topic], self.pictures))

    def camera(self, topic: str) -> Camera | None:
        return self.calibration

    def imu(self, topic: str) -> WithProblems[ImuStream]:
        self._whole(topic)
        return WithProblems(self.imus[topic], (f"{topic}: 1 row of NaN dropped",))

    def attitude(self, topic: str) -> WithProblems[AttitudeStream]:
        self._whole(topic)
        return WithProblems(self.attitudes[topic])

    def velocity(self, topic: str) -> WithProblems[VectorStream]:
        self._whole(topic)
        return WithProblems(self.velocities[topic])

    def position(self, topic: str) -> WithProblems[VectorStream]:
        raise NotImplementedError

    def range(self, topic: str) -> WithProblems[RangeStream]:
        raise NotImplementedError


FRAMES = T0 + 5 * 10**7 * np.arange(900, dtype=np.int64)
IMU = imu_at_rest_then_flying()


def test_a_log_is_described_without_reading_its_pictures() -> None:
    log = MadeUp(imus={"imu0": IMU}, cameras={"cam0": FRAMES}, broken={0, 899}, sizes={674: (32, 24)})
    found = inspect_log(log)
    assert log.pictures.reads <= 16  # of 900; half of them to check the lens
    camera, imu = found.streams
    assert (camera.kind, imu.kind) == (Kind.FRAMES, Kind.IMU)
    assert camera.pictures is not None
    assert camera.pictures.first_index == 1
    assert camera.pictures.unreadable == 2
    assert camera.pictures.sizes == ((64, 48), (32, 24))
    assert (camera.pictures.brightness, camera.pictures.contrast) == (41.0, 0.0)
    assert found.first_picture is not None
    assert found.first_picture.shape == (48, 64)
    assert imu.frames_covered == 1.0
    assert imu.problems == ("imu0: 1 row of NaN dropped",)
    text = inspection_text(found)
    assert (
        "pictures of 64x48 and 32x24 pixels (6 of 900 read, 2 of which do not decode); number 2, the first that"
        in text
    )
    assert re.search(
        r"at rest for 30.0 s: 0.00 s to 20.00 s, 40.00 s to (50.00|49.99) s", " ".join(text.split())
    )
    assert texts(found, Matter.MISSING) == []
    assert texts(found, Matter.BETTER)[0] == "pictures of 32x24 are left out: the calibration is for 64x48"


@pytest.mark.parametrize(
    ("log", "matter", "match"),
    [
        (
            MadeUp(imus={"imu0": IMU}),
            Matter.FUSE,
            r"nothing yet: a heading in a corridor needs pictures; it has gyroscope and accelerometer \(imu0, 200",
        ),
        (
            MadeUp(imus={"imu0": IMU}),
            Matter.MISSING,
            r"pictures: corridor fuse x.log --video VIDEO --camera CAM.yaml, or \[camera\] file in a flight.toml",
        ),
        (MadeUp(), Matter.FUSE, "nothing yet: a heading in a corridor needs pictures$"),
        (
            MadeUp(imus={"imu0": IMU}, cameras={"cam0": FRAMES}),
            Matter.FUSE,
            r"corridor fuse x.log uses pictures \(cam0, 20 Hz\) and gyroscope and accelerometer \(imu0, 200 Hz\)",
        ),
        (
            MadeUp(cameras={"cam0": FRAMES}, calibration=None),
            Matter.MISSING,
            "the camera's calibration: --camera CAM.yaml .EuRoC, Kalibr, ROS camera_info or OpenCV.",
        ),
        (
            MadeUp(imus={"imu0": IMU}, cameras={"cam0": FRAMES}, calibration=None),
            Matter.MISSING,
            "where there is none, `corridor align x.log --write` finds the focal length$",
        ),
        (
            MadeUp(cameras={"left": FRAMES, "right": FRAMES}),
            Matter.MISSING,
            r'holds 2 cameras: left, right: choose one in a flight.toml: .*\[camera\] topic = "left"',
        ),
        (
            MadeUp(cameras={"cam0": FRAMES}, broken=set(range(900))),
            Matter.FUSE,
            "nothing yet: a heading in a corridor needs pictures",
        ),
        (
            MadeUp(cameras={"cam0": FRAMES}),
            Matter.BETTER,
            "no gyroscope: only a constant-rate model propagates the heading",
        ),
        (
            MadeUp(cameras={"cam0": FRAMES}, imus={"imu0": IMU}),
            Matter.BETTER,
            r"noise is not declared, so a default is used; at rest it is 0.0031 rad/s/sqrt\(Hz\)",
        ),
        (
            MadeUp(cameras={"cam0": FRAMES}, imus={"imu0": replace(IMU, gyro_noise_density=1e-4)}),
            Matter.BETTER,
            r"the gyroscope is declared with 0.0001 rad/s/sqrt\(Hz\) but has 0.0031 at rest: correct the declaration",
        ),
        (
            MadeUp(cameras={"cam0": FRAMES}, imus={"imu0": replace(IMU, t_ns=IMU.t_ns - T0)}),
            Matter.MISSING,
            r"imu: it runs from 0.0 to 50.0 s, the frames from 2020-09-13 .*add -1600000000.000 to .camera. clock",
        ),
        (
            MadeUp(cameras={"cam0": FRAMES}, imus={"imu0": replace(IMU, accel_m_s2=-IMU.accel_m_s2)}),
            Matter.MISSING,
            r"imu: gravity reads \+9.8 along z instead of -9.8: y and z of its axes point the other way",
        ),
    ],
)
def test_what_can_be_fused_and_what_is_missing(log: MadeUp, matter: Matter, match: str) -> None:
    log.__post_init__()  # a log is shared by two cases
    said = texts(inspect_log(log, name="x.log"), matter)
    assert any(re.search(match, text) for text in said), said
    assert all("\n" not in text for text in said)


def test_a_stream_that_cannot_be_read_does_not_hide_the_others() -> None:
    log = MadeUp(
        imus={"imu0": IMU},
        cameras={"cam0": FRAMES},
        torn={"imu0"},
        problems=("the file ends in the middle of a block",),
    )
    found = inspect_log(log)
    camera, imu = found.streams
    assert camera.error is None
    assert imu.error == "made_up.log: imu0 is torn (copy it again)"
    assert imu.timing.rate_hz == pytest.approx(200.0)
    text = inspection_text(found)
    assert "  - the file ends in the middle of a block\n" in text
    assert "  - imu0 cannot be read: made_up.log: imu0 is torn (copy it again)\n" in text
    assert texts(found, Matter.FUSE)[0].startswith("corridor fuse made_up.log uses pictures (cam0, 20 Hz)")


def test_streams_on_different_clocks_are_listed_on_their_own() -> None:
    log = MadeUp(cameras={"cam0": FRAMES}, imus={"imu0": replace(IMU, t_ns=IMU.t_ns - T0)})
    text = inspection_text(inspect_log(log))
    assert "its streams are on different clocks" in text
    assert re.search(r"imu0 .* 0.00 s +49.99 s +0%|imu0 .* 0.00 s +50.00 s +0%", text)


def test_gaps_jumps_and_repeats_are_said() -> None:
    frames = FRAMES.copy()
    frames[500:] += 2 * SECOND
    frames[800:] += 3600 * SECOND
    frames[10] = frames[9]
    text = " ".join(inspection_text(inspect_log(MadeUp(cameras={"cam0": frames}))).split())
    assert "cam0: the clock jumps 1 time (+3600.1 s at 41.95 s)" in text or "+3600.0 s at" in text
    assert "cam0: 1 gap, 2.05 s in all (the longest 2.05 s at 24.95 s)" in text
    assert "cam0: 1 sample with a repeated time" in text


def test_the_values_are_json_and_say_what_the_text_says() -> None:
    found = inspect_log(MadeUp(imus={"imu0": IMU}, cameras={"cam0": FRAMES}))
    values = json.loads(summary_json(inspection_values(found)))
    assert set(values) == {"path", "format", "streams", "problems", "findings", "advice"}
    camera, imu = values["streams"]
    assert camera["timing"]["rate_hz"] == pytest.approx(20.0)
    assert camera["pictures"]["sizes"] == [[64, 48]]
    assert imu["imu"]["at_rest"]["gyro"] == pytest.approx(GYRO_NOISE, rel=0.1)
    assert values["advice"][0]["matter"] == "fuse"


# --- files --------------------------------------------------------------------------------------------------------


def test_the_sample_flight() -> None:
    text = inspection_text(inspect_path(OFFICE))
    assert "15.0 s, 2020-09-13 12:43:20 to 12:43:35 UTC" in text
    assert re.search(r"\* imu0 +imu +3001 +200 Hz +0.0 ms +- +- +0.00 s +15.00 s +100%", text)
    assert (
        "calibration for 640x480: focal length 466.0 px, field of view 69 degrees, distortion radtan, looks straight"
        in text
    )
    assert "problems" not in text
    assert max(len(line) for line in text.splitlines()) <= 110


def test_a_manifest_is_described_on_the_flights_clock(tmp_path: Path) -> None:
    manifest = tmp_path / "flight.toml"
    noise = tmp_path / "imu.yaml"
    noise.write_text("gyroscope_noise_density: 0.001\n")
    manifest.write_text(
        f'[camera]\nfile = "{OFFICE.as_posix()}"\nfocal_scale = 2.0\n'
        f'[imu]\nfile = "{OFFICE.as_posix()}"\nclock_offset_s = 3.0\nnoise = "imu.yaml"\n'
        '[attitude]\nfile = "nowhere.csv"\n'
    )
    found = inspect_path(manifest)
    camera, imu = found.streams
    assert camera.camera is not None
    assert camera.camera.fx_px == 932.0
    assert imu.frames_covered == pytest.approx(0.8)
    assert imu.timing.first_ns is not None
    assert camera.timing.first_ns is not None
    assert imu.timing.first_ns - camera.timing.first_ns == 3 * SECOND
    assert imu.note == "office; +3.000 s"
    assert imu.imu is not None
    assert imu.imu.declared_gyro_noise == 0.001
    assert any("nowhere.csv: there is no such file" in problem for problem in found.problems)
    assert any("imu: it covers 80% of the frames" in f.sentence for f in found.findings)


def test_a_range_sensor_and_what_it_gives(tmp_path: Path) -> None:
    log = tmp_path / "range.csv"
    log.write_text(
        "time_ms,range_m\n" + "".join(f"{50 * k},{1.4 + 0.01 * (k % 21):.2f}\n" for k in range(105))
    )
    found = inspect_path(log)
    assert [(stream.kind, stream.chosen) for stream in found.streams] == [(Kind.RANGE, True)]
    assert found.streams[0].distances_m == pytest.approx((1.4, 1.5, 1.6))
    text = " ".join(inspection_text(found).split())
    assert "1.40 to 1.60 m above the floor, median 1.50 m: used for offsets in metres if neither" in text
    (tmp_path / "flight.toml").write_text('log = "range.csv"\n[range]\nabove_camera_m = 0.25\n')
    lowered = inspect_path(tmp_path / "flight.toml").streams[0]
    assert lowered.distances_m == pytest.approx((1.15, 1.25, 1.35))


def test_a_chain_that_knows_the_offset_of_the_clocks_is_heard(tmp_path: Path) -> None:
    (tmp_path / "camchain.yaml").write_text(
        "cam0:\n  T_cam_imu: [[0,-1,0,0],[0,0,-1,0],[1,0,0,0],[0,0,0,1]]\n  timeshift_cam_imu: 0.25\n"
        "  resolution: [640, 480]\n  intrinsics: [466, 466, 319.5, 239.5]\n  camera_model: pinhole\n"
        "  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n"
    )
    manifest = tmp_path / "flight.toml"
    manifest.write_text(f'log = "{OFFICE.as_posix()}"\n[camera]\ncalibration = "camchain.yaml"\n')
    camera = inspect_path(manifest).streams[0]
    assert camera.note == "+0.250 s"
    assert camera.timing.first_ns == load_flight(manifest).frames.t_ns[0]


def test_a_flight_of_which_only_part_is_readable(tmp_path: Path) -> None:
    flight = tmp_path / "torn"
    shutil.copytree(OFFICE / "mav0" / "imu0", flight / "mav0" / "imu0")
    shutil.copytree(OFFICE / "mav0" / "attitude0", flight / "mav0" / "attitude0")
    (flight / "mav0" / "attitude0" / "data.csv").write_text("rubbish\nmore of it\n")
    found = inspect_path(flight)
    by_kind = {stream.kind: stream for stream in found.streams}
    assert by_kind[Kind.IMU].error is None
    assert by_kind[Kind.ATTITUDE].error is not None
    assert "attitude0 cannot be read" in inspection_text(found)


REAL = [
    *sorted((SHARED / "logs").glob("*/*.ulg")),
    *sorted((SHARED / "logs").glob("*/*.bag")),
    *sorted((SHARED / "logs").glob("*/*.BIN")),
    HALLWAY,
]


@pytest.mark.parametrize("path", REAL, ids=lambda path: path.name)
def test_real_logs_are_described(path: Path) -> None:
    if not path.exists():
        pytest.skip("the shared logs are not here")
    module = {".ulg": "pyulog", ".bag": "rosbags", ".BIN": "pymavlink"}.get(path.suffix)
    if module is not None:
        pytest.importorskip(module)
    found = inspect_path(path)
    assert any(stream.chosen for stream in found.streams)
    assert all(stream.error is None for stream in found.streams if stream.chosen)
    text = inspection_text(found)
    assert "can be fused" in text
    assert "nan" not in text.lower().split()
    json.loads(summary_json(inspection_values(found)))


# --- the command --------------------------------------------------------------------------------------------------


def corridor(*arguments: str | Path) -> int:
    with pytest.raises(SystemExit) as end:
        cli.main([str(argument) for argument in arguments])
    return end.value.code if isinstance(end.value.code, int) else 0


def test_the_command_prints_and_writes_the_first_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "first.png"
    assert corridor("inspect", OFFICE, "--picture", picture) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{OFFICE}: ASL / EuRoC folder\n15.0 s, 2020")
    assert err == f"corridor: first picture in {picture}\n"
    image = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    first = sorted((OFFICE / "mav0" / "cam0" / "data").iterdir())[0]
    np.testing.assert_array_equal(image, read_grey(first))
    assert corridor("inspect", OFFICE, "--json") == 0
    assert json.loads(capsys.readouterr().out)["format"] == "ASL / EuRoC folder"


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("nowhere.bag",), r"error: nowhere.bag: there is no such file or folder \(check the path\)"),
        ((OFFICE / "README.md",), r"error: .*README.md: "),
        (
            (OFFICE, "--picture", "first.tiff"),
            r"error: first.tiff: is not a picture name \(end it in .png or .jpg\)",
        ),
        (
            (OFFICE, "--picture", "nowhere/first.png"),
            r"error: nowhere/first.png: cannot be written \(give a file in",
        ),
    ],
)
def test_the_command_refuses_in_one_line(
    arguments: tuple[str | Path, ...], match: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert corridor("inspect", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert re.search(match, err)


def test_no_picture_to_write_is_said_after_the_description(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = tmp_path / "blind"
    shutil.copytree(OFFICE / "mav0" / "imu0", flight / "mav0" / "imu0")
    assert corridor("inspect", flight, "--picture", tmp_path / "first.png") == 2
    out, err = capsys.readouterr()
    assert "nothing yet: a heading in a corridor needs pictures" in " ".join(out.split())
    assert "there is no picture to write (leave --picture out)" in err
    assert not (tmp_path / "first.png").exists()
