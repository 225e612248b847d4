"""ROS bags: a flight folder written as bags by rosbags and read back, hand-made messages, and real bags."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.flight import Flight
from fusion.logs import load_flight
from fusion.logs.contents import Kind
from fusion.logs.rosbag import bag as rosbag
from fusion.logs.rosbag.frames import StaticFrames
from fusion.logs.rosbag.messages import camera_from_info
from fusion.logs.rosbag.pictures import grey
from tests.files import ROOT, SHARED
from tests.fusion import damage
from tests.fusion.reading import Told
from vision import InputError
from vision.cameras.camera import Distortion
from vision.images import read_image, to_grey

pytest.importorskip("rosbags")

from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

REAL = SHARED / "logs" / "ros1"
SECONDS = 2.0
FORMATS = ("ros1", "ros1-lz4", "sqlite3", "mcap", "mcap-zstd")
LATE_NS = 3_000_000  # between taking and receiving
FLU = np.array([1.0, -1.0, -1.0])
START_NS = 1_600_000_000_000_000_000


@dataclass
class Bag:
    """A bag under construction, of any of the formats."""

    path: Path
    kind: str

    def __enter__(self) -> Bag:
        self.ros1 = self.kind.startswith("ros1")
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self.types = self.store.types
        if self.ros1:
            self.writer: Any = rosbag1.Writer(self.path)
            if "lz4" in self.kind:
                self.writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
        else:
            plugin = rosbag2.StoragePlugin.MCAP if "mcap" in self.kind else rosbag2.StoragePlugin.SQLITE3
            self.writer = rosbag2.Writer(self.path, version=9, storage_plugin=plugin)
            if "zstd" in self.kind:
                self.writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
        self.writer.open()
        self.topics: dict[str, Any] = {}
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def header(self, t_ns: int, frame_id: str = "base_link") -> Any:
        time = self.types["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id, **extra)

    def write(self, topic: str, message: Any, received_ns: int) -> None:
        kind = message.__msgtype__
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.topics[topic], received_ns, bytes(serialize(message, kind)))

    def vector(self, v: Any) -> Any:
        return self.types["geometry_msgs/msg/Vector3"](*(float(x) for x in v))

    def quaternion(self, q: Any) -> Any:
        w, x, y, z = (float(part) for part in q)
        return self.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)

    def pose(self, position: Any, q: Any) -> Any:
        point = self.types["geometry_msgs/msg/Point"](*(float(x) for x in position))
        return self.types["geometry_msgs/msg/Pose"](position=point, orientation=self.quaternion(q))

    def imu(self, t_ns: int, gyro: Any, accel: Any, q: Any = None) -> Any:
        """Say by a covariance of -1 what is None: no such data."""
        unknown = np.zeros(9)
        unknown[0] = -1.0
        return self.types["sensor_msgs/msg/Imu"](
            header=self.header(t_ns),
            orientation=self.quaternion((0.0, 0.0, 0.0, 0.0) if q is None else q),
            orientation_covariance=unknown if q is None else np.zeros(9),
            angular_velocity=self.vector((0, 0, 0) if gyro is None else gyro),
            angular_velocity_covariance=unknown if gyro is None else np.zeros(9),
            linear_acceleration=self.vector((0, 0, 0) if accel is None else accel),
            linear_acceleration_covariance=unknown if accel is None else np.zeros(9),
        )

    def compressed(self, t_ns: int, data: bytes, form: str = "jpeg") -> Any:
        return self.types["sensor_msgs/msg/CompressedImage"](
            header=self.header(t_ns, "camera"), format=form, data=np.frombuffer(data, np.uint8)
        )

    def image(self, t_ns: int, pixels: Any, encoding: str = "mono8") -> Any:
        height, width = pixels.shape[:2]
        return self.types["sensor_msgs/msg/Image"](
            header=self.header(t_ns, "camera"),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=pixels[0].nbytes,
            data=np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8),
        )

    def camera_info(self, t_ns: int, width: int, height: int, lens: Any, model: str, D: Any) -> Any:
        fx, fy, cx, cy = lens
        K = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], float)
        P = np.array([fx / 2, 0, cx + 1, 0, 0, fy / 2, cy + 1, 0, 0, 0, 1, 0], float)
        names = ("D", "K", "R", "P") if self.ros1 else ("d", "k", "r", "p")
        values = dict(zip(names, (np.array(D, float), K, np.eye(3).ravel(), P), strict=True))
        roi = self.types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.types["sensor_msgs/msg/CameraInfo"](
            header=self.header(t_ns, "camera"),
            height=height,
            width=width,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **values,
        )

    def transforms(self, *mounts: tuple[str, str, Any, Any]) -> Any:
        """Parent, child, place and rotation of each."""
        stamped = []
        for parent, child, place, rotation in mounts:
            transform = self.types["geometry_msgs/msg/Transform"](
                translation=self.vector(place),
                rotation=self.quaternion(rotation.as_quat(scalar_first=True)),
            )
            stamped.append(
                self.types["geometry_msgs/msg/TransformStamped"](
                    header=self.header(0, parent), child_frame_id=child, transform=transform
                )
            )
        return self.types["tf2_msgs/msg/TFMessage"](transforms=stamped)


def flat(path: Path, kind: str) -> Path:
    """The bag's own file: ROS 2 writes a folder around it."""
    if kind.startswith("ros1"):
        return path
    return next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))


@pytest.fixture(scope="module", params=FORMATS)
def office_bag(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, office: Flight
) -> Path:
    kind = str(request.param)
    path = tmp_path_factory.mktemp("bags") / ("office.bag" if kind.startswith("ros1") else kind)
    write_office(office, path, kind)
    return path


def write_office(
    office: Flight, path: Path, kind: str, seconds: float = SECONDS, *, plain: bool = True
) -> None:
    """The first seconds of the flight as a drone would record them: in the axes of ROS, stamps before receipt."""
    assert office.imu is not None
    assert office.attitude is not None
    end_ns = int(office.frames.t_ns[0] + seconds * 1e9)
    camera = office.camera
    with Bag(path, kind) as bag:
        events: list[tuple[int, str, Any]] = []
        for k, t_ns in enumerate(office.imu.t_ns[office.imu.t_ns < end_ns].tolist()):
            sample = office.imu.gyro_rad_s[k] * FLU, office.imu.accel_m_s2[k] * FLU
            events.append((t_ns, "/imu/data_raw", bag.imu(t_ns, *sample)))
        for k, t_ns in enumerate(office.attitude.t_ns[office.attitude.t_ns < end_ns].tolist()):
            q = office.attitude.q_world_body[k] * np.array([1.0, *FLU])
            events.append((t_ns, "/imu/data", bag.imu(t_ns, None, None, q)))
        lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
        files = sorted((ROOT / "data" / "office" / "mav0" / "cam0" / "data").iterdir())
        for k, t_ns in enumerate(office.frames.t_ns[office.frames.t_ns < end_ns].tolist()):
            size = (camera.width_px, camera.height_px)
            info = bag.camera_info(t_ns, *size, lens, "plumb_bob", np.zeros(5))
            events.append((t_ns, "/cam0/camera_info", info))
            data = bag.compressed(t_ns, files[k].read_bytes())
            events.append((t_ns, "/cam0/image_raw/compressed", data))
            if plain and k % 4 == 0:
                events.append((t_ns, "/cam0/image_raw", bag.image(t_ns, read_image(files[k]))))
        for t_ns, topic, message in sorted(events, key=lambda event: event[:2]):
            bag.write(topic, message, t_ns + LATE_NS)


def test_a_flight_comes_back_as_it_was(office: Flight, office_bag: Path) -> None:
    assert office.imu is not None
    assert office.attitude is not None
    assert rosbag.recognises(office_bag)
    log = rosbag.open_log(office_bag)
    problems = Told()
    imu = problems.take(log.imu("/imu/data_raw"))
    n = int(SECONDS * 200)
    np.testing.assert_array_equal(imu.t_ns, office.imu.t_ns[:n])
    np.testing.assert_allclose(imu.gyro_rad_s, office.imu.gyro_rad_s[:n], rtol=0, atol=1e-15)
    np.testing.assert_allclose(imu.accel_m_s2, office.imu.accel_m_s2[:n], rtol=0, atol=1e-14)
    attitude = problems.take(log.attitude("/imu/data"))
    n = int(SECONDS * 50)
    np.testing.assert_array_equal(attitude.t_ns, office.attitude.t_ns[:n])
    np.testing.assert_allclose(attitude.q_world_body, office.attitude.q_world_body[:n], rtol=0, atol=1e-15)
    frames = problems.take(log.frames("/cam0/image_raw/compressed"))
    n = int(SECONDS * 20)
    np.testing.assert_array_equal(frames.t_ns, office.frames.t_ns[:n])
    for k in (0, 1, 2, n - 1, 7, 7, 3):  # in any order, also twice
        np.testing.assert_array_equal(frames.read(k), office.frames.read(k))
    plain = problems.take(log.frames("/cam0/image_raw"))
    np.testing.assert_array_equal(plain.read(2), office.frames.read(8))
    camera = log.camera("/cam0/image_raw/compressed")
    assert camera is not None
    names = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    assert [getattr(camera, name) for name in names] == [getattr(office.camera, name) for name in names]
    assert camera.distortion is Distortion.NONE
    np.testing.assert_allclose(camera.R_body_camera, office.camera.R_body_camera, atol=1e-12)
    assert problems == []
    assert log.problems == ()


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_the_same_flight_is_loaded_from_a_bag(kind: str, office: Flight, tmp_path: Path) -> None:
    path = tmp_path / "office.bag"
    write_office(office, path, kind, seconds=1.0, plain=False)
    flight = load_flight(path)
    assert flight.problems == ()
    assert (flight.position, flight.velocity, flight.truth) == (None, None, None)
    for name, n in (("frames", 20), ("imu", 200), ("attitude", 50)):
        np.testing.assert_array_equal(getattr(flight, name).t_ns, getattr(office, name).t_ns[:n])
    assert flight.imu is not None
    assert office.imu is not None
    np.testing.assert_allclose(flight.imu.gyro_rad_s, office.imu.gyro_rad_s[:200], rtol=0, atol=1e-15)
    np.testing.assert_allclose(flight.imu.accel_m_s2, office.imu.accel_m_s2[:200], rtol=0, atol=1e-14)
    assert flight.attitude is not None
    assert office.attitude is not None
    q_world_body = office.attitude.q_world_body[:50]
    np.testing.assert_allclose(flight.attitude.q_world_body, q_world_body, rtol=0, atol=1e-15)
    for k in range(20):
        np.testing.assert_array_equal(flight.frames.read(k), office.frames.read(k))
    corners = [[0.0, 0.0], [639.0, 479.0]]
    np.testing.assert_array_equal(flight.camera.rays(corners), office.camera.rays(corners))


def test_topics_say_what_they_are(office_bag: Path) -> None:
    log = rosbag.open_log(office_bag)
    assert [(topic.kind, topic.name) for topic in log.topics] == [
        (Kind.FRAMES, "/cam0/image_raw"),
        (Kind.FRAMES, "/cam0/image_raw/compressed"),
        (Kind.IMU, "/imu/data_raw"),  # the other says that it has neither rates nor accelerations
        (Kind.ATTITUDE, "/imu/data"),  # and this one, that it has no orientation
    ]
    assert log.topics[0].note == "640x480 mono8; times of the headers"
    assert log.topics[1].note == "compressed, jpeg; times of the headers"
    assert len(log.topics[0].t_ns) == 10


def test_the_file_in_the_folder_will_do(office_bag: Path, tmp_path: Path) -> None:
    alone = office_bag if office_bag.is_file() else flat(office_bag, "ros2")
    other = tmp_path / "renamed"
    other.write_bytes(alone.read_bytes())
    for path in (alone, other):
        assert rosbag.recognises(path)
        assert len(rosbag.open_log(path).topics) == 4
    if office_bag.is_file():
        return  # ROS 1 has no folders
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / alone.name).write_bytes(alone.read_bytes())
    log = rosbag.open_log(tmp_path / "bag")
    assert len(log.topics) == 4
    assert "metadata.yaml is missing" in log.problems[0]


def test_a_source_of_pictures_can_be_sent_to_another_process(office: Flight, office_bag: Path) -> None:
    frames = rosbag.open_log(office_bag).frames("/cam0/image_raw/compressed").value
    frames.read(0)
    copy = pickle.loads(pickle.dumps(frames.source))
    np.testing.assert_array_equal(copy.read(5), office.frames.read(5))


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_poses_and_velocities_turn_into_frd(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "bag.bag"
    q = Rotation.from_euler("ZYX", [90.0, 0.0, 0.0], degrees=True).as_quat(scalar_first=True)  # to the left
    with Bag(path, kind) as bag:
        types = bag.types
        for k in range(50):
            t_ns = START_NS + k * 20_000_000
            pose, twist = bag.pose((1, 2, 3), q), {"linear": (0.5, 0.1, -0.2), "angular": (0, 0, 0.3)}
            body = types["geometry_msgs/msg/Twist"](**{name: bag.vector(v) for name, v in twist.items()})
            with_covariance = (
                types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
                types["geometry_msgs/msg/TwistWithCovariance"](twist=body, covariance=np.ones(36)),
            )
            odometry = types["nav_msgs/msg/Odometry"](
                header=bag.header(t_ns, "odom"),
                child_frame_id="a_body",
                pose=with_covariance[0],
                twist=with_covariance[1],
            )
            bag.write("/odom", odometry, t_ns)
            stamped = types["geometry_msgs/msg/PoseStamped"](header=bag.header(t_ns, "map"), pose=pose)
            bag.write("/pose", stamped, t_ns)
            for name, frame in (("/twist", "base_link"), ("/twist_world", "map")):
                header = bag.header(t_ns, frame)
                bag.write(name, types["geometry_msgs/msg/TwistStamped"](header=header, twist=body), t_ns)
    log = rosbag.open_log(path)
    assert [(topic.kind.value, topic.name) for topic in log.topics] == [
        ("attitude", "/pose"),
        ("attitude", "/odom"),
        ("position", "/pose"),
        ("position", "/odom"),
        ("velocity", "/odom"),
        ("velocity", "/twist"),
        ("velocity", "/twist_world"),
    ]
    problems = Told()
    half = 0.5**0.5
    for name in ("/odom", "/pose"):
        np.testing.assert_allclose(problems.take(log.position(name)).xyz, [[1.0, -2.0, -3.0]] * 50)
        attitude = problems.take(log.attitude(name))
        np.testing.assert_allclose(attitude.q_world_body, [[half, 0.0, 0.0, -half]] * 50, atol=1e-12)
    for name in ("/odom", "/twist"):
        np.testing.assert_allclose(problems.take(log.velocity(name)).xyz, [[0.5, -0.1, 0.2]] * 50)
    # Turned left by 90 degrees, the world's x is to the right of the body, its y ahead.
    np.testing.assert_allclose(
        problems.take(log.velocity("/twist_world")).xyz, [[0.1, 0.5, 0.2]] * 50, atol=1e-9
    )
    assert problems == []


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_ranges_that_look_down(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "bag.bag"
    down = Rotation.from_euler("y", 90, degrees=True).as_quat(
        scalar_first=True
    )  # x of the sensor points down
    with Bag(path, kind) as bag:
        types = bag.types
        links = []
        for child, q in (("sonar_down", down), ("sonar", (1, 0, 0, 0))):
            transform = types["geometry_msgs/msg/Transform"](
                translation=bag.vector((0, 0, 0)), rotation=bag.quaternion(q)
            )
            stamped = types["geometry_msgs/msg/TransformStamped"]
            links.append(stamped(header=bag.header(START_NS), child_frame_id=child, transform=transform))
        bag.write("/tf_static", types["tf2_msgs/msg/TFMessage"](transforms=links), START_NS)
        for k in range(50):
            t_ns = START_NS + k * 50_000_000
            wrong = {3: np.inf, 4: -np.inf, 5: 0.05, 6: 9.0, 7: np.nan}
            for topic, frame, value in (
                ("/down", "sonar_down", wrong.get(k, 1.0 + 0.01 * k)),
                ("/ahead", "sonar", 3.0),
                ("/lidar", "lidar_link_", 1.5),
            ):
                message = types["sensor_msgs/msg/Range"](
                    header=bag.header(t_ns, frame),
                    radiation_type=1,
                    field_of_view=0.1,
                    min_range=0.2,
                    max_range=8.0,
                    range=value,
                )
                bag.write(topic, message, t_ns)
    log = rosbag.open_log(path)
    assert [(topic.kind, topic.name) for topic in log.topics] == [
        (Kind.RANGE, "/down"),
        (Kind.RANGE, "/lidar"),
    ]
    assert log.problems == ("/ahead: does not look down by /tf_static, left out",)
    problems = Told()
    found = problems.take(log.range("/down"))
    kept = np.delete(np.arange(50), [3, 4, 5, 6, 7])
    np.testing.assert_array_equal(found.t_ns, START_NS + kept * 50_000_000)
    np.testing.assert_allclose(found.distance_m, 1.0 + 0.01 * kept, rtol=1e-6)
    assert len(problems) == 1
    np.testing.assert_allclose(problems.take(log.range("/lidar")).distance_m, 1.5)
    assert (
        problems[-1] == "/lidar: taken to look down, no transform tells; if it does not: [range] use = false"
    )


def test_messages_that_the_index_names_and_the_bag_does_not_hold_are_said(tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for k in range(30):
            bag.write("/imu", bag.imu(START_NS + k, (0, 0, 0.1 * k), (0, 0, 9.8)), START_NS + k * 10_000_000)
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 30", "message_count: 31"))
    log = rosbag.open_log(tmp_path / "bag")
    assert log.problems == ("/imu: 30 of 31 messages in the index can be read",)


def test_pictures_of_a_bag_that_is_gone_are_unreadable_not_a_crash(office: Flight, tmp_path: Path) -> None:
    path = tmp_path / "office.bag"
    write_office(office, path, "ros1", seconds=0.2, plain=False)
    frames = rosbag.open_log(path).frames("/cam0/image_raw/compressed").value
    path.unlink()
    with pytest.raises(InputError, match=r"office\.bag"):
        frames.read(0)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_sensors_are_mounted_as_the_static_transforms_say(kind: str, office: Flight, tmp_path: Path) -> None:
    assert office.imu is not None
    path = tmp_path / "office.bag"
    imu_on_mast = Rotation.from_euler("ZYX", [90.0, 20.0, 180.0], degrees=True)
    mast_on_body = Rotation.from_euler("Z", 30.0, degrees=True)
    turn = mast_on_body * imu_on_mast
    optical = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    standing = Rotation.from_euler("ZYX", [40.0, 5.0, -3.0], degrees=True)  # body FLU in the world, z up
    camera = office.camera
    with Bag(path, kind) as bag:
        bag.write(
            "/tf_static",
            bag.transforms(
                ("base_link", "mast", (0.0, 0.0, 0.3), mast_on_body),
                ("mast", "imu_link", (0.1, 0.0, 0.0), imu_on_mast),
                ("base_link", "camera", (0.06, 0.0, 0.015), optical),
            ),
            START_NS,
        )
        info = bag.camera_info(START_NS, 640, 480, LENS, "plumb_bob", np.zeros(5))
        bag.write("/cam0/camera_info", info, START_NS)
        for k in range(40):
            t_ns = START_NS + k * 5_000_000
            gyro, accel = (
                turn.inv().apply(v[k] * FLU) for v in (office.imu.gyro_rad_s, office.imu.accel_m_s2)
            )
            sample = bag.imu(t_ns, gyro, accel, (standing * turn).as_quat(scalar_first=True))
            sample.header.frame_id = "imu_link"
            bag.write("/imu/data", sample, t_ns)
        data = next((ROOT / "data" / "office" / "mav0" / "cam0" / "data").iterdir()).read_bytes()
        bag.write("/cam0/image_raw/compressed", bag.compressed(START_NS, data), START_NS)
    log = rosbag.open_log(path)
    problems = Told()
    imu = problems.take(log.imu("/imu/data"))
    np.testing.assert_allclose(imu.gyro_rad_s, office.imu.gyro_rad_s[:40], atol=1e-12)
    np.testing.assert_allclose(imu.accel_m_s2, office.imu.accel_m_s2[:40], atol=1e-12)
    attitude = problems.take(log.attitude("/imu/data"))
    body = Rotation.from_quat(attitude.q_world_body, scalar_first=True)
    angles = body.as_euler("ZYX", degrees=True)
    np.testing.assert_allclose(angles, [[-40.0, -5.0, -3.0]] * 40, atol=1e-9)  # the same body, FRD and z down
    read = log.camera("/cam0/image_raw/compressed")
    assert read is not None
    np.testing.assert_allclose(read.R_body_camera, camera.R_body_camera, atol=1e-12)
    np.testing.assert_allclose(read.p_body_camera_m, camera.p_body_camera_m, atol=1e-12)
    assert "turned from imu_link into base_link by /tf_static" in log.topics[1].note
    assert problems == []


def test_transforms_that_lead_nowhere_or_in_a_circle_are_no_mounts(ros1: Bag) -> None:
    straight = Rotation.identity()
    frames = StaticFrames()
    frames.add(ros1.transforms(("a", "b", (0, 0, 0), straight), ("b", "a", (0, 0, 0), straight)).transforms)
    frames.add(ros1.transforms(("/map", "/lonely", (0, 0, 0), straight)).transforms)
    frames.add(ros1.transforms(("drone/base_link", "nan", (np.nan, 0, 0), straight)).transforms)
    assert [frames.mount(name) for name in ("a", "lonely", "nan", "unheard_of")] == [None] * 4
    frames.add(ros1.transforms(("/drone/base_link", "/lonely", (1, 2, 3), straight)).transforms)
    mount = frames.mount("lonely")
    assert mount is not None
    assert mount.body == "drone/base_link"
    np.testing.assert_array_equal(mount.p_body_sensor_m, [1.0, -2.0, -3.0])


def test_empty_headers_leave_the_times_of_receipt_and_it_is_said(tmp_path: Path) -> None:
    with Bag(tmp_path / "a.bag", "ros1") as bag:
        for k in range(20):
            bag.write("/imu", bag.imu(0, (0, 0, 0.1), (0, 0, 9.8)), START_NS + k * 10_000_000)
    log = rosbag.open_log(tmp_path / "a.bag")
    problems = Told()
    imu = problems.take(log.imu("/imu"))
    np.testing.assert_array_equal(imu.t_ns, START_NS + np.arange(20) * 10_000_000)
    assert "headers without time" in problems[0]
    assert "times of receipt" in log.topics[0].note


def test_a_clock_of_its_own_and_a_clock_set_back_are_said(tmp_path: Path) -> None:
    with Bag(tmp_path / "a.bag", "ros1") as bag:
        for k in range(300):
            t_ns = 5_000_000_000 + k * 10_000_000 - (4_000_000_000 if k >= 100 else 0)
            bag.write("/imu", bag.imu(t_ns, (0, 0, 0.1), (0, 0, 9.8)), START_NS + k * 10_000_000)
    log = rosbag.open_log(tmp_path / "a.bag")
    assert "before receipt" in log.topics[0].note
    problems = Told()
    imu = problems.take(log.imu("/imu"))
    assert len(imu.t_ns) == 200
    assert imu.t_ns[0] == 2_000_000_000
    assert "the clock jumps by -3.99 s" in problems[0]


def encoded(colour: Any, encoding: str) -> Any:
    """The same picture in an encoding of sensor_msgs/Image."""
    grey_picture = to_grey(colour)
    alpha = np.dstack([colour, np.full(colour.shape[:2], 255, np.uint8)])
    wide = colour.astype(np.uint16) << 8
    pictures = {
        "mono8": grey_picture,
        "mono16": grey_picture.astype("<u2") << 8,
        "bgr8": colour,
        "rgb8": colour[:, :, ::-1],
        "bgra8": alpha,
        "rgba8": alpha[:, :, [2, 1, 0, 3]],
        "bgr16": wide,
        "rgb16": wide[:, :, ::-1],
        "yuv422": np.dstack([np.full_like(grey_picture, 128), grey_picture]),
        "yuv422_yuy2": np.dstack([grey_picture, np.full_like(grey_picture, 128)]),
        "nv12": np.vstack([grey_picture, np.full((24, 64), 128, np.uint8)]),
    }
    if encoding in pictures:
        return np.ascontiguousarray(pictures[encoding])
    pattern = encoding.removeprefix("bayer_")[:4]
    channel = {"b": 0, "g": 1, "r": 2}
    mosaic = np.empty(colour.shape[:2], np.uint8)
    for place, letter in enumerate(pattern):
        y, x = divmod(place, 2)
        mosaic[y::2, x::2] = colour[y::2, x::2, channel[letter]]
    return mosaic


ENCODINGS = (
    "mono8",
    "mono16",
    "bgr8",
    "rgb8",
    "bgra8",
    "rgba8",
    "bgr16",
    "rgb16",
    "yuv422",
    "yuv422_yuy2",
    "nv12",
)
BAYER = ("bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8")


@pytest.mark.parametrize("encoding", [*ENCODINGS, *BAYER])
def test_every_encoding_gives_the_same_grey(encoding: str, tmp_path: Path) -> None:
    colour = np.zeros((48, 64, 3), np.uint8)  # smooth, so that the Bayer filter loses little, and colourful
    y, x = np.mgrid[0:48, 0:64]
    colour[..., 0], colour[..., 1], colour[..., 2] = 40 + 3 * y, 200 - 2 * x, 20 + 2 * x + y
    with Bag(tmp_path / "a.bag", "ros1") as bag:
        for k in range(3):
            message = bag.image(START_NS + k * 50_000_000, encoded(colour, encoding), encoding)
            message.height = 48
            bag.write("/image", message, START_NS + k * 50_000_000)
    frames = rosbag.open_log(tmp_path / "a.bag").frames("/image").value
    inside = (slice(2, -2), slice(2, -2))
    tolerance = 3 if encoding in BAYER else 1
    difference = frames.read(1)[inside].astype(int) - to_grey(colour)[inside].astype(int)
    assert frames.read(1).shape == (48, 64)
    assert np.abs(difference).max() <= tolerance


def test_padded_rows_and_big_endian_words(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "a.bag", "ros1")
    with bag:
        picture = np.arange(20 * 10, dtype=np.uint8).reshape(10, 20)
        padded = bag.image(START_NS, np.hstack([picture, np.zeros((10, 4), np.uint8)]))
        padded.width = 20
        np.testing.assert_array_equal(grey(padded), picture)
        words = bag.image(START_NS, (picture.astype(np.uint16) << 8).astype(">u2"), "mono16")
        words.is_bigendian = 1
        np.testing.assert_array_equal(grey(words), picture)
        words.height = 11
        with pytest.raises(InputError, match="picture has 400 bytes instead of 440"):
            grey(words)
        words.width = 0
        with pytest.raises(InputError, match="size 0x11"):
            grey(words)


def test_pictures_that_cannot_be_read_are_left_out_and_said(tmp_path: Path) -> None:
    with Bag(tmp_path / "a.bag", "ros1") as bag:
        for k in range(3):
            t_ns = START_NS + k * 50_000_000
            bag.write("/depth", bag.image(t_ns, np.zeros((4, 4), np.float32), "32FC1"), t_ns)
            bag.write("/imu", bag.imu(t_ns, (0, 0, 0.1), (0, 0, 9.8)), t_ns)
    log = rosbag.open_log(tmp_path / "a.bag")
    assert [topic.kind for topic in log.topics] == [Kind.IMU]
    assert log.problems == ("/depth: pictures of encoding 32FC1 left out",)
    with pytest.raises(InputError, match="has no frames topic /depth"):
        log.frames("/depth")


def test_a_picture_that_does_not_decode_is_found_when_it_is_read(office: Flight, tmp_path: Path) -> None:
    with Bag(tmp_path / "a.bag", "ros1") as bag:
        data = next((ROOT / "data" / "office" / "mav0" / "cam0" / "data").iterdir()).read_bytes()
        for k, picture in enumerate([data, data[: len(data) // 2], data]):
            t_ns = START_NS + k * 50_000_000
            bag.write("/image/compressed", bag.compressed(t_ns, picture), t_ns)
    frames = rosbag.open_log(tmp_path / "a.bag").frames("/image/compressed").value
    with pytest.raises(InputError, match=r"/image/compressed, received at \d+: picture does not decode"):
        frames.read(1)
    assert frames.read(2).shape == (480, 640)


@pytest.fixture
def ros1(tmp_path: Path) -> Iterator[Bag]:
    with Bag(tmp_path / "infos.bag", "ros1") as bag:
        yield bag


LENS = (400.0, 410.0, 320.0, 240.0)


@pytest.mark.parametrize(
    ("model", "D", "expected"),
    [
        ("plumb_bob", [0.1, -0.2, 0.001, 0.002, 0.03], Distortion.RADTAN),
        ("plumb_bob", [], Distortion.NONE),
        ("", [0.0] * 5, Distortion.NONE),
        ("rational_polynomial", [0.1, 0.2, 0.0, 0.0, 0.1, 0.3, 0.2, 0.1], Distortion.RADTAN),
        ("equidistant", [0.1, 0.2, 0.0, 0.01], Distortion.EQUIDISTANT),
    ],
)
def test_lens_models(ros1: Bag, model: str, D: list[float], expected: Distortion) -> None:
    info = ros1.camera_info(START_NS, 640, 480, LENS, model, D)
    camera = camera_from_info(info, "/camera_info", rectified=False)
    assert camera is not None
    assert camera.distortion is expected
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == LENS
    assert camera.coefficients == (() if expected is Distortion.NONE else tuple(D))
    flattened = camera_from_info(info, "/camera_info", rectified=True)
    assert flattened is not None
    assert (flattened.fx_px, flattened.cx_px, flattened.distortion) == (200.0, 321.0, Distortion.NONE)


def test_part_of_a_sensor_and_binned_pixels(ros1: Bag) -> None:
    info = ros1.camera_info(START_NS, 640, 480, LENS, "", [])
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 100, 40, 400, 400
    info.binning_x = info.binning_y = 2
    camera = camera_from_info(info, "/camera_info", rectified=False)
    assert camera is not None
    assert (camera.width_px, camera.height_px, camera.fx_px) == (200, 200, 200.0)
    assert camera.cx_px == pytest.approx(
        (220.0 + 0.5) / 2 - 0.5
    )  # centres of the pixels stay where they were


def test_calibrations_that_are_none(ros1: Bag) -> None:
    info = ros1.camera_info(START_NS, 640, 480, (0, 0, 0, 0), "", [])
    assert camera_from_info(info, "/camera_info", rectified=False) is None
    info = ros1.camera_info(START_NS, 640, 480, LENS, "omni", [0.1])
    with pytest.raises(InputError, match="/camera_info has the distortion model 'omni'"):
        camera_from_info(info, "/camera_info", rectified=False)


def test_fisheye_numbers_that_go_by_plumb_bob_are_refused(ros1: Bag) -> None:
    lens, fisheye = (285.6, 286.7, 424.6, 408.2), [-0.0022, 0.0376, -0.0364, 0.0059, 0.0]
    info = ros1.camera_info(START_NS, 848, 800, lens, "plumb_bob", fisheye)
    with pytest.raises(
        InputError, match=r"/camera_info: distortion plumb_bob.*look like k1 to k4 of a fisheye"
    ):
        camera_from_info(info, "/camera_info", rectified=False)
    info = ros1.camera_info(START_NS, 848, 800, lens, "equidistant", fisheye)  # the driver fills all five
    camera = camera_from_info(info, "/camera_info", rectified=False)
    assert camera is not None
    assert camera.coefficients == tuple(fisheye[:4])


def test_refusals_name_the_file_and_the_remedy(tmp_path: Path) -> None:
    with Bag(tmp_path / "a.bag", "ros1") as bag:
        text = bag.types["std_msgs/msg/String"](data="hello")
        bag.write("/chatter", text, START_NS)
    with pytest.raises(
        InputError, match=r"a\.bag: contains none of the message types .* but std_msgs/msg/String"
    ):
        rosbag.open_log(tmp_path / "a.bag")
    (tmp_path / "b.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(InputError, match="contains no whole message"):
        rosbag.open_log(tmp_path / "b.bag")
    header = b"\x04\0\0\0json" + b"\0\0\0\0"
    record = b"\x01" + len(header).to_bytes(8, "little") + header
    (tmp_path / "d.mcap").write_bytes(b"\x89MCAP0\r\n" + record + bytes(100) + b"\x89MCAP0\r\n")
    with pytest.raises(InputError, match=r"d\.mcap: is an MCAP file of another profile than ros2"):
        rosbag.open_log(tmp_path / "d.mcap")
    (tmp_path / "c.bag").write_bytes(b"no bag")
    assert not rosbag.recognises(tmp_path / "c.bag")
    assert not rosbag.recognises(tmp_path)


@pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind != "mcap-zstd"])  # that is a single chunk
def test_a_torn_bag_gives_what_is_whole(kind: str, office: Flight, tmp_path: Path) -> None:
    path = tmp_path / "office.bag"
    write_office(office, path, kind, seconds=6.0 if kind == "mcap" else 1.0)
    whole = flat(path, kind).read_bytes()
    torn = tmp_path / "torn"
    torn.write_bytes(whole[: int(len(whole) * 0.8)])
    if kind == "sqlite3":
        with pytest.raises(InputError, match=r"cannot be opened.*malformed"):
            rosbag.open_log(torn)
        return
    log = rosbag.open_log(torn)
    assert "no sound index" in log.problems[0]
    problems = Told()
    imu = problems.take(log.imu("/imu/data_raw"))
    assert office.imu is not None
    np.testing.assert_array_equal(imu.t_ns, office.imu.t_ns[: len(imu.t_ns)])
    frames = problems.take(log.frames("/cam0/image_raw/compressed"))
    for k in (len(frames.t_ns) - 1, 0):
        np.testing.assert_array_equal(frames.read(k), office.frames.read(k))


@pytest.mark.parametrize("kind", FORMATS)
def test_damage_is_said_or_refused_and_nothing_else(kind: str, office: Flight, tmp_path: Path) -> None:
    path = tmp_path / "office.bag"
    write_office(office, path, kind, seconds=0.3)
    data = flat(path, kind).read_bytes()
    damage.survives(rosbag, damage.cuts(data, 40), tmp_path / "cut")
    opened, refused = damage.survives(rosbag, damage.flips(data, 60), tmp_path / "flip")
    assert opened > refused


@pytest.mark.parametrize("name", ["test1.bag", "test2.bag"])
def test_real_bags(name: str) -> None:
    if not (REAL / name).exists():
        pytest.skip("the real ROS 1 bags are not here")
    log = rosbag.open_log(REAL / name)
    kinds = [topic.kind.value for topic in log.topics]
    assert kinds == ["imu", "attitude", "attitude", "position", "velocity"]
    samples, refused, said = damage.read_everything(rosbag, REAL / name)
    assert (refused, said) == (0, [])
    assert samples == 3 * len(log.topics[2].t_ns) + 2 * len(log.topics[0].t_ns)
    problems = Told()
    position, velocity = (problems.take(read(log.topics[2].name)) for read in (log.position, log.velocity))
    # Wheel odometry: the way between positions is what the speed says.
    way_m = np.linalg.norm(np.diff(position.xyz, axis=0), axis=1).sum()
    steps_s = np.diff(velocity.t_ns) * 1e-9
    assert way_m == pytest.approx((np.abs(velocity.xyz[1:, 0]) * steps_s).sum(), rel=0.05)


def test_a_real_bag_in_pieces(tmp_path: Path) -> None:
    if not (REAL / "test2.bag").exists():
        pytest.skip("the real ROS 1 bags are not here")
    data = (REAL / "test2.bag").read_bytes()
    opened, _ = damage.survives(rosbag, damage.cuts(data, 12), tmp_path / "cut.bag")
    assert opened >= 6
    opened, _ = damage.survives(rosbag, damage.flips(data, 12), tmp_path / "flip.bag")
    assert opened >= 6


@pytest.mark.parametrize("of_world", [False, True])
def test_an_odometry_whose_twist_is_the_worlds_is_turned_into_the_body(
    tmp_path: Path, of_world: bool
) -> None:
    """As VINS-Mono publishes it; REP 105 and most drivers give the body's."""
    path = tmp_path / "bag"
    with Bag(path, "sqlite3") as bag:
        position = np.zeros(3)
        for i in range(300):
            t_ns, yaw = START_NS + i * 20_000_000, 0.9 * np.sin(0.03 * i)
            ahead = np.array([0.8 * np.cos(yaw), 0.8 * np.sin(yaw), 0.0])
            q = (np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))
            velocity = ahead if of_world else (0.8, 0.0, 0.0)
            twist = bag.types["geometry_msgs/msg/Twist"](
                linear=bag.vector(velocity), angular=bag.vector((0, 0, 0))
            )
            message = bag.types["nav_msgs/msg/Odometry"](
                header=bag.header(t_ns, "world"),
                child_frame_id="base_link",
                pose=bag.types["geometry_msgs/msg/PoseWithCovariance"](
                    pose=bag.pose(position, q), covariance=np.zeros(36)
                ),
                twist=bag.types["geometry_msgs/msg/TwistWithCovariance"](
                    twist=twist, covariance=np.zeros(36)
                ),
            )
            bag.write("/odom", message, t_ns)
            position = position + 0.02 * ahead
    told = Told()
    found = told.take(rosbag.open_log(path).velocity("/odom"))
    np.testing.assert_allclose(found.xyz, np.tile([0.8, 0.0, 0.0], (len(found.xyz), 1)), atol=1e-9)
    assert any("along the world's axes" in text for text in told) == of_world
