"""Videos: each frame at its own time, in any order; what is missing or damaged is a line or an unreadable frame."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from fusion.flight import FrameStream
from fusion.logs import load_flight, open_log
from fusion.logs.pictures.gpmf import samples_of
from fusion.logs.pictures.video import VideoLog, open_video, recognises
from tests.files import OFFICE
from tests.fusion.reading import Told
from vision import InputError
from vision.images import GreyImage

if TYPE_CHECKING:
    from av.container import InputContainer

av = pytest.importorskip("av")

SIZE = (160, 120)
N_FRAMES = 40
CLOCK = Fraction(1, 90000)
#: Uneven on purpose: a variable rate, with a pause.
TIMES_S = np.cumsum([0.0, *np.random.default_rng(0).uniform(0.02, 0.08, N_FRAMES - 1)])
TIMES_S[25:] += 0.7


@pytest.fixture(scope="module")
def pictures() -> list[GreyImage]:
    frames = load_flight(OFFICE).frames
    return [cv2.resize(frames.read(i), SIZE, interpolation=cv2.INTER_AREA) for i in range(N_FRAMES)]  # type: ignore[misc]


def encode(
    path: Path,
    pictures: list[GreyImage],
    codec: str = "libx264",
    *,
    times_s: np.ndarray = TIMES_S,
    clock: Fraction = CLOCK,
    b_frames: int = 2,
    turned: int = 0,
    container: str | None = None,
    **options: str,
) -> Path:
    with av.open(str(path), "w", format=container, options=options) as file:
        stream = file.add_stream(codec, rate=20)
        stream.width, stream.height = pictures[0].shape[::-1]
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = clock
        stream.codec_context.gop_size = 8
        stream.codec_context.max_b_frames = b_frames
        if turned:
            stream.set_display_rotation(turned)
        for picture, t_s in zip(pictures, times_s, strict=True):
            frame = av.VideoFrame.from_ndarray(picture, format="gray").reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = round(Fraction(float(t_s)) / clock), clock
            for packet in stream.encode(frame):
                file.mux(packet)
        for packet in stream.encode(None):
            file.mux(packet)
    return path


def frames_of(log: Any) -> FrameStream:
    return log.frames(log.topics[0].name).value  # type: ignore[no-any-return]


def read_all(frames: FrameStream) -> list[GreyImage | None]:
    found: list[GreyImage | None] = []
    for i in range(len(frames.t_ns)):
        try:
            found.append(frames.read(i))
        except InputError:
            found.append(None)
    return found


def difference(a: GreyImage, b: GreyImage) -> float:
    return float(np.abs(a.astype(float) - b).mean())


@pytest.fixture(scope="module")
def mp4(pictures: list[GreyImage], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encode(tmp_path_factory.mktemp("video") / "hall.mp4", pictures)


# ------------------------------------------------------------------------------------------- times and pictures


@pytest.mark.parametrize(
    ("name", "codec", "within_s"),
    [
        ("a.mp4", "libx264", 1e-5),
        ("a.mkv", "libx264", 1e-3),  # Matroska counts milliseconds
        ("a.ts", "libx264", 1e-5),
        ("a.webm", "libvpx-vp9", 1e-3),
        ("a.mov", "mpeg4", 1e-4),
    ],
)
def test_a_variable_rate_is_kept(
    pictures: list[GreyImage], tmp_path: Path, name: str, codec: str, within_s: float
) -> None:
    clock = Fraction(1, 30000) if codec == "mpeg4" else CLOCK  # MPEG-4 has 16 bits for it
    path = encode(tmp_path / name, pictures, codec, clock=clock, b_frames=0 if codec == "mpeg4" else 2)
    assert recognises(path)
    log = open_video(path, start_ns=5_000_000_000)
    assert log.problems == ()
    frames = frames_of(log)
    assert np.abs((frames.t_ns - 5_000_000_000) * 1e-9 - TIMES_S).max() < within_s
    for ours, theirs in zip(read_all(frames), pictures, strict=True):
        assert ours is not None
        assert difference(ours, theirs) < 8.0


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "x.avi"])
def test_any_order_gives_the_same_pictures(pictures: list[GreyImage], tmp_path: Path, name: str) -> None:
    clock = Fraction(1, 20) if name.endswith("avi") else CLOCK
    times_s = np.arange(N_FRAMES) / 20 if name.endswith("avi") else TIMES_S
    frames = frames_of(open_log(encode(tmp_path / name, pictures, clock=clock, times_s=times_s)))
    in_order = read_all(frames)
    rng = np.random.default_rng(1)
    for i in [*range(N_FRAMES - 1, -1, -5), *rng.integers(0, N_FRAMES, 25).tolist(), 7, 7]:
        image = frames.read(i)
        assert in_order[i] is not None
        np.testing.assert_array_equal(image, in_order[i])


def test_reading_on_does_not_seek(mp4: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = frames_of(open_log(mp4))
    opened: list[Path] = []
    from fusion.logs.pictures import video

    real = video.open_container

    def noted(path: Path) -> InputContainer:
        opened.append(path)
        return real(path)

    monkeypatch.setattr(video, "open_container", noted)
    frames.read(0)
    opened.clear()
    assert all(image is not None for image in read_all(frames))
    assert opened == []


def test_memory_does_not_grow_with_the_video(pictures: list[GreyImage], tmp_path: Path) -> None:
    many = pictures * 12
    path = encode(tmp_path / "long.mp4", many, times_s=np.arange(len(many)) / 20)
    frames = frames_of(open_log(path))
    frames.read(0)
    gc.collect()
    tracemalloc.start()
    for i in range(len(frames.t_ns)):
        frames.read(i)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20 * SIZE[0] * SIZE[1]  # of 480 pictures


def test_a_flight_from_a_video_keeps_its_pictures_open(mp4: Path) -> None:
    frames = frames_of(open_log(mp4)).chosen(np.array([3, 5, 30]))
    whole = frames_of(open_log(mp4))
    np.testing.assert_array_equal(frames.read(2), whole.read(30))
    np.testing.assert_array_equal(frames.t_ns, whole.t_ns[[3, 5, 30]])


@pytest.mark.parametrize("turned", [90, 180, 270])
def test_a_header_that_turns_the_pictures_is_obeyed(
    pictures: list[GreyImage], tmp_path: Path, turned: int
) -> None:
    if not hasattr(av.video.stream.VideoStream, "set_display_rotation"):
        pytest.skip("this PyAV cannot write such a header")
    log = open_log(encode(tmp_path / "a.mp4", pictures, turned=turned))
    problems = Told()
    image = problems.take(log.frames("video")).read(0)
    assert difference(image, np.rot90(pictures[0], turned // 90)) < 6.0
    assert f"turned by {turned} degrees" in problems[0]


# ------------------------------------------------------------------------------------------- clocks of other kinds


def test_raw_streams_have_no_times(pictures: list[GreyImage], tmp_path: Path) -> None:
    path = encode(tmp_path / "a.h264", pictures, container="h264")
    with pytest.raises(
        InputError, match=r"a\.h264: has no time stamps \(name a CSV with the time of each frame"
    ):
        open_log(path)
    times = tmp_path / "times.txt"
    times.write_text("# timecode format v2\n" + "".join(f"{1000 * t:.3f}\n" for t in TIMES_S))
    log = open_video(path, times=times)
    frames = frames_of(log)
    np.testing.assert_allclose(frames.t_ns * 1e-9, TIMES_S, atol=1e-6)
    for i in (0, 17, 39, 5, 6):
        assert difference(frames.read(i), pictures[i]) < 6.0


def test_avi_has_a_nominal_rate_only(pictures: list[GreyImage], tmp_path: Path) -> None:
    times_s = np.arange(N_FRAMES) / 20
    path = encode(tmp_path / "a.avi", pictures, "mjpeg", clock=Fraction(1, 20), times_s=times_s, b_frames=0)
    log = open_log(path)
    assert log.problems == ("a.avi: AVI stores no times; its nominal rate of 20 frames a second is taken",)
    np.testing.assert_array_equal(frames_of(log).t_ns, np.arange(N_FRAMES) * 50_000_000)


def test_times_from_a_file_go_row_by_row(mp4: Path, tmp_path: Path) -> None:
    stamps = 1_600_000_000_000_000_000 + np.arange(N_FRAMES) * 40_000_000
    times = tmp_path / "times.csv"
    times.write_text("frame,timestamp_ns\n" + "".join(f"{i},{t}\n" for i, t in enumerate(stamps)))
    frames = frames_of(open_video(mp4, times=times))
    np.testing.assert_array_equal(frames.t_ns, stamps)
    # A broken row costs its own frame; the others keep theirs. Rows too many are told.
    lines = times.read_text().splitlines()
    lines[11] = "10,what"
    times.write_text("\n".join([*lines, "40,1600000009000000000"]) + "\n")
    log = open_video(mp4, times=times)
    assert any("times.csv has 41 rows, hall.mp4 40 frames: the first 40" in text for text in log.problems)
    less = frames_of(log)
    assert len(less.t_ns) == N_FRAMES - 1
    np.testing.assert_array_equal(less.read(10), frames.read(11))


def test_two_frames_with_one_time_stamp_keep_their_rows_of_a_times_file(
    pictures: list[GreyImage], tmp_path: Path
) -> None:
    """Every row is of the packet in its place: a repeated stamp must not shift those that follow."""
    evenly_s, milliseconds = np.arange(N_FRAMES) / 20, Fraction(1, 1000)
    whole = encode(
        tmp_path / "whole.mkv", pictures, "mpeg4", times_s=evenly_s, clock=milliseconds, b_frames=0
    )
    path = tmp_path / "twice.mkv"
    with av.open(str(whole)) as source, av.open(str(path), "w") as file:
        stream = file.add_stream_from_template(source.streams.video[0])
        last = 0
        for number, packet in enumerate(p for p in source.demux(video=0) if p.dts is not None):
            packet.stream = stream
            packet.pts = packet.dts = last if number == 10 else packet.pts
            last = packet.pts
            file.mux(packet)
    stamps = 1_600_000_000_000_000_000 + np.arange(N_FRAMES) * 40_000_000
    times = tmp_path / "times.csv"
    times.write_text("timestamp_ns\n" + "".join(f"{t}\n" for t in stamps))
    log = open_video(path, times=times)
    assert log.problems == ("twice.mkv: 1 frame with the time stamp of another left out",)
    frames = frames_of(log)
    np.testing.assert_array_equal(frames.t_ns, np.delete(stamps, 10))
    for row in (0, 9, 10, 20, N_FRAMES - 2):
        nearest = min(range(N_FRAMES), key=lambda k: difference(frames.read(row), pictures[k]))
        assert stamps[nearest] == frames.t_ns[row]
    # A file with a row per frame that can be told apart is taken as it stands.
    times.write_text("timestamp_ns\n" + "".join(f"{t}\n" for t in np.delete(stamps, 10)))
    np.testing.assert_array_equal(frames_of(open_video(path, times=times)).t_ns, np.delete(stamps, 10))


def test_videos_that_start_late_or_lack_frames_are_not_cut_short(
    pictures: list[GreyImage], tmp_path: Path
) -> None:
    late = encode(tmp_path / "late.mkv", pictures, times_s=10.0 + np.arange(N_FRAMES) / 20)
    log = open_log(late)
    assert log.problems == ()
    np.testing.assert_allclose(np.diff(frames_of(log).t_ns), 5e7, atol=1e6)
    transport = encode(tmp_path / "late.ts", pictures, times_s=10.0 + np.arange(N_FRAMES) / 20)
    assert open_log(transport).problems == ()

    whole = encode(tmp_path / "whole.mp4", pictures, times_s=np.arange(N_FRAMES) / 20)
    edited = tmp_path / "edited.mp4"  # an edit list leaves the first second out
    remux(whole, edited, lambda n, packet: shift(packet, -1.0))
    log = open_log(edited)
    assert log.problems == ()
    nearest = min(range(N_FRAMES), key=lambda k: difference(frames_of(log).read(0), pictures[k]))
    assert nearest == 20

    evenly_s = np.arange(N_FRAMES) / 20
    even = encode(
        tmp_path / "even.avi", pictures, "mjpeg", clock=Fraction(1, 20), times_s=evenly_s, b_frames=0
    )
    dropped = tmp_path / "dropped.avi"
    remux(even, dropped, lambda n, packet: not 10 <= n < 15)
    log = open_log(dropped)
    assert [text for text in log.problems if "cut" in text] == []
    assert len(frames_of(log).t_ns) == N_FRAMES - 5
    assert frames_of(log).t_ns[10] == 15 * 50_000_000


def remux(source: Path, target: Path, keep: Callable[[int, Any], bool]) -> None:
    """Copy a video's packets as they are, but for what ``keep`` changes in them or leaves out."""
    with av.open(str(source)) as read, av.open(str(target), "w") as file:
        stream = file.add_stream_from_template(read.streams.video[0])
        for number, packet in enumerate(p for p in read.demux(video=0) if p.dts is not None):
            if keep(number, packet):
                packet.stream = stream
                file.mux(packet)


def shift(packet: Any, by_s: float) -> bool:
    ticks = round(by_s / packet.time_base)
    packet.pts, packet.dts = packet.pts + ticks, packet.dts + ticks
    return True


# ------------------------------------------------------------------------------------------- damage


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "fast.mp4"])
def test_cut_at_every_kilobyte(pictures: list[GreyImage], tmp_path: Path, name: str) -> None:
    options: dict[str, Any] = {"movflags": "faststart"} if name == "fast.mp4" else {}
    whole = encode(tmp_path / name, pictures, **options)
    data = whole.read_bytes()
    cut = tmp_path / ("cut" + whole.suffix)
    refused, partly = 0, 0
    for end in range(0, len(data) - 100, 1024):
        cut.write_bytes(data[:end])
        try:
            log = open_log(cut)
            frames = frames_of(log)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert error.remedy  # noqa: PT017
            refused += 1
            continue
        good = [i for i, image in enumerate(read_all(frames)) if image is not None]
        assert good
        partly += 1
        # A transport stream has no header that says how long it is.
        if whole.suffix != ".ts" and len(frames.t_ns) < N_FRAMES - 8:
            assert any("cut short" in text or "damaged" in text for text in log.problems)
    assert refused
    assert partly or name == "a.mp4"  # an MP4 keeps its index at its end


def test_flipped_bytes_cost_frames_and_never_pass_for_pictures(mp4: Path, tmp_path: Path) -> None:
    """What H.264 conceals is not handed out: every frame that reads is the one of the sound file."""
    sound = read_all(frames_of(open_log(mp4)))
    rng = np.random.default_rng(2)
    lost = 0
    for trial in range(8):
        data = bytearray(mp4.read_bytes())
        for place in rng.integers(len(data) // 4, 3 * len(data) // 4, 3):
            data[place] ^= 0xFF
        path = tmp_path / f"{trial}.mp4"
        path.write_bytes(data)
        found = read_all(frames_of(open_log(path)))
        lost += sum(image is None for image in found)
        wrong = [
            i for i, (a, b) in enumerate(zip(found, sound, strict=True))
            if a is not None and b is not None and difference(a, b) > 12.0
        ]  # fmt: skip
        assert not wrong
        assert any(image is not None for image in found)
    assert lost


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.mp4", b"", r"a\.mp4: is empty \(the file was not written whole"),
        (
            "a.mp4",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:ff\n",
            r"pointer of Git LFS.*git lfs pull",
        ),
        (
            "b.mp4",
            b"rubbish",
            r"does not open as a video: .*\(it is not a video, or was not written to its end",
        ),
        ("a.mp4", b"\0\0\0\x20ftypisom" + bytes(20), r"does not open as a video"),
        ("a.mkv", b"\x1a\x45\xdf\xa3", r"does not open as a video"),
        ("a.mp4", b"<html>not found</html>", r"does not open as a video"),
    ],
)
def test_what_is_no_video(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=message):
        open_log(tmp_path / name)


def test_sound_alone_is_no_video(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mp4"), "w") as file:
        stream = file.add_stream("aac", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 8000
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            file.mux(packet)
    with pytest.raises(InputError, match=r"a\.mp4: contains no video stream \(give a video with pictures\)"):
        open_log(tmp_path / "a.mp4")


def test_a_video_has_nothing_but_pictures(mp4: Path) -> None:
    log = open_log(mp4)
    assert isinstance(log, VideoLog)
    assert log.camera("video") is None
    for kind in ("imu", "attitude", "position", "velocity", "range"):
        with pytest.raises(InputError, match=f"has no {kind} topic x"):
            getattr(log, kind)("x")
    with pytest.raises(InputError, match=r"has no frames topic y \(choose one of video\)"):
        log.frames("y")


def test_without_pyav_it_says_what_to_install(mp4: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import builtins

    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "av":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(
        InputError, match=r"needs PyAV \(install it: pip install 'corridor-fusion\[video\]'\)"
    ):
        open_log(mp4)


# ------------------------------------------------------------------------------------------- telemetry


def record(key: bytes, form: bytes, size: int, data: bytes) -> bytes:
    padding = bytes(-len(data) % 4)
    return key + form + bytes([size]) + (len(data) // size).to_bytes(2, "big") + data + padding


def nested(key: bytes, *records: bytes) -> bytes:
    content = b"".join(records)
    return key + b"\0\x01" + len(content).to_bytes(2, "big") + content


def telemetry(gyro: np.ndarray, accel: np.ndarray) -> bytes:
    """A packet as the published format has it: counts, and what they are divided by."""

    def sensor(key: bytes, values: np.ndarray, scale: int) -> bytes:
        counts = np.rint(values * scale).astype(">i2").tobytes()
        scaled = record(b"SCAL", b"s", 2, scale.to_bytes(2, "big"))
        return nested(b"STRM", record(b"STNM", b"c", 1, b"Sensor"), scaled, record(key, b"s", 6, counts))

    return nested(
        b"DEVC", record(b"DVNM", b"c", 1, b"Hero"), sensor(b"ACCL", accel, 417), sensor(b"GYRO", gyro, 939)
    )


def test_a_gopros_imu_is_read_from_its_video(pictures: list[GreyImage], tmp_path: Path) -> None:
    office = load_flight(OFFICE).imu
    assert office is not None
    # The sensor's axes: up, right, forward.
    R = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    gyro, accel = office.gyro_rad_s[:400] @ R.T, office.accel_m_s2[:400] @ R.T
    path = tmp_path / "GX010001.MP4"
    with av.open(str(path), "w", format="mp4") as file:
        video = file.add_stream("mpeg4", rate=20)
        video.width, video.height, video.pix_fmt = (*SIZE, "yuv420p")
        try:
            data = file.add_data_stream("bin_data")
        except ValueError:
            pytest.skip("this version of PyAV reads streams of data, but writes none")
        data.time_base = Fraction(1, 1000)
        packets = []
        for i, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = i, Fraction(1, 20)
            packets += video.encode(frame)
        for packet in [*packets, *video.encode(None)]:
            file.mux(packet)
        for k in range(4):  # half a second each
            part = slice(100 * k, 100 * (k + 1))
            packet = av.Packet(telemetry(gyro[part], accel[part]))
            packet.stream, packet.time_base = data, Fraction(1, 1000)
            packet.pts = packet.dts = 500 * k
            packet.duration = 500
            file.mux(packet)
    log = open_log(path)
    assert [(topic.kind, topic.name) for topic in log.topics] == [("frames", "video"), ("imu", "gopro")]
    imu = log.imu("gopro").value
    np.testing.assert_array_equal(imu.t_ns, np.arange(400) * 5_000_000)
    np.testing.assert_allclose(imu.gyro_rad_s, gyro, atol=0.0006)
    np.testing.assert_allclose(imu.accel_m_s2, accel, atol=0.0013)
    assert difference(frames_of(log).read(7), pictures[7]) < 8
    # Told that the camera looks along its third axis, it is along the vehicle's.
    camera = "image_width: 160\nimage_height: 120\nK: [116.5, 0, 79.5, 0, 116.5, 59.5, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\n"
    (tmp_path / "camera.yaml").write_text(camera)
    table = 'log = "GX010001.MP4"\n[camera]\ncalibration = "camera.yaml"\n[imu]\ncamera_axis = "z"\n'
    (tmp_path / "flight.toml").write_text(table)
    flight = load_flight(tmp_path / "flight.toml")
    assert flight.imu is not None
    for axis in range(3):  # level is the usual attitude of these two seconds, not quite the office's
        turns = flight.imu.gyro_rad_s[:, axis], office.gyro_rad_s[:400, axis]
        assert np.corrcoef(*turns)[0, 1] > 0.97, axis
    # What is torn is left out.
    torn = list(samples_of(telemetry(gyro[:9], accel[:9])[:-20]))
    assert [key for key, _ in torn] == []
    assert list(samples_of(b"DEVC" + bytes(40))) == []
