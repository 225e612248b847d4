"""`corridor live` with its threads: cameras, links, a recording, a viewer, and a whole flight over loopback."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fusion import FusionConfig, fuse_flight, load_flight
from fusion.live.cameras import CameraThread, Picture, PlayedFrames, WatchedFolder, camera_source
from fusion.live.clock import HostClock
from fusion.live.link import Link
from fusion.live.recording import Recorder, camera_yaml
from fusion.live.replay import recorded_config, replay
from fusion.live.session import LiveSession, live_config
from fusion.live.settings import LiveSettings
from fusion.logs.rosbag.attachments import attached_camera
from fusion.outputs.folder import check_out_dir
from fusion.simulate import office_views
from tests.command import Corridor
from vision import Camera, InputError
from vision.images import to_grey

pytest.importorskip("pymavlink")


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    return subprocess.run(
        [sys.executable, "-m", "fusion", *arguments], capture_output=True, text=True, timeout=300
    )


CAMERA = Camera.from_fov(160, 120, radians(70))
WAIT_S = 300.0  # a limit against waiting for ever; what is waited for comes sooner


# The whole flight


@dataclass
class Flown:
    """A flight round a corner, and its recording."""

    outcome: Any
    path: Path


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    """Down a corridor, left into another and along it, by the messages alone; the autopilot boots on the way."""
    import live_loopback
    from simulated_vehicle import junction_config

    path = tmp_path_factory.mktemp("live") / "flight.mcap"
    config = junction_config(size_px=(160, 120), frame_hz=15.0, start_m=7.5)
    return Flown(live_loopback.fly(config, 19.0, record=path, reboot_at_s=15.0), path)


def test_it_is_steered_round_the_corner_by_the_messages_alone(flown: Flown) -> None:
    o = flown.outcome
    assert min(o.clearance_m) > 0.2  # a body's radius
    assert o.corridor[0] == 0
    assert o.corridor[-1] == 1
    assert o.room == 1
    assert np.sqrt(np.nanmean(np.square(o.yaw_error_rad))) < radians(1.5)
    assert np.sqrt(np.nanmean(np.square(o.offset_error_m))) < 0.1
    assert o.status[-1] == "tracking"


def test_what_was_sent_is_what_was_asked_for(flown: Flown) -> None:
    heard, s = flown.outcome.heard, flown.outcome.statistics
    assert heard.intervals[105] == pytest.approx(100.0)
    assert heard.counts["ODOMETRY"] > 0.8 * s.estimates
    assert heard.counts["HEARTBEAT"] >= 15
    assert heard.texts[0] == "corridor 1: tracking"
    assert any(text.startswith("corridor 2") for text in heard.texts)
    assert s.frames_used > 0.6 * s.frames
    assert 5.0 < s.latency_ms(50) <= s.latency_ms(99)
    assert s.not_recorded == 0


def test_another_boot_of_the_autopilot_is_survived(flown: Flown) -> None:
    o = flown.outcome
    late = [status for t_s, status in zip(o.t_s, o.status, strict=True) if t_s > 17.0]
    assert set(late) <= {"tracking", "coasting"}
    assert "tracking" in late


def test_a_recording_gives_to_the_bit_what_was_sent(flown: Flown) -> None:
    again = replay(flown.path)
    assert again.is_exact
    assert again.packets_sent == flown.outcome.statistics.packets_sent
    assert len(again.estimates) == flown.outcome.statistics.estimates
    assert again.problems == []


def test_a_change_of_one_bit_is_noticed(flown: Flown, monkeypatch: pytest.MonkeyPatch) -> None:
    from fusion.live.core import LiveCore

    on_bytes = LiveCore.on_bytes
    monkeypatch.setattr(LiveCore, "on_bytes", lambda self, t_ns, data: on_bytes(self, t_ns + 1000, data))
    assert not replay(flown.path).is_exact


def test_corridor_fuse_reads_a_recording_and_says_that_it_is_exact(
    flown: Flown, tmp_path: Path, corridor: Corridor
) -> None:
    done = corridor("fuse", flown.path, "-o", tmp_path / "out")
    assert done.code == 0, done.err
    assert "computed again: the same to the bit" in done.out
    assert (tmp_path / "out" / "sent.csv").read_text().startswith("timestamp_ns,heading_rad,")
    assert check_out_dir(tmp_path / "out")  # an output of ours may be replaced


def test_a_recording_is_a_flight_with_all_its_streams(flown: Flown) -> None:
    flight, s = load_flight(flown.path), flown.outcome.statistics
    assert len(flight.frames.t_ns) == s.frames
    assert flight.imu is not None
    assert flight.attitude is not None
    assert flight.imu.accel_m_s2[:, 2].mean() == pytest.approx(-9.8, abs=0.4)  # its bias included
    config = recorded_config(flown.path)
    assert config is not None
    assert config.corridor_width_m == 2.2
    assert config.camera_delay_std_s > 0
    result = fuse_flight(flight, config)
    assert result.estimates["corridor_index"][-1] == 1


def test_a_recording_cut_in_flight_is_read_up_to_there(flown: Flown, tmp_path: Path) -> None:
    data = flown.path.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[: len(data) * 2 // 3])
    again = replay(torn)
    assert 50 < len(again.estimates) < flown.outcome.statistics.estimates
    assert again.estimates_equal == len(again.estimates)
    assert "ends early" in again.problems[0]


# The recording


def test_a_calibration_is_recorded_to_the_last_digit(tmp_path: Path) -> None:
    camera = Camera(
        640, 480, 411.123456789012345, 410.9, 319.1, 241.7, "equidistant", (0.1, -0.02, 1 / 3, 0.004),  # type: ignore[arg-type]
        exposure_s=1 / 120, p_body_camera_m=np.array([0.1, -1 / 7, 0.02]), line_delay_s=3e-5,
    )  # fmt: skip
    path = tmp_path / "flight.mcap"
    Recorder(path, FusionConfig(), camera, LiveSettings()).close()
    read = attached_camera(path)
    assert read is not None
    assert camera_yaml(read) == camera_yaml(camera)
    assert (read.R_body_camera == camera.R_body_camera).all()


def test_a_recording_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(b"dear")
    with pytest.raises(InputError, match="choose another --record"):
        Recorder(path, FusionConfig(), CAMERA, LiveSettings())
    assert path.read_bytes() == b"dear"


def test_another_mcap_file_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(InputError, match="not a recording of corridor live"):
        replay(path)


def test_the_cameras_delay_is_estimated_unless_its_sigma_is_set() -> None:
    assert live_config(None).camera_delay_std_s > 0
    assert live_config(FusionConfig(camera_delay_std_s=0.0)).camera_delay_std_s == 0


# Cameras


def wait_until(happened: Callable[[], bool]) -> None:
    """Wait for what is bound to happen, however slow the machine is."""
    end = time.monotonic() + WAIT_S
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)


class Taken:
    """Pictures of a camera, and its thread."""

    def __init__(self, source: Any) -> None:
        self.pictures: list[Picture] = []
        self.thread = CameraThread(source, self.pictures.append)

    def wait_for(self, n: int) -> None:
        wait_until(lambda: len(self.pictures) >= n)

    def wait_until_reopened(self, times: int = 1) -> None:
        wait_until(lambda: self.thread.reopened >= times)


def _save(path: Path, grey: int) -> None:
    cv2.imwrite(str(path), np.full((120, 160), grey, np.uint8))


def test_an_empty_folder_is_watched(tmp_path: Path) -> None:
    clock = HostClock()
    source = camera_source(str(tmp_path), CAMERA, clock)
    assert isinstance(source, WatchedFolder)
    taken = Taken(source)
    stamp_ns = clock.now_ns()
    _save(tmp_path / f"{stamp_ns}.png", 7)
    taken.wait_for(1)
    (tmp_path / f"{stamp_ns + 5}.png").write_bytes(b"no picture")
    _save(tmp_path / "named.png", 9)
    taken.wait_for(3)
    taken.thread.close()
    assert taken.pictures[0].t_ns == stamp_ns
    assert [p.image is None for p in taken.pictures].count(True) == 1
    images = [p.image for p in taken.pictures if p.image is not None]
    assert [int(image[0, 0]) for image in images] == [7, 9]
    assert abs(taken.pictures[1].t_ns - clock.now_ns()) < WAIT_S * 1e9


def test_a_folder_with_pictures_is_played_at_its_own_pace_and_ends(tmp_path: Path) -> None:
    for k in range(4):
        _save(tmp_path / f"{10**18 + k * 100_000_000}.png", k)
    source = camera_source(str(tmp_path), CAMERA, HostClock())
    assert isinstance(source, PlayedFrames)
    started = time.monotonic()
    taken = Taken(source)
    assert taken.thread.ended.wait(WAIT_S)
    assert time.monotonic() - started >= 0.29
    assert np.diff([p.t_ns for p in taken.pictures]).tolist() == [100_000_000] * 3
    assert taken.thread.reopened == 0


def test_a_folder_that_vanishes_is_tried_again(tmp_path: Path) -> None:
    folder = tmp_path / "camera"
    folder.mkdir()
    taken = Taken(camera_source(str(folder), CAMERA, HostClock()))
    shutil.rmtree(folder)
    taken.wait_until_reopened()
    folder.mkdir()
    _save(folder / "back.png", 5)
    taken.wait_for(1)
    taken.thread.close()
    assert taken.thread.reopened >= 1


def _stream_until(taken: Taken, port: int, n: int) -> None:
    """Send short MPEG-TS streams over UDP until so many pictures have been taken: what nobody hears yet is lost."""

    def has_arrived() -> bool:
        _encode(f"udp://127.0.0.1:{port}?pkt_size=1316", 40)
        return len(taken.pictures) >= n

    wait_until(has_arrived)


def _encode(to: Any, pictures: int) -> None:
    import av

    with av.open(to, "w", format="mpegts") as out:
        stream: Any = out.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 160, 120, "yuv420p", 5
        for k in range(pictures):
            frame = av.VideoFrame.from_ndarray(
                np.full((120, 160), 8 * (k % 20) + 40, np.uint8), format="gray"
            )
            out.mux(stream.encode(frame.reformat(format="yuv420p")))
            time.sleep(0.01)


def test_a_stream_that_dies_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("av")
    monkeypatch.setattr("fusion.live.cameras.READ_S", 0.5)
    port = _free_port(socket.SOCK_DGRAM)
    clock = HostClock()
    taken = Taken(camera_source(f"udp://127.0.0.1:{port}", CAMERA, clock))
    _stream_until(taken, port, 3)
    taken.wait_until_reopened()
    n = len(taken.pictures)
    _stream_until(taken, port, n + 1)
    taken.thread.close()
    assert taken.thread.reopened >= 1
    assert (np.diff([p.t_ns for p in taken.pictures]) > 0).all()
    assert all(p.t_ns <= clock.now_ns() for p in taken.pictures)


class RtspServer:
    """The part of RTSP (RFC 2326) that a player needs, with MPEG-TS in RTP over UDP (RFC 2250), for one player."""

    def __init__(self, pictures: int) -> None:
        self._pictures = pictures
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"rtsp://127.0.0.1:{self._listening.getsockname()[1]}/front"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        connection, _ = self._listening.accept()
        rtp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        rtp.bind(("127.0.0.1", 0))
        with connection, rtp, connection.makefile("rb") as lines:
            while request := self._request(lines):
                method, fields = request
                answer = {"CSeq": fields["cseq"], "Session": "1"}
                body = ""
                if method == "OPTIONS":
                    answer["Public"] = "DESCRIBE, SETUP, PLAY, TEARDOWN"
                elif method == "DESCRIBE":
                    body = "\r\n".join(
                        ["v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=front", "t=0 0", "m=video 0 RTP/AVP 33", ""]
                    )
                    answer |= {"Content-Type": "application/sdp", "Content-Length": str(len(body))}
                elif method == "SETUP":
                    asked = fields["transport"].partition("client_port=")[2]
                    rtp.connect(("127.0.0.1", int(asked.partition("-")[0])))
                    port = rtp.getsockname()[1]
                    answer["Transport"] = f"RTP/AVP;unicast;client_port={asked};server_port={port}-{port + 1}"
                head = "".join(f"{name}: {value}\r\n" for name, value in answer.items())
                connection.sendall(f"RTSP/1.0 200 OK\r\n{head}\r\n{body}".encode())
                if method == "PLAY":
                    _encode(_RtpWriter(rtp), self._pictures)
                    return  # the camera dies

    @staticmethod
    def _request(lines: Any) -> tuple[str, dict[str, str]] | None:
        first = lines.readline().decode()
        fields = {}
        while line := lines.readline().decode().strip():
            name, _, value = line.partition(":")
            fields[name.lower()] = value.strip()
        return (first.split()[0], fields) if first else None


class _RtpWriter:
    """A file that sends what is written to it as RTP packets of seven transport packets."""

    def __init__(self, rtp: socket.socket) -> None:
        self._rtp, self._number, self._rest = rtp, 0, b""

    def write(self, data: bytes) -> int:
        self._rest += data
        while len(self._rest) >= 7 * 188:
            payload, self._rest = self._rest[: 7 * 188], self._rest[7 * 188 :]
            stamp = int(time.monotonic() * 90_000) & 0xFFFFFFFF
            with suppress(ConnectionRefusedError):
                self._rtp.send(struct.pack("!BBHII", 0x80, 33, self._number & 0xFFFF, stamp, 7) + payload)
            self._number += 1
        return len(data)


def test_a_camera_is_played_by_rtsp() -> None:
    pytest.importorskip("av")
    server = RtspServer(pictures=100)
    clock = HostClock()
    taken = Taken(camera_source(server.url, CAMERA, clock))
    taken.wait_for(5)
    taken.wait_until_reopened()  # the server has gone
    taken.thread.close()
    assert taken.thread.reopened >= 1
    assert all(p.image is not None and p.image.shape == (120, 160) for p in taken.pictures)
    assert (np.diff([p.t_ns for p in taken.pictures]) > 0).all()
    assert all(p.t_ns <= clock.now_ns() for p in taken.pictures)


@pytest.mark.skipif(sys.platform != "linux", reason="V4L2 is Linux's")
def test_a_device_that_is_no_camera_is_told_once_and_tried_again(caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("av")
    taken = Taken(camera_source("/dev/null", CAMERA, HostClock()))
    taken.wait_until_reopened(2)
    taken.thread.close()
    assert taken.thread.reopened >= 2
    told = [text for text in caplog.messages if text.startswith("camera /dev/null: ")]
    assert len(told) == 1
    assert "check the camera" in told[0]


def test_what_holds_no_pictures_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.md").write_text("none")
    with pytest.raises(InputError):
        camera_source(str(tmp_path), CAMERA, HostClock())
    with pytest.raises(InputError, match="there is no such file"):
        camera_source(str(tmp_path / "missing.mp4"), CAMERA, HostClock())


# Links


def _free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_a_tcp_link_is_opened_again_when_the_other_side_returns() -> None:
    port = _free_port(socket.SOCK_STREAM)
    received: list[bytes] = []
    arrived = threading.Event()

    def take(data: bytes) -> None:
        received.append(data)
        arrived.set()

    link = Link(f"tcp:127.0.0.1:{port}", take)

    def call_once(text: bytes) -> bytes:
        arrived.clear()
        with socket.create_server(("127.0.0.1", port)) as server:
            server.settimeout(WAIT_S)
            connection, _ = server.accept()
            with connection:
                connection.settimeout(WAIT_S)
                connection.sendall(text)
                assert arrived.wait(WAIT_S)
                link.send(b"answer")
                return connection.recv(100)

    assert call_once(b"first") == b"answer"
    assert call_once(b"second") == b"answer"
    link.close()
    assert received == [b"first", b"second"]
    assert link.reopened == 1


def test_a_serial_link_carries_bytes_both_ways() -> None:
    pytest.importorskip("serial")
    import os
    import pty

    ours, theirs = pty.openpty()
    arrived = threading.Event()
    received: list[bytes] = []

    def take(data: bytes) -> None:
        received.append(data)
        arrived.set()

    link = Link(f"{os.ttyname(theirs)},115200", take)
    os.write(ours, b"hello")
    assert arrived.wait(WAIT_S)
    link.send(b"there")
    assert os.read(ours, 100) == b"there"
    link.close()
    assert b"".join(received) == b"hello"


def test_a_serial_cable_may_be_pulled_and_put_back(tmp_path: Path) -> None:
    pytest.importorskip("serial")
    import os
    import pty

    device = tmp_path / "ttyACM0"
    received: list[bytes] = []
    arrived = threading.Event()

    def take(data: bytes) -> None:
        received.append(data)
        arrived.set()

    def plug() -> tuple[int, int]:
        ours, theirs = pty.openpty()
        device.symlink_to(os.ttyname(theirs))
        return ours, theirs

    def pull(ours: int, theirs: int) -> None:
        device.unlink()
        os.close(ours)
        os.close(theirs)

    def hear(ours: int, text: bytes) -> bool:
        arrived.clear()
        os.write(ours, text)
        return arrived.wait(WAIT_S)

    cable = plug()
    link = Link(f"{device},115200", take)
    assert hear(cable[0], b"before")
    pull(*cable)
    for _ in range(40):  # an estimate every 20 ms, whether there is a cable or not
        link.send(b"lost")
        time.sleep(0.02)
    cable = plug()
    wait_until(lambda: link.reopened > 0)
    assert hear(cable[0], b"after")
    link.send(b"there")
    assert os.read(cable[0], 100) == b"there"
    link.close()
    pull(*cable)
    assert b"".join(received) == b"beforeafter"
    assert link.reopened == 1


@pytest.mark.parametrize("address", ["udpin:nowhere", "tcp:127.0.0.1", "/dev/not-there,57600", "what"])
def test_an_address_that_cannot_be_is_refused(address: str) -> None:
    with pytest.raises(InputError, match=r"cannot be opened.*give udpin"):
        Link(address, lambda data: None)


# The session and the command


def _session(source: Any, **values: Any) -> LiveSession:
    port = _free_port(socket.SOCK_DGRAM)
    return LiveSession(f"udpin:127.0.0.1:{port}", source, CAMERA, live_config(None), **values)


class Shown:
    """A camera that shows the same few pictures as fast as they are taken."""

    is_live = False

    def __init__(self, n: int, size: tuple[int, int] = (120, 160)) -> None:
        self._n, self._size = n, size

    def pictures(self, stop: threading.Event) -> Iterator[Picture]:
        for k in range(self._n):
            image = np.random.default_rng(k).integers(0, 255, self._size).astype(np.uint8)
            yield Picture(time.time_ns(), None if k == 3 else image)


class Hovering:
    """A camera that sees the same all the time, with some noise."""

    is_live = False

    def __init__(self, image: Any, n: int) -> None:
        self._image, self._n = image, n

    def pictures(self, stop: threading.Event) -> Iterator[Picture]:
        rng = np.random.default_rng(1)
        for _ in range(self._n):
            stop.wait(0.05)
            noisy = self._image + rng.normal(0.0, 2.0, self._image.shape)
            yield Picture(time.time_ns(), np.clip(noisy, 0, 255).astype(np.uint8))


def test_too_many_pictures_are_dropped_and_counted() -> None:
    session = _session(Shown(300))
    session.run()
    s = session.statistics
    assert s.frames + s.frames_dropped == 300
    assert s.frames_dropped > 0
    assert session.core.estimator.counters["frame"] == s.frames


def test_pictures_of_another_size_than_calibrated_are_refused() -> None:
    with pytest.raises(InputError, match="160x120"):
        _session(Shown(5, (100, 100))).run()


def test_it_ends_when_told_to() -> None:
    session = _session(Shown(0))
    threading.Timer(0.3, session.stop).start()
    session.run(duration_s=WAIT_S)
    assert session.statistics.estimates < WAIT_S * 50


def test_a_client_of_foxglove_is_shown_pictures_lines_and_estimates() -> None:
    pytest.importorskip("foxglove")
    pytest.importorskip("tornado")
    from fusion.live.view import FoxgloveViewer

    corridor = to_grey(next(office_views(CAMERA, 1, seed=2)).image)
    viewer = FoxgloveViewer(port=0)
    shown: dict[str, list[dict[str, Any]]] = {}
    client = threading.Thread(target=asyncio.run, args=(_watch(viewer.port, shown),))
    client.start()
    session = _session(Hovering(corridor, 40), viewer=viewer)
    session.run()
    client.join(WAIT_S)
    assert session.statistics.frames == 40
    picture = shown["/camera/image"][-1]
    jpeg = np.frombuffer(base64.b64decode(picture["data"]), np.uint8)
    seen = cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE)
    assert seen is not None
    assert np.abs(seen.astype(float) - corridor).mean() < 10.0
    assert shown["/camera/overlay"][-1]["points"]
    assert "tracking" in {estimate["status"] for estimate in shown["/corridor/estimate"]}


async def _watch(port: int, shown: dict[str, list[dict[str, Any]]]) -> None:
    """Do as Foxglove does: subscribe to all channels, and take their messages until the server ends."""
    from tornado.websocket import websocket_connect

    url = f"ws://127.0.0.1:{port}"
    socket_ = await websocket_connect(url, subprotocols=["foxglove.sdk.v1", "foxglove.websocket.v1"])
    topics: dict[int, str] = {}
    while (message := await socket_.read_message()) is not None:
        if isinstance(message, bytes):
            if message[0] == 1:  # opcode, subscription, time, content
                shown.setdefault(topics[struct.unpack_from("<I", message, 1)[0]], []).append(
                    json.loads(message[13:])
                )
            continue
        told = json.loads(message)
        if told["op"] == "advertise":
            new = {channel["id"]: channel["topic"] for channel in told["channels"]}
            topics |= new
            wanted = [{"id": number, "channelId": number} for number in new]
            await socket_.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))


def test_the_command_runs_and_says_how_it_went(tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for k in range(8):
        _save(pictures / f"{10**18 + k * 50_000_000}.png", 100)
    calibration = tmp_path / "cam.yaml"
    calibration.write_text(camera_yaml(CAMERA))
    port = _free_port(socket.SOCK_DGRAM)
    record = tmp_path / "flight.mcap"
    done = run(
        "live", str(pictures), "--camera", str(calibration), "--link", f"udpin:127.0.0.1:{port}",
        "--record", str(record),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "none heard" in done.stdout
    assert "latency" in done.stdout
    assert replay(record).is_exact
    again = run("live", str(pictures), "--camera", str(calibration), "--record", str(record))
    assert again.returncode == 2
    assert "choose another --record" in again.stderr


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("--rate", "0"), "rate_hz"),
        (("--position", "perhaps"), "send_position"),
        (("--link", "nowhere"), "cannot be opened"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path: Path, arguments: tuple[str, ...], what: str) -> None:
    calibration = tmp_path / "cam.yaml"
    calibration.write_text(camera_yaml(CAMERA))
    (tmp_path / "camera").mkdir()
    done = run("live", str(tmp_path / "camera"), "--camera", str(calibration), *arguments)
    assert done.returncode == 2
    assert what in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_link_that_is_refused_leaves_no_recording(tmp_path: Path) -> None:
    calibration, record = tmp_path / "cam.yaml", tmp_path / "flight.mcap"
    calibration.write_text(camera_yaml(CAMERA))
    (tmp_path / "camera").mkdir()
    folder = str(tmp_path / "camera")
    done = run("live", folder, "--camera", str(calibration), "--link", "what", "--record", str(record))
    assert done.returncode == 2
    assert not record.exists()


def test_settings_survive_json() -> None:
    settings = LiveSettings(rate_hz=30.0, use_velocity=True)
    assert LiveSettings(**json.loads(settings.model_dump_json())) == settings
