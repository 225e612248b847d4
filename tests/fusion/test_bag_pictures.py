"""Pictures in bags that are not plain 8-bit ones: sensors of 10 and 12 bits, video streams, clocks partly set."""

from __future__ import annotations

import pickle
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from fusion.flight import FrameStream
from fusion.logs import load_flight, open_log
from tests.files import OFFICE
from tests.fusion.test_log_rosbag import START_NS, Bag
from vision import InputError
from vision.images import GreyImage

pytest.importorskip("rosbags")

STEP_NS = 50_000_000
N = 24


@pytest.fixture(scope="module")
def pictures() -> list[GreyImage]:
    frames = load_flight(OFFICE).frames
    return [
        np.asarray(cv2.resize(frames.read(i), (160, 120), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        for i in range(N)
    ]


def frames_of(path: Path) -> FrameStream:
    log = open_log(path)
    return log.frames(log.topics[0].name).value


def sensor(picture: GreyImage, bits: int) -> npt.NDArray[np.uint16]:
    return np.asarray(picture.astype(np.uint16) << (bits - 8), dtype=np.uint16)


@pytest.mark.parametrize("bits", [10, 12, 16])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1", "png"])
def test_pictures_of_16_bits_are_read_by_the_depth_they_fill(
    pictures: list[GreyImage], tmp_path: Path, bits: int, encoding: str
) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for i, picture in enumerate(pictures):
            t_ns, words = START_NS + i * STEP_NS, sensor(picture, bits)
            if encoding == "png":
                data = cv2.imencode(".png", words)[1].tobytes()
                bag.write("/cam/compressed", bag.compressed(t_ns, data, "mono16; png compressed "), t_ns)
            else:
                bag.write("/cam", bag.image(t_ns, words, encoding), t_ns)
    frames = frames_of(tmp_path / "bag")
    np.testing.assert_array_equal(frames.read(5), pictures[5])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(frames.source)).read(7), pictures[7])


def test_distances_are_no_pictures(pictures: list[GreyImage], tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for name in ("/camera/depth/image_rect_raw", "/camera/infra/image"):
            bag.write(name, bag.image(START_NS, sensor(pictures[0], 12), "16UC1"), START_NS)
    log = open_log(tmp_path / "bag")
    assert [topic.name for topic in log.topics] == ["/camera/infra/image"]
    assert log.problems == ("/camera/depth/image_rect_raw: pictures of distances (16UC1) left out",)


# --- video streams -----------------------------------------------------------------------------------------------


def stream(pictures: list[GreyImage], codec: str, b_frames: int = 0) -> list[bytes]:
    """Packets of a video, a key frame every eight."""
    av = pytest.importorskip("av")
    encoder = av.CodecContext.create({"h264": "libx264", "h265": "libx265"}[codec], "w")
    encoder.width, encoder.height, encoder.pix_fmt = 160, 120, "yuv420p"
    encoder.time_base, encoder.framerate, encoder.gop_size = Fraction(1, 20), Fraction(20), 8
    encoder.max_b_frames = b_frames
    encoder.options = {"crf": "14", "tune": "zerolatency"} if not b_frames else {"crf": "14"}
    if codec == "h265":
        encoder.options |= {"x265-params": "log-level=none:repeat-headers=1"}
    packets = []
    for i, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(picture, format="gray").reformat(format="yuv420p")
        frame.pts = i
        packets += [bytes(packet) for packet in encoder.encode(frame)]
    return packets + [bytes(packet) for packet in encoder.encode(None)]


def video_bag(path: Path, packets: list[bytes], form: str) -> Path:
    with Bag(path, "sqlite3") as bag:
        for i, data in enumerate(packets):
            t_ns = START_NS + i * STEP_NS
            bag.write("/cam/compressed", bag.compressed(t_ns, data, form), t_ns)
    return path


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_a_video_stream_is_decoded_in_any_order(
    pictures: list[GreyImage], tmp_path: Path, codec: str
) -> None:
    path = video_bag(tmp_path / "bag", stream(pictures, codec), codec)
    frames = frames_of(path)
    for i in [*range(N), 3, 20, 8, 9, 0, N - 1]:
        nearest = min(
            range(N), key=lambda k: float(np.abs(frames.read(i).astype(float) - pictures[k]).mean())
        )
        assert nearest == i
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(frames.source)).read(7), frames.read(7))


def test_pictures_before_the_first_key_frame_and_damaged_ones(
    pictures: list[GreyImage], tmp_path: Path
) -> None:
    packets = stream(pictures, "h264")
    path = video_bag(tmp_path / "bag", packets[3:], "h264")
    log = open_log(path)
    frames, problems = log.frames("/cam/compressed")
    assert problems == ("/cam/compressed: 5 pictures before the first key frame cannot be decoded",)
    with pytest.raises(InputError, match="predicted from a key frame"):
        frames.read(4)
    assert np.abs(frames.read(5).astype(float) - pictures[8]).mean() < 3
    with pytest.raises(
        InputError, match=r"none of its 2 packets of h264 begins a picture of its own \(record"
    ):
        open_log(video_bag(tmp_path / "none", packets[1:3], "h264")).frames("/cam/compressed")


# --- clocks and bags that hold no sensor -------------------------------------------------------------------------


def test_headers_that_are_partly_empty_take_the_receipt_less_the_usual_delay(
    pictures: list[GreyImage], tmp_path: Path
) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for i, picture in enumerate(pictures):
            t_ns = START_NS + i * STEP_NS
            bag.write("/cam", bag.image(0 if i < 6 else t_ns, picture), t_ns + 30_000_000)
    frames, problems = open_log(tmp_path / "bag").frames("/cam")
    np.testing.assert_array_equal(frames.t_ns, START_NS + STEP_NS * np.arange(N))
    assert problems == (
        "/cam: 6 headers without time; taken from the receipt, less the usual delay of 30.0 ms",
    )


def test_a_bag_of_transforms_is_named_as_that(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        stamped = bag.types["geometry_msgs/msg/TransformStamped"](
            header=bag.header(START_NS, "base_link"),
            child_frame_id="cam",
            transform=bag.types["geometry_msgs/msg/Transform"](
                translation=bag.vector((0, 0, 0)), rotation=bag.quaternion((1, 0, 0, 0))
            ),
        )
        bag.write("/tf_static", bag.types["tf2_msgs/msg/TFMessage"](transforms=[stamped]), START_NS)
    with pytest.raises(InputError, match="holds transforms, but no pictures and no IMU"):
        open_log(tmp_path / "bag")


def test_another_serialization_is_named(pictures: list[GreyImage], tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with Bag(path, "sqlite3") as bag:
        bag.write("/cam", bag.image(START_NS, pictures[0]), START_NS)
    metadata = path / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace("serialization_format: cdr", "serialization_format: xcdr9")
    )
    with pytest.raises(InputError, match=r"serialized as xcdr9, not as cdr|'xcdr9'"):
        open_log(path)
