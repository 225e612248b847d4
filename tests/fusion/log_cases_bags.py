"""Bags as drivers and recorders write them: one thing in each is not as it should be."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import degrees
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.fusion.log_cases import FLU, Case, Part
from tests.fusion.test_log_rosbag import Bag

IMU, PICTURES, INFO = "/imu", "/cam/image_raw", "/cam/camera_info"
G = 9.80665

Message = tuple[int, str, Any]  # receipt, topic, message
Change = Callable[[int, int], int]  # of a time, by its number
Imu = Callable[[Part, Bag], Iterable[Message]]
Pictures = Callable[[Part, Bag], Iterable[Message]]


def imu_rows(part: Part, bag: Bag, **units: float) -> list[Message]:
    """Every sample in ROS's axes, times factors ``gyro`` and ``accel``."""
    scale = {"gyro": 1.0, "accel": 1.0} | units
    rows = zip(
        part.t_ns.tolist(), part.gyro * FLU * scale["gyro"], part.accel * FLU * scale["accel"], strict=True
    )
    return [(t, IMU, bag.imu(t, gyro, accel)) for t, gyro, accel in rows]


def picture_rows(part: Part, bag: Bag) -> list[Message]:
    """Every picture, as it is."""
    rows = zip(part.frames_ns.tolist(), part.pictures, strict=True)
    return [(t, PICTURES, bag.image(t, picture)) for t, picture in rows]


def info_rows(
    part: Part, bag: Bag, model: str = "plumb_bob", D: Any = (0.0,) * 5, focal: float = 1.0
) -> list[Message]:
    """Every calibration."""
    c = part.camera
    lens = (c.fx_px * focal, c.fy_px * focal, c.cx_px * focal, c.cy_px * focal)
    return [
        (t, INFO, bag.camera_info(t, c.width_px, c.height_px, lens, model, np.array(D)))
        for t in part.frames_ns.tolist()
    ]


def bag(
    imu: Imu = imu_rows,
    pictures: Pictures = picture_rows,
    info: Pictures = info_rows,
    *,
    also: Imu | None = None,
) -> Callable[[Part, Path], Path]:
    """Return what writes a bag of these messages, in the order of their receipt."""

    def build(part: Part, folder: Path) -> Path:
        path = folder / "drive.bag"
        with Bag(path, "ros1") as file:
            rows = [*imu(part, file), *pictures(part, file), *info(part, file)]
            rows += [] if also is None else also(part, file)
            for received_ns, topic, message in sorted(rows, key=lambda row: row[0]):
                file.write(topic, message, received_ns)
        return path

    return build


def changed(make: Callable[[Any, int], Any], encoding: str) -> Pictures:
    """Pictures of another encoding: ``make`` gets the picture and its number."""
    return lambda part, bag: [
        (t, PICTURES, bag.image(t, make(picture, k), encoding))
        for k, (t, picture) in enumerate(zip(part.frames_ns.tolist(), part.pictures, strict=True))
    ]


def packed(make: Callable[[Any], bytes], form: str) -> Pictures:
    """Pictures as files."""
    return lambda part, bag: [
        (t, PICTURES + "/compressed", bag.compressed(t, make(picture), form))
        for t, picture in zip(part.frames_ns.tolist(), part.pictures, strict=True)
    ]


def encoded(ending: str, picture: Any) -> bytes:
    """A picture as the bytes of a file."""
    return bytes(cv2.imencode(ending, picture)[1])


def mosaic(picture: Any) -> Any:
    """What a sensor with colour filters sees of it."""
    gains = np.tile([[0.55, 1.0], [1.0, 0.75]], (picture.shape[0] // 2, picture.shape[1] // 2))
    return np.clip(picture * gains, 0, 255).astype(np.uint8)


def restamped(
    rows: Iterable[Message], stamp: Callable[[int, int], int], receipt: Callable[[int, int], int]
) -> list[Message]:
    """Messages with another stamp and receipt, each from the number and the time."""
    found = []
    for k, (t, topic, message) in enumerate(rows):
        stamped = stamp(k, t)
        time = message.header.stamp
        object.__setattr__(time, "sec", stamped // 10**9)
        object.__setattr__(time, "nanosec", stamped % 10**9)
        found.append((receipt(k, t), topic, message))
    return found


def bursts(n: int, gap_ns: int) -> Imu:
    """Samples that a driver stamps when it empties its buffer."""

    def imu(part: Part, bag: Bag) -> list[Message]:
        def at(k: int, t: int) -> int:
            return int(part.t_ns[min(len(part.t_ns) - 1, k // n * n + n - 1)]) + k % n * gap_ns

        return restamped(imu_rows(part, bag), at, at)

    return imu


def split(part: Part, bag: Bag) -> list[Message]:
    """Gyroscope and accelerometer in two topics, the second at half the rate."""
    rows = list(zip(part.t_ns.tolist(), part.gyro * FLU, part.accel * FLU, strict=True))
    gyro = [(t, "/camera/gyro/sample", bag.imu(t, g, (0, 0, 0))) for t, g, _ in rows]
    return gyro + [(t, "/camera/accel/sample", bag.imu(t + 10**6, (0, 0, 0), a)) for t, _, a in rows[::2]]


def by_turns(unknown: bool) -> Imu:
    """One sensor at a time, the other zero, marked by a covariance of -1 or not."""

    def imu(part: Part, bag: Bag) -> list[Message]:
        none = None if unknown else (0, 0, 0)
        rows = enumerate(zip(part.t_ns.tolist(), part.gyro * FLU, part.accel * FLU, strict=True))
        return [(t, IMU, bag.imu(t, g, none) if k % 2 else bag.imu(t, none, a)) for k, (t, g, a) in rows]

    return imu


def oriented(order: Any, signs: Any = (1, 1, 1, 1)) -> Imu:
    """With an orientation whose parts w, x, y, z are put in another order, or signs."""

    def imu(part: Part, bag: Bag) -> list[Message]:
        q = part.q * np.array([1.0, *FLU])
        index = np.clip(np.searchsorted(part.attitude_ns, part.t_ns), 0, len(q) - 1)
        wrong = q[index][:, list(order)] * np.array(signs)
        rows = zip(part.t_ns.tolist(), part.gyro * FLU, part.accel * FLU, wrong, strict=True)
        return [(t, IMU, bag.imu(t, g, a, quaternion)) for t, g, a, quaternion in rows]

    return imu


def looped(rows: Callable[[Part, Bag], list[Message]]) -> Imu:
    """Five seconds that were played twice while recording: headers start over."""

    def twice(part: Part, bag: Bag) -> list[Message]:
        end_ns = int(part.t_ns[0]) + 5 * 10**9
        once = [row for row in rows(part, bag) if row[0] < end_ns]
        return once + [(t + 5 * 10**9, topic, message) for t, topic, message in once]

    return twice


def jittered(part: Part, bag: Bag) -> list[Message]:
    """Stamps of user space, 4 ms off, some in the wrong order."""
    off = np.random.default_rng(1).normal(0.0, 4e6, len(part.t_ns))
    return restamped(imu_rows(part, bag), lambda k, t: t + int(off[k]), lambda k, t: t)


def fast(part: Part, bag: Bag) -> list[Message]:
    """An IMU whose clock runs one percent fast."""
    start = int(part.t_ns[0])
    return restamped(imu_rows(part, bag), lambda k, t: start + int((t - start) * 1.01), lambda k, t: t)


def plain(part: Part, gyro: Any, accel: Any, topic: str = IMU) -> Imu:
    """Samples as they are given."""
    return lambda _, bag: [
        (t, topic, bag.imu(t, g, a)) for t, g, a in zip(part.t_ns.tolist(), gyro, accel, strict=True)
    ]


def with_another_imu(part: Part, bag: Bag) -> list[Message]:
    """A second IMU, of the camera."""
    return list(plain(part, 0.3 * part.gyro * FLU, part.accel * FLU, "/zed/imu")(part, bag))


def half(picture: Any, _: int) -> Any:
    """The picture at half its size."""
    return cv2.resize(picture, (picture.shape[1] // 2, picture.shape[0] // 2), interpolation=cv2.INTER_AREA)


LATE_NS = 60_000_000
CASES = {
    "depth of 12 bits": Case(bag(pictures=changed(lambda p, k: p.astype("<u2") << 4, "mono16"))),
    "depth of 12 bits, 16UC1": Case(bag(pictures=changed(lambda p, k: p.astype("<u2") << 4, "16UC1"))),
    "depth of 10 bits as PNG": Case(
        bag(pictures=packed(lambda p: encoded(".png", p.astype(np.uint16) << 2), "mono16; png compressed"))
    ),
    "a colour mosaic of 12 bits": Case(
        bag(pictures=changed(lambda p, k: mosaic(p).astype("<u2") << 4, "bayer_rggb16"))
    ),
    "a colour mosaic as JPEG": Case(
        bag(pictures=packed(lambda p: encoded(".jpg", mosaic(p)), "bayer_rggb8; jpeg compressed bayer_rggb8"))
    ),
    "pictures without stamps, received late": Case(
        bag(pictures=lambda p, b: restamped(picture_rows(p, b), lambda k, t: 0, lambda k, t: t + LATE_NS)),
        caused="ms too late",
        dense=True,
    ),
    "some pictures without stamps": Case(
        bag(
            pictures=lambda p, b: restamped(
                picture_rows(p, b), lambda k, t: t if k > 15 else 0, lambda k, t: t + LATE_NS // 2
            )
        )
    ),
    "an IMU on its boot clock": Case(
        bag(
            lambda p, b: restamped(
                imu_rows(p, b), lambda k, t: t - int(p.t_ns[0]) + 12_345 * 10**9, lambda k, t: t + 2 * 10**6
            )
        )
    ),
    "gyroscope and accelerometer apart": Case(bag(split)),
    "one sensor at a time": Case(bag(by_turns(unknown=False))),
    "one sensor at a time, marked": Case(bag(by_turns(unknown=True))),
    "no gyroscope": Case(
        bag(
            lambda p, b: [
                (t, IMU, b.imu(t, None, a)) for t, a in zip(p.t_ns.tolist(), p.accel * FLU, strict=True)
            ]
        ),
        gyro=False,
        dense=True,
    ),
    "degrees per second": Case(
        bag(lambda p, b: imu_rows(p, b, gyro=degrees(1.0))), refused="it is in degrees/s, not rad/s"
    ),
    "g": Case(bag(lambda p, b: imu_rows(p, b, accel=1 / G)), refused="the accelerometer is in g"),
    "counts of an MPU-6050": Case(
        bag(lambda p, b: imu_rows(p, b, gyro=16.4 * degrees(1.0), accel=2048 / G)),
        refused="the accelerometer is in counts, 2048 to a g",
    ),
    "feet per second squared": Case(
        bag(lambda p, b: imu_rows(p, b, accel=1 / 0.3048)), refused="the accelerometer is in another unit"
    ),
    "axes forward, right, down": Case(
        bag(lambda p, b: plain(p, p.gyro, p.accel)(p, b)), refused="y and z of its axes point the other way"
    ),
    "gravity's pull": Case(
        bag(lambda p, b: imu_rows(p, b, accel=-1.0)),
        refused="y and z of its axes point the other way",
        caused="turns are opposite",
        dense=True,
    ),
    "quaternion in another order": Case(
        bag(oriented((1, 2, 3, 0))), refused="its quaternions are written in the order"
    ),
    "yaw the other way": Case(
        bag(oriented((0, 1, 2, 3), (1, 1, 1, -1))), refused="turn against the gyroscope"
    ),
    "conjugated quaternions": Case(
        bag(oriented((0, 1, 2, 3), (1, -1, -1, -1))), refused="turn against the gyroscope"
    ),
    "fourteen coefficients": Case(
        bag(info=lambda p, b: info_rows(p, b, "rational_polynomial", (0.001, 0, 0, 0, 0, 0.001, *(0,) * 8)))
    ),
    "five coefficients of eight": Case(
        bag(info=lambda p, b: info_rows(p, b, "rational_polynomial", (0.001, 0, 0, 0, 0)))
    ),
    "a calibration of zeros": Case(
        bag(info=lambda p, b: info_rows(p, b, "", (), 0.0)), refused="contains no calibration of the camera"
    ),
    "pictures of half the size": Case(bag(pictures=changed(half, "mono8")), refused="picture is 320x240"),
    "stamps that repeat": Case(
        bag(
            lambda p, b: restamped(imu_rows(p, b), lambda k, t: int(p.t_ns[k - (k % 3 == 2)]), lambda k, t: t)
        )
    ),
    "bursts of ten": Case(bag(bursts(10, 20_000))),
    "bursts of three": Case(bag(bursts(3, 150_000))),
    "stamps that jitter": Case(bag(jittered)),
    "a recording of a loop": Case(bag(looped(imu_rows), looped(picture_rows), looped(info_rows))),
    "a camera upside down": Case(
        bag(pictures=changed(lambda p, k: np.ascontiguousarray(p[::-1, ::-1]), "mono8")),
        caused="turns are opposite",
        dense=True,
    ),
    "a clock one percent fast": Case(bag(fast), caused="% slower", gyro_scale=1.01, dense=True),
    "video without a beginning": Case(
        bag(pictures=packed(lambda p: b"\0\0\0\1\x67\x42" + bytes(200), "h264")),
        refused="begins a picture of its own",
        followed=False,
    ),
    "two IMUs": Case(bag(also=with_another_imu), refused="holds 2 IMUs"),
}
