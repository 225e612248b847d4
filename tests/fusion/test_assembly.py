"""Flights put together from several files: the same fused heading as from one folder, or a line that says why not."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fusion import FusionConfig, fuse_flight, load_flight
from fusion.flight import Flight
from fusion.inspection.findings import CameraFindings
from fusion.inspection.imu import inspect_imu
from fusion.inspection.sources import inspect_path
from fusion.logs import load_manifest, open_log
from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.manifest.assembly import assemble_flight
from fusion.logs.manifest.file import make_manifest, read_manifest, write_manifest
from fusion.logs.manifest.manifest import Manifest
from fusion.logs.topic_choice import RANKED_FORMATS, TABLES, choose_topic
from tests.files import OFFICE
from tests.fusion.test_log_dataflash import new_log
from vision import InputError

N_FRAMES = 60
IMU_CLOCK_S = 100.0  # the IMU's clock reads this much when the video's reads zero
G = 9.80665


@dataclass(frozen=True)
class Parts:
    """The start of the sample flight, in a folder and in files of other kinds."""

    folder: Path
    flight: Flight


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Parts:
    av = pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("parts")
    whole = load_flight(OFFICE)
    assert whole.imu is not None
    assert whole.attitude is not None
    t_ns = whole.frames.t_ns[:N_FRAMES]
    i, a = whole.imu.t_ns <= t_ns[-1], whole.attitude.t_ns <= t_ns[-1]
    flight = replace(
        whole,
        frames=whole.frames.chosen(np.arange(N_FRAMES)),
        imu=replace(
            whole.imu,
            t_ns=whole.imu.t_ns[i],
            gyro_rad_s=whole.imu.gyro_rad_s[i],
            accel_m_s2=whole.imu.accel_m_s2[i],
            gyro_noise_density=None,
            gyro_random_walk=None,
        ),
        attitude=None,
    )
    assert flight.imu is not None
    (folder / "pictures").mkdir()
    with av.open(str(folder / "hall.mp4"), "w") as file:
        stream = file.add_stream("libx264", rate=20, options={"crf": "12"})
        stream.width, stream.height, stream.pix_fmt = whole.camera.width_px, whole.camera.height_px, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 90000)
        for k in range(N_FRAMES):
            picture = whole.frames.read(k)
            if k < 8:
                cv2.imwrite(str(folder / "pictures" / f"{k}.png"), picture)
            frame = av.VideoFrame.from_ndarray(picture, format="gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = round((t_ns[k] - t_ns[0]) * 9e-5), Fraction(1, 90000)
            for packet in stream.encode(frame):
                file.mux(packet)
        for packet in stream.encode(None):
            file.mux(packet)
    ms = (flight.imu.t_ns - t_ns[0]) / 1e6 + 1000 * IMU_CLOCK_S
    values = np.column_stack([ms, np.degrees(flight.imu.gyro_rad_s), flight.imu.accel_m_s2 / G])
    values[:, [2, 3, 5, 6]] *= -1.0  # FRD to FLU
    np.savetxt(folder / "imu.csv", values, "%.6f", ";", header="t;gx;gy;gz;ax;ay;az", comments="")
    q = whole.attitude.q_world_body[a]
    ms = (whole.attitude.t_ns[a] - t_ns[0]) / 1e6 + 1000 * IMU_CLOCK_S
    header = "time_ms,qw,qx,qy,qz"
    np.savetxt(folder / "attitude.csv", np.column_stack([ms, q]), "%.9f", ",", header=header, comments="")
    (folder / "pictures" / "times.csv").write_text("".join(f"{50 * k},{k}.png\n" for k in range(8)))
    shutil.copy(OFFICE / "mav0" / "cam0" / "sensor.yaml", folder / "camera.yaml")
    (folder / "flight.toml").write_text(MANIFEST)
    return Parts(folder, flight)


MANIFEST = """
corridor_width_m = 2.2
[camera]
file = "hall.mp4"
calibration = "camera.yaml"
[imu]
file = "imu.csv"
frame = "flu"
clock_offset_s = -100.0
[imu.columns]
time = "t"
time_unit = "ms"
gyro = ["gx", "gy", "gz"]
gyro_unit = "deg/s"
accel = ["ax", "ay", "az"]
accel_unit = "g"
"""


RANGE = """
[range]
file = "tof.csv"
above_camera_m = 0.1
clock_offset_s = -100.0
[range.columns]
time = "t"
time_unit = "ms"
range = "tof"
range_unit = "cm"
"""


def manifest_of(flight: Flight) -> Manifest:
    assert isinstance(flight.manifest, Manifest)
    return flight.manifest


def test_a_folder_of_pictures_and_samples_is_told_how_to_list_them(tmp_path: Path) -> None:
    (tmp_path / "pics").mkdir()
    shutil.copy(next((OFFICE / "mav0/cam0/data").iterdir()), tmp_path / "pics")
    (tmp_path / "imu.csv").write_text(
        "timestamp_ns,gx,gy,gz\n" + "".join(f"{k}000000,0,0,0\n" for k in range(9))
    )
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    with pytest.raises(
        InputError, match=r'\[camera\] file = "pics", \[imu\] file = "imu\.csv"; `corridor fuse --help`'
    ):
        load_flight(tmp_path)


def test_distances_from_a_file_of_their_own(parts: Parts) -> None:
    lines = (f"{1000 * IMU_CLOCK_S + 50 * k:.0f},{0 if k == 3 else 140 + k}\n" for k in range(N_FRAMES))
    (parts.folder / "tof.csv").write_text("t,tof\n" + "".join(lines))
    path = parts.folder / "ranged.toml"
    path.write_text(MANIFEST + RANGE)
    flight = load_flight(path)
    assert flight.range is not None
    kept = np.delete(np.arange(N_FRAMES), 3)
    np.testing.assert_array_equal(flight.range.t_ns, kept * 50_000_000)
    np.testing.assert_allclose(flight.range.distance_m, 1.4 + 0.01 * kept - 0.1)
    assert any("(range): 1 row dropped: no distance" in text for text in flight.problems)
    assert manifest_of(flight).range.topic == "range"
    path.write_text(MANIFEST + RANGE.replace("[range]", "[range]\nuse = false"))
    assert load_flight(path).range is None
    (parts.folder / "tof.csv").write_text("t,tof\n" + "".join(f"{50 * k},0\n" for k in range(40)))
    path.write_text(MANIFEST + RANGE)
    with pytest.raises(InputError, match="every row has no distance within the sensor's reach"):
        load_flight(path)


def headings(flight: Flight) -> np.ndarray:
    return np.asarray(fuse_flight(flight, FusionConfig(corridor_width_m=2.2)).smoothed["heading_rad"])


def at(parts: Parts, text: str) -> Path:
    """Another manifest beside the parts."""
    path = parts.folder / "other.toml"
    path.write_text(text)
    return path


# ------------------------------------------------------------------------------------------- whole flights


def test_video_and_csv_on_their_own_clocks_fuse_as_the_folder_does(parts: Parts) -> None:
    flight = load_flight(parts.folder)
    assert flight.name == parts.folder.name
    assert flight.corridor_width_m == 2.2
    assert flight.problems == ()
    assert flight.imu is not None
    assert parts.flight.imu is not None
    np.testing.assert_allclose(flight.imu.gyro_rad_s, parts.flight.imu.gyro_rad_s, atol=1e-7)
    np.testing.assert_allclose(flight.imu.accel_m_s2, parts.flight.imu.accel_m_s2, atol=1e-4)
    start = int(parts.flight.frames.t_ns[0])
    np.testing.assert_allclose(flight.imu.t_ns, parts.flight.imu.t_ns - start, atol=1000)
    ours, theirs = headings(flight), headings(parts.flight)
    assert len(ours) == len(theirs)
    known = np.isfinite(theirs)
    assert (np.isfinite(ours) == known).mean() > 0.98
    error = np.degrees(ours - theirs)[known & np.isfinite(ours)]
    # The video has lost detail to compression, nothing else.
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.abs(error).max() < 0.3
    result = fuse_flight(flight)
    assert result.config.corridor_width_m == 2.2


def test_a_clock_put_wrong_shows(parts: Parts) -> None:
    """So the agreement above is no accident: half a second off, the heading is another."""
    text = MANIFEST.replace("-100.0", "-100.5")
    ours, theirs = headings(load_flight(at(parts, text))), headings(parts.flight)
    error = np.degrees(
        ours[: len(theirs)] - theirs
    )  # the frames go on when the IMU has ended: rows of theirs follow
    assert np.sqrt(np.nanmean(error**2)) > 0.2


def test_the_offset_may_stand_at_the_camera_instead(parts: Parts) -> None:
    text = MANIFEST.replace("clock_offset_s = -100.0\n", "").replace(
        "[imu]", "clock_offset_s = 100.0\n[imu]", 1
    )
    flight = load_flight(at(parts, text))
    assert flight.frames.t_ns[0] == 100_000_000_000
    assert flight.imu is not None
    assert abs(int(flight.imu.t_ns[0]) - 100_000_000_000) < 6_000_000


def test_streams_from_a_log_and_from_files(parts: Parts) -> None:
    text = f'log = "{OFFICE.as_posix()}"\n[attitude]\nuse = false\n[imu]\nnoise = "noise.yaml"\n'
    (parts.folder / "noise.yaml").write_text(
        "gyroscope_noise_density: 0.011\ngyroscope_random_walk: 0.0002\n"
    )
    flight = load_flight(at(parts, text))
    assert flight.name == "other"
    assert flight.attitude is None
    assert flight.truth is not None
    assert flight.imu is not None
    assert (flight.imu.gyro_noise_density, flight.imu.gyro_random_walk) == (0.011, 0.0002)
    # The attitude of the folder, replaced by a file whose clock needs an offset.
    start_s = float(parts.flight.frames.t_ns[0]) * 1e-9
    text = f'log = "{OFFICE.as_posix()}"\n[attitude]\nfile = "attitude.csv"\nframe = "frd"\nclock_offset_s = '
    flight = load_flight(at(parts, text + f"{start_s - IMU_CLOCK_S!r}\n"))
    whole = load_flight(OFFICE)
    assert flight.attitude is not None
    assert whole.attitude is not None
    n = len(flight.attitude.t_ns)
    np.testing.assert_allclose(flight.attitude.q_world_body, whole.attitude.q_world_body[:n], atol=1e-8)
    np.testing.assert_allclose(flight.attitude.t_ns, whole.attitude.t_ns[:n], atol=2000)


def test_a_folder_of_pictures_with_its_list(parts: Parts) -> None:
    text = MANIFEST.replace("hall.mp4", "pictures").replace("[imu]", '[imu]\ntopic = "imu"', 1)
    flight = load_flight(at(parts, text))
    assert flight.frames.t_ns.tolist() == [50_000_000 * k for k in range(8)]
    np.testing.assert_array_equal(flight.frames.read(5), parts.flight.frames.read(5))


def test_the_manifest_of_a_flight_gives_the_same_flight(parts: Parts, tmp_path: Path) -> None:
    for source in (parts.folder, OFFICE):
        flight = load_flight(source)
        write_manifest(manifest_of(flight), tmp_path / "flight.toml")
        again = load_flight(tmp_path / "flight.toml")
        np.testing.assert_array_equal(again.frames.t_ns, flight.frames.t_ns)
        assert again.imu is not None
        assert flight.imu is not None
        np.testing.assert_array_equal(again.imu.gyro_rad_s, flight.imu.gyro_rad_s)
        assert again.corridor_width_m == flight.corridor_width_m
        assert (again.attitude is None) == (flight.attitude is None)
    assert 'topic = "imu0"' in (tmp_path / "flight.toml").read_text()


def test_corrections_of_the_camera_are_applied(parts: Parts) -> None:
    text = MANIFEST.replace("[imu]", "mount_yaw_rad = 0.05\nfocal_scale = 1.02\n[imu]", 1)
    camera, plain = load_flight(at(parts, text)).camera, load_flight(parts.folder).camera
    assert camera.fx_px == pytest.approx(1.02 * plain.fx_px)
    before, after = plain.R_body_camera[:, 2], camera.R_body_camera[:, 2]
    turned = np.arctan2(after[1], after[0]) - np.arctan2(before[1], before[0])
    assert turned == pytest.approx(0.05)  # positive to the right


def test_the_time_shift_of_a_kalibr_chain_is_taken_unless_the_manifest_says(parts: Parts) -> None:
    camera = load_flight(parts.folder).camera
    (parts.folder / "camchain.yaml").write_text(
        "cam0:\n  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n"
        f"  resolution: [{camera.width_px}, {camera.height_px}]\n  intrinsics: [500, 500, 320, 240]\n"
        "  T_cam_imu: [[0,-1,0,0],[0,0,-1,0],[1,0,0,0],[0,0,0,1]]\n  timeshift_cam_imu: 0.125\n"
    )
    text = MANIFEST.replace("camera.yaml", "camchain.yaml")
    flight = load_flight(at(parts, text))
    assert flight.frames.t_ns[0] == 125_000_000
    assert manifest_of(flight).camera.clock_offset_s == 0.125
    flight = load_flight(at(parts, text.replace("[imu]", "clock_offset_s = 0.0\n[imu]", 1)))
    assert flight.frames.t_ns[0] == 0


# ------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"hall.mp4"', '"none.mp4"', r"none\.mp4: there is no such file or folder \(camera\.file\)"),
        (
            '"camera.yaml"',
            '"none.yaml"',
            r"none\.yaml: there is no such file or folder \(camera\.calibration\)",
        ),
        ('calibration = "camera.yaml"', "", r"hall\.mp4: contains no calibration of the camera \(.*--camera"),
        ("-100.0", "0.0", r"imu\.csv: covers 100\.0 to 10.* the frames 0\.0 to .*--clock-offset.* 100\.000"),
        (
            '"gx", "gy", "gz"',
            '"gx", "gy", "hz"',
            r"imu\.csv: has no column 'hz' \(columns\.gyro\) \(did you mean",
        ),
        ('[imu]\nfile = "imu.csv"', '[imu]\nfile = "hall.mp4"', r"hall\.mp4: is not a text file"),
        (
            '[imu]\nfile = "imu.csv"',
            '[imu]\ntopic = "gyro"\nfile = "imu.csv"',
            r"has no IMU data under 'gyro' \(ch",
        ),
        (
            'file = "hall.mp4"',
            'file = "hall.mp4"\ntopic = "left"',
            r"has no pictures under 'left' \(choose one of video",
        ),
        ('file = "hall.mp4"', 'file = "hall.mp4"\nframe = "frd"', r"is a video: frame does not go with it"),
        (
            'file = "hall.mp4"',
            'file = "imu.csv"\nstart_ns = 3',
            r"imu\.csv: is a log with pictures .* start_ns does not",
        ),
        (
            'file = "hall.mp4"',
            'file = "attitude.csv"',
            r"CSV without pictures; it contains attitude \(attitude\)",
        ),
    ],
)
def test_what_does_not_fit_is_named(parts: Parts, old: str, new: str, message: str) -> None:
    assert old in MANIFEST
    with pytest.raises(InputError, match=message) as caught:
        load_flight(at(parts, MANIFEST.replace(old, new, 1)))
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def test_a_named_file_must_hold_its_stream(parts: Parts) -> None:
    text = MANIFEST + '[velocity]\nfile = "attitude.csv"\n'
    with pytest.raises(
        InputError, match=r"attitude\.csv: contains no velocity; it contains attitude .*\[velocity\]"
    ):
        load_flight(at(parts, text))


def test_columns_do_not_go_with_a_log_of_its_own(parts: Parts) -> None:
    text = f'log = "{OFFICE.as_posix()}"\n[imu]\nframe = "flu"\n'
    with pytest.raises(InputError, match="columns and axes of its own: frame does not go with it"):
        load_flight(at(parts, text))


def test_a_picture_of_another_size(parts: Parts) -> None:
    (parts.folder / "small.yaml").write_text(
        "camera_model: pinhole\ndistortion_model: none\nresolution: [320, 240]\nintrinsics: [200, 200, 160, 120]\n"
        "T_BS:\n  data: [0,0,1,0, -1,0,0,0, 0,-1,0,0, 0,0,0,1]\n"
    )
    with pytest.raises(InputError, match=r"hall\.mp4: picture is \d+x\d+, the camera's 320x240"):
        load_flight(at(parts, MANIFEST.replace("camera.yaml", "small.yaml")))


def test_no_format_knows_it(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("?")
    with pytest.raises(
        InputError, match=r"a\.xyz: is not a flight of a known format \(give a flight\.toml, ASL"
    ):
        open_log(tmp_path / "a.xyz")
    with pytest.raises(InputError, match="there is no such file or folder"):
        open_log(tmp_path / "none")


def test_a_manifest_by_hand_needs_pictures(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither log nor"):
        make_manifest({})
    with pytest.raises(InputError, match="there is no such file or folder"):
        load_manifest(Manifest(log=tmp_path / "none"))


# ------------------------------------------------------------------------------------------- fuse and inspect

CAMERA = '[camera]\nfile = "hall.mp4"\ncalibration = "camera.yaml"\n'
CHAIN = """cam0:
  T_cam_imu: [[0,-1,0,0],[0,0,-1,0],[1,0,0,0],[0,0,0,1]]
  timeshift_cam_imu: 0.25
  resolution: [640, 480]
  intrinsics: [466, 466, 319.5, 239.5]
  camera_model: pinhole
  distortion_model: radtan
  distortion_coeffs: [0, 0, 0, 0]
"""
SEEN_ALIKE = {
    "files on clocks of their own": MANIFEST + '[attitude]\nfile = "attitude.csv"\nclock_offset_s = -100.0\n',
    "a folder, corrected": f"log = {str(OFFICE)!r}\n[camera]\nfocal_scale = 1.5\nmount_yaw_rad = 0.1\n"
    '[imu]\nnoise = "imu.yaml"\nmount_rad = [0.0, 0.1, 0.0]\n[attitude]\nuse = false\n',
    "pictures with a list of times": CAMERA.replace("hall.mp4", "pictures")
    + 'clock_offset_s = 100.0\n[attitude]\nfile = "attitude.csv"\n',
    "an autopilot's log, its first IMU": f'log = "new.BIN"\n{CAMERA}clock_offset_s = 80.0\n',
    "an autopilot's log, its second IMU": (
        f'log = "new.BIN"\n{CAMERA}clock_offset_s = 80.0\n[imu]\ntopic = "IMU[1]"\n'
    ),
    "a chain that knows the offset": f'log = {str(OFFICE)!r}\n[camera]\ncalibration = "camchain.yaml"\n',
}


@pytest.mark.parametrize("case", SEEN_ALIKE)
def test_inspecting_shows_the_streams_that_are_fused(parts: Parts, case: str) -> None:
    new_log(parts.folder)
    (parts.folder / "imu.yaml").write_text("gyroscope_noise_density: 0.001\n")
    (parts.folder / "camchain.yaml").write_text(CHAIN)
    path = at(parts, SEEN_ALIKE[case])
    flight = assemble_flight(read_manifest(path))
    manifest = manifest_of(flight)
    fused = {
        kind: (manifest.stream(TABLES[kind]).topic, len(stream.t_ns), stream.t_ns[0], stream.t_ns[-1])
        for kind, stream in {
            Kind.FRAMES: flight.frames,
            Kind.IMU: flight.imu,
            Kind.ATTITUDE: flight.attitude,
            Kind.POSITION: flight.position,
            Kind.VELOCITY: flight.velocity,
            Kind.RANGE: flight.range,
        }.items()
        if stream is not None
    }
    streams = {stream.kind: stream for stream in inspect_path(path).streams if stream.chosen}
    assert fused == {
        kind: (stream.name, stream.timing.samples, stream.timing.first_ns, stream.timing.last_ns)
        for kind, stream in streams.items()
    }
    assert all(stream.error is None for stream in streams.values())
    camera, imu = streams[Kind.FRAMES].camera, streams.get(Kind.IMU)
    assert camera is not None
    assert camera == CameraFindings.of(flight.camera)
    assert (flight.imu is None) == (imu is None)
    if flight.imu is not None and imu is not None:
        assert imu.imu == inspect_imu(flight.imu)


# ------------------------------------------------------------------------------------------- choices


class Log:
    """A log of which only the topics matter."""

    problems, path = (), Path("a.bag")

    def __init__(self, kind: Kind, *names: str, empty: tuple[str, ...] = (), format: str = "bag") -> None:
        self.format = format
        some, none = np.arange(3), np.zeros(0, np.int64)
        self.topics = tuple(Topic(name, kind, none if name in empty else some) for name in names)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


def chosen(kind: Kind, *names: str, empty: tuple[str, ...] = ()) -> str | None:
    log: LogContents = Log(kind, *names, empty=empty)  # type: ignore[assignment]
    return choose_topic(log, kind).value


@pytest.mark.parametrize(
    ("kind", "names", "expected"),
    [
        (Kind.IMU, (), None),
        (Kind.IMU, ("/anything",), "/anything"),
        (Kind.IMU, ("/imu/data_raw", "/imu/data"), "/imu/data"),
        (Kind.IMU, ("/mavros/imu/data", "/camera/imu"), "/mavros/imu/data"),
        (Kind.IMU, ("imu1", "imu0"), "imu0"),
        (Kind.FRAMES, ("cam1", "cam0"), "cam0"),
        (Kind.FRAMES, ("/cam/image_raw/compressed", "/cam/image_raw"), "/cam/image_raw"),
        (Kind.FRAMES, ("/camera/depth/image", "/camera/color/image_raw"), "/camera/color/image_raw"),
        (Kind.ATTITUDE, ("/wheels/odom", "/imu/data"), "/imu/data"),
        (Kind.VELOCITY, ("/odom", "/odometry/filtered", "/gps/vel"), "/odometry/filtered"),
    ],
)
def test_the_vehicles_own_is_taken(kind: Kind, names: tuple[str, ...], expected: str | None) -> None:
    assert chosen(kind, *names) == expected


@pytest.mark.parametrize("name", sorted(RANKED_FORMATS))
def test_an_autopilots_log_is_taken_in_its_readers_order(name: str) -> None:
    for kind in (Kind.IMU, Kind.VELOCITY):
        log = Log(kind, "NKF1", "NKF6", empty=("NKF1",), format=name)
        assert choose_topic(log, kind).value == "NKF6"  # type: ignore[arg-type]
        assert choose_topic(Log(kind, "b", "a", format=name), kind).value == "b"  # type: ignore[arg-type]


def test_the_ranked_formats_are_those_of_the_readers() -> None:
    from fusion.logs.autopilot import dataflash, tlog, ulog

    assert {dataflash.FORMAT, tlog.FORMAT, ulog.FORMAT} == RANKED_FORMATS


def test_a_topic_without_samples_is_no_candidate() -> None:
    assert chosen(Kind.FRAMES, "/left", "/right", empty=("/left",)) == "/right"


def test_two_cameras_or_imus_are_asked_about() -> None:
    with pytest.raises(InputError, match=r'2 cameras: /left, /right .*\[camera\] topic = "/left"'):
        chosen(Kind.FRAMES, "/left", "/right")
    with pytest.raises(InputError, match=r'2 IMUs: /a/b, /c/d .*log = "a\.bag", then \[imu\] topic = "/a/b"'):
        chosen(Kind.IMU, "/a/b", "/c/d")


def test_other_streams_are_left_out_and_said() -> None:
    log: LogContents = Log(Kind.VELOCITY, "/a", "/b")  # type: ignore[assignment]
    assert choose_topic(log, Kind.VELOCITY) == (
        None,
        (
            'a.bag: 2 topics of velocity (/a, /b), none used: name one in flight.toml, [velocity] topic = "/a"',
        ),
    )
