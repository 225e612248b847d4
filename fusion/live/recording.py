"""All input and output of `corridor live`, in order, as one MCAP file.

Messages are those of ROS 2, so that viewers, `corridor fuse`, `corridor inspect` and ``ros2 bag`` can read it:
pictures, IMU, attitude and distance as the estimator received them, each estimate, and all MAVLink packets.
Calibration and settings are attached. Messages are in the order of processing; their log time is the time of
processing by the computer's clock.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.estimator.config import FusionConfig
from fusion.estimator.estimate import Estimate
from fusion.estimator.tables import ESTIMATE_COLUMNS, estimate_row
from fusion.files import error_text
from fusion.live.samples import Distance, Imu, Orientation, Velocity
from fusion.live.settings import LiveSettings
from fusion.logs.rosbag.attachments import CAMERA, CONFIG, MARK, SETTINGS
from fusion.settings.toml import config_toml
from vision import Camera, InputError

PICTURE, IMU, ATTITUDE, VELOCITY, RANGE = (
    "/camera/image",
    "/autopilot/imu",
    "/autopilot/attitude",
    "/autopilot/velocity",
    "/autopilot/range",
)
RECEIVED, SENT, ESTIMATE, UNREADABLE = (
    "/mavlink/in",
    "/mavlink/out",
    "/corridor/estimate",
    "/camera/unreadable",
)
PACKET_TYPE, ESTIMATE_TYPE = "corridor_fusion/msg/Packet", "corridor_fusion/msg/Estimate"
TYPES = {
    PICTURE: "sensor_msgs/msg/Image",
    IMU: "sensor_msgs/msg/Imu",
    ATTITUDE: "sensor_msgs/msg/Imu",
    VELOCITY: "geometry_msgs/msg/TwistStamped",
    RANGE: "sensor_msgs/msg/Range",
    RECEIVED: PACKET_TYPE,
    SENT: PACKET_TYPE,
    ESTIMATE: ESTIMATE_TYPE,
    UNREADABLE: "std_msgs/msg/Header",
}
_ROS_NAMES = {"i8": "int64", "i4": "int32", "f8": "float64"}
MOST_WAITING = 2000  # messages, if the disk is slow
BODY, CAMERA_FRAME, DOWN_FRAME = "base_link", "camera", "range_down"
_NO_DATA = -1.0  # first covariance of a missing part of sensor_msgs/Imu

Write = Callable[[], Any]


def typestore() -> Any:
    """Message types of ROS 2 and those defined in this file.

    Raises
    ------
    InputError
        If rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise InputError(
            "a recording is written with rosbags and mcap", remedy="pip install 'corridor-fusion[live]'"
        ) from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    columns = [f"{_ROS_NAMES.get(c.type, 'string')} {c.name}" for c in ESTIMATE_COLUMNS]
    store.register(get_types_from_msg("uint8[] data\n", PACKET_TYPE))
    store.register(get_types_from_msg("\n".join(columns) + "\n", ESTIMATE_TYPE))
    return store


class Recorder:
    """Writes a recording in a separate thread; also a `fusion.live.core.SampleSink`.

    Parameters
    ----------
    path
        The file; an existing file is not overwritten.
    config, camera, settings
        Of the estimator and the core.

    Raises
    ------
    InputError
        If it cannot be written.
    """

    def __init__(self, path: Path, config: FusionConfig, camera: Camera, settings: LiveSettings) -> None:
        self.lost = 0
        self._path, self._store = path, typestore()
        self._types: Any = self._store.types
        self._now_ns = 0
        self._pending: queue.Queue[tuple[str, int, int, Write] | None] = queue.Queue(maxsize=MOST_WAITING)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except OSError as error:
            raise InputError(
                f"cannot be written: {error_text(error)}", file=path, remedy="choose another --record"
            ) from error
        self._begin(config, camera, settings)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def _begin(self, config: FusionConfig, camera: Camera, settings: LiveSettings) -> None:
        from mcap.writer import CompressionType, Writer

        self._writer: Any = Writer(self._file, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2", library=f"corridor-fusion {version('corridor-fusion')}")
        files = {
            MARK: version("corridor-fusion"),
            CAMERA: camera_yaml(camera),
            CONFIG: config_toml(config, "Settings in flight."),
            SETTINGS: settings.model_dump_json(),
        }
        for name, text in files.items():
            self._writer.add_attachment(0, 0, name, "text/plain", text.encode())
        schemas = {}
        for kind in dict.fromkeys(TYPES.values()):
            definition, _ = self._store.generate_msgdef(kind, ros_version=2)
            schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition.encode())
        self._channels = {
            topic: self._writer.register_channel(topic, "cdr", schemas[kind]) for topic, kind in TYPES.items()
        }

    # What happens, in order

    def received(self, now_ns: int, data: bytes) -> None:
        """Record bytes received on the link; their samples follow."""
        self._now_ns = now_ns
        self._put(RECEIVED, now_ns, lambda: self._packet(data))

    def sent(self, now_ns: int, data: bytes) -> None:
        """Record a sent packet."""
        self._put(SENT, now_ns, lambda: self._packet(data))

    def picture(self, now_ns: int, t_ns: int, image: npt.NDArray[np.uint8] | None) -> None:
        """Record a grey picture (h, w) whose lines the estimator receives now."""
        if image is None:
            self._put(UNREADABLE, now_ns, lambda: self._header(t_ns, CAMERA_FRAME), t_ns)
            return
        height, width = image.shape
        picture = self._types[TYPES[PICTURE]]
        self._put(
            PICTURE,
            now_ns,
            lambda: picture(
                self._header(t_ns, CAMERA_FRAME),
                height,
                width,
                "mono8",
                0,
                width,
                np.ascontiguousarray(image).ravel(),
            ),
            t_ns,
        )

    def estimate(self, now_ns: int, e: Estimate) -> None:
        """Record a tick and its estimate."""
        kind = self._types[ESTIMATE_TYPE]
        self._put(ESTIMATE, now_ns, lambda: kind(*estimate_row(e)))

    def imu(self, t_ns: int, sample: Imu) -> None:
        """Record an IMU sample."""
        zero = np.zeros(9)
        no_attitude = np.array([_NO_DATA, *[0.0] * 8])
        force = sample.accel_m_s2
        no_force = no_attitude if force is None else zero

        def make() -> Any:
            return self._types[TYPES[IMU]](
                self._header(t_ns, BODY),
                self._quaternion((1.0, 0.0, 0.0, 0.0)),
                no_attitude,
                self._vector(sample.gyro_rad_s),
                zero,
                self._vector(force or (0.0, 0.0, 0.0)),
                no_force,
            )

        self._put(IMU, self._now_ns, make, t_ns)

    def attitude(self, t_ns: int, sample: Orientation) -> None:
        """Record an attitude, as an IMU message without the other parts."""
        no_data = np.array([_NO_DATA, *[0.0] * 8])
        none = (0.0, 0.0, 0.0)

        def make() -> Any:
            return self._types[TYPES[ATTITUDE]](
                self._header(t_ns, BODY),
                self._quaternion(sample.q_world_body),
                np.zeros(9),
                self._vector(none),
                no_data,
                self._vector(none),
                no_data,
            )

        self._put(ATTITUDE, self._now_ns, make, t_ns)

    def velocity(self, t_ns: int, sample: Velocity) -> None:
        """Record a velocity in the body."""

        def make() -> Any:
            twist = self._types["geometry_msgs/msg/Twist"](
                self._vector(sample.v_body_m_s), self._vector((0.0, 0.0, 0.0))
            )
            return self._types[TYPES[VELOCITY]](self._header(t_ns, BODY), twist)

        self._put(VELOCITY, self._now_ns, make, t_ns)

    def distance(self, t_ns: int, sample: Distance) -> None:
        """Record a distance to the floor."""

        def make() -> Any:
            return self._types[TYPES[RANGE]](
                self._header(t_ns, DOWN_FRAME), 1, 0.1, 0.0, 1000.0, sample.distance_m
            )

        self._put(RANGE, self._now_ns, make, t_ns)

    def close(self) -> None:
        """Write the waiting messages and the index."""
        self._pending.put(None)
        self._thread.join()

    def discard(self) -> None:
        """Close and delete the file of a run that never started."""
        self.close()
        self._path.unlink()

    def _put(self, topic: str, now_ns: int, make: Write, t_ns: int | None = None) -> None:
        try:
            self._pending.put_nowait((topic, now_ns, now_ns if t_ns is None else t_ns, make))
        except queue.Full:
            self.lost += 1

    def _run(self) -> None:
        while (item := self._pending.get()) is not None:
            topic, now_ns, t_ns, make = item
            data = bytes(self._store.serialize_cdr(make(), TYPES[topic]))
            try:
                self._writer.add_message(self._channels[topic], now_ns, data, max(t_ns, 0))
            except (OSError, ValueError):  # disk full or removed
                self.lost += 1
        try:
            self._writer.finish()
            self._file.close()
        except (OSError, ValueError):
            self.lost += 1

    # Parts of messages, from FRD to x forward, y left, z up

    def _packet(self, data: bytes) -> Any:
        return self._types[PACKET_TYPE](np.frombuffer(data, np.uint8))

    def _header(self, t_ns: int, frame: str) -> Any:
        seconds, nanoseconds = divmod(max(t_ns, 0), 1_000_000_000)
        time = self._types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
        return self._types["std_msgs/msg/Header"](time, frame)

    def _vector(self, v: tuple[float, float, float]) -> Any:
        return self._types["geometry_msgs/msg/Vector3"](v[0], -v[1], -v[2])

    def _quaternion(self, q: tuple[float, float, float, float]) -> Any:
        w, x, y, z = q
        return self._types["geometry_msgs/msg/Quaternion"](x, -y, -z, w)


def camera_yaml(camera: Camera) -> str:
    """Write a calibration in EuRoC's format, with all digits, in body FRD."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = camera.R_body_camera, camera.p_body_camera_m
    values: dict[str, Any] = {
        "camera_model": "pinhole",
        "resolution": [camera.width_px, camera.height_px],
        "intrinsics": [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
        "T_BS": {"rows": 4, "cols": 4, "data": transform.ravel().tolist()},
        "line_delay": camera.line_delay_s,
    }
    model = {"radtan": "radial-tangential"}.get(str(camera.distortion), str(camera.distortion))
    values |= {"distortion_model": model, "distortion_coefficients": list(camera.coefficients)}
    if camera.exposure_s == camera.exposure_s:
        values["exposure_s"] = camera.exposure_s
    return "".join(f"{name}: {_yaml(value)}\n" for name, value in values.items())


def _yaml(value: Any) -> str:
    import json

    return value if isinstance(value, str) else json.dumps(value)
