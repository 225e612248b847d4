"""IMUs as drivers send them: in other units, in two topics, one sensor at a time, in an optical frame's axes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import degrees
from pathlib import Path

import numpy as np
import pytest

from fusion.flight import FloatArray, ImuStream, Remark
from fusion.inspection.advice import Matter
from fusion.inspection.sources import inspect_path
from fusion.logs import load_flight, open_log
from fusion.logs.contents import Kind
from fusion.logs.imu_series import imu_stream
from fusion.logs.manifest.file import read_manifest
from fusion.logs.manifest.sources import ManifestLog
from fusion.logs.samples import Problems
from fusion.logs.series import Where
from tests.files import OFFICE, written
from tests.fusion.test_log_rosbag import Bag
from vision import InputError

pytest.importorskip("rosbags")

FLU = np.array([1.0, -1.0, -1.0])
N = 1200


@pytest.fixture(scope="module")
def office() -> ImuStream:
    imu = load_flight(OFFICE).imu
    assert imu is not None
    return ImuStream(imu.t_ns[:N], imu.gyro_rad_s[:N], imu.accel_m_s2[:N])


def rows(imu: ImuStream) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    return zip(imu.t_ns.tolist(), imu.gyro_rad_s * FLU, imu.accel_m_s2 * FLU, strict=True)


def read(path: Path) -> tuple[ImuStream, Problems]:
    log = ManifestLog(read_manifest(path)) if path.suffix == ".toml" else open_log(path)
    (topic,) = (topic.name for topic in log.topics if topic.kind is Kind.IMU)
    return log.imu(topic)


# --- units -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gyro_unit", "accel_unit", "key"),
    [(degrees(1.0), 1.0, "gyro_unit"), (1.0, 1 / 9.80665, "accel_unit")],
    ids=["deg/s", "g"],
)
def test_a_bag_in_another_unit_is_put_right_as_the_finding_says(
    office: ImuStream, tmp_path: Path, gyro_unit: float, accel_unit: float, key: str
) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for t_ns, gyro, accel in rows(office):
            bag.write("/imu", bag.imu(t_ns, gyro * gyro_unit, accel * accel_unit), t_ns)
    (finding,) = (f for f in inspect_path(tmp_path / "bag").findings if f.kind == key)
    setting = re.search(rf'set ({key} = "[^"]+") in \[imu\.columns\]', finding.remedy)
    assert setting is not None
    manifest = written(tmp_path / "flight.toml", f'log = "bag"\n[imu.columns]\n{setting[1]}\n')
    imu, _ = read(manifest)
    np.testing.assert_allclose(imu.gyro_rad_s, office.gyro_rad_s, atol=1e-12)
    np.testing.assert_allclose(imu.accel_m_s2, office.accel_m_s2, atol=1e-12)
    assert not [f for f in inspect_path(manifest).findings if f.kind == key]


def test_columns_do_not_go_with_a_bag(office: ImuStream, tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        bag.write("/imu", bag.imu(1, (0, 0, 1), (0, 0, 9.8)), 1)
    manifest = written(tmp_path / "flight.toml", 'log = "bag"\n[imu.columns]\ngyro = ["a", "b", "c"]\n')
    with pytest.raises(InputError, match="columns does not go with it"):
        ManifestLog(read_manifest(manifest)).log(Kind.IMU)


# --- two sensors -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [("/camera/gyro/sample", "/camera/accel/sample"), ("/a", "/b")])
def test_gyroscope_and_accelerometer_in_two_topics_are_one_imu(
    office: ImuStream, tmp_path: Path, names: tuple[str, str]
) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for i, (t_ns, gyro, accel) in enumerate(rows(office)):
            bag.write(names[0], bag.imu(t_ns, gyro, (0, 0, 0)), t_ns)
            if i % 2 == 0:
                bag.write(names[1], bag.imu(t_ns + 1_000_000, (0, 0, 0), accel), t_ns + 1_000_000)
    imu, _ = read(tmp_path / "bag")
    np.testing.assert_array_equal(imu.t_ns, office.t_ns)
    np.testing.assert_allclose(imu.gyro_rad_s, office.gyro_rad_s, atol=1e-12)
    between = np.isfinite(imu.accel_m_s2).all(axis=1)
    assert between.mean() > 0.99
    error = imu.accel_m_s2[between] - office.accel_m_s2[between]
    assert np.sqrt(np.mean(error**2)) < 0.3  # half of its noise is averaged away, half a step is missed
    found = inspect_path(tmp_path / "bag")
    assert not [s for s in found.advice if s.matter is Matter.MISSING and "IMU" in s.text]


@pytest.mark.parametrize("unknown", [True, False], ids=["covariance -1", "zeros"])
def test_one_sensor_at_a_time_in_one_topic(office: ImuStream, tmp_path: Path, unknown: bool) -> None:
    other = None if unknown else (0, 0, 0)
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for i, (t_ns, gyro, accel) in enumerate(rows(office)):
            message = bag.imu(t_ns, gyro, other) if i % 2 else bag.imu(t_ns, other, accel)
            bag.write("/imu", message, t_ns)
    imu, problems = read(tmp_path / "bag")
    np.testing.assert_array_equal(imu.t_ns, office.t_ns[1::2])
    np.testing.assert_allclose(imu.gyro_rad_s, office.gyro_rad_s[1::2], atol=1e-12)
    assert np.isfinite(imu.accel_m_s2[:-1]).all()
    assert np.median(imu.accel_m_s2[:-1, 2]) == pytest.approx(np.median(office.accel_m_s2[:, 2]), abs=0.05)
    assert any("rows of their own, joined by time" in text for text in problems)


def test_a_sensor_that_reads_zero_now_and_then_is_not_taken_apart() -> None:
    t_ns = np.arange(100, dtype=np.int64) * 5_000_000
    gyro, accel = np.ones((100, 3)), np.full((100, 3), 9.8)
    gyro[:5] = 0.0
    imu, problems = imu_stream(t_ns, gyro, accel, Where(Path("x"), "imu"))
    assert len(imu.t_ns) == 100
    assert problems == ()


def test_an_accelerometer_alone_is_no_imu_and_it_is_said(office: ImuStream, tmp_path: Path) -> None:
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for t_ns, _, accel in rows(office):
            bag.write("/accel", bag.imu(t_ns, None, accel, (1, 0, 0, 0)), t_ns)
    log = open_log(tmp_path / "bag")
    assert [topic.kind for topic in log.topics] == [Kind.ATTITUDE]
    assert log.problems == ("/accel: an accelerometer without gyroscope, left out",)


def test_an_optical_frame_says_its_axes(office: ImuStream, tmp_path: Path) -> None:
    """RealSense publishes x right, y down, z forward, and names the frame so (REP 103)."""
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for t_ns, gyro, accel in rows(office):
            message = bag.imu(t_ns, (gyro * FLU)[[1, 2, 0]], (accel * FLU)[[1, 2, 0]])
            message.header.frame_id = "camera_imu_optical_frame"
            bag.write("/camera/imu", message, t_ns)
    imu, _ = read(tmp_path / "bag")
    np.testing.assert_allclose(imu.gyro_rad_s, office.gyro_rad_s, atol=1e-12)
    np.testing.assert_allclose(imu.accel_m_s2, office.accel_m_s2, atol=1e-12)


def test_what_fusing_leaves_out_is_not_listed_as_fused(office: ImuStream, tmp_path: Path) -> None:
    """A gyroscope alone is called that; a stream that never changes is not offered."""
    lines = [f"{t},{','.join(map(str, g))}" for t, g in zip(office.t_ns, office.gyro_rad_s, strict=True)]
    path = written(tmp_path / "gyro.csv", "timestamp_ns,gx,gy,gz\n" + "\n".join(lines) + "\n")
    (fusable,) = (s.text for s in inspect_path(path).advice if s.matter is Matter.FUSE)
    assert "it has gyroscope (imu, 200 Hz)" in fusable
    dead = [f"{t},0.1,0.2,0.3,0,0,9.8" for t in office.t_ns]
    path = written(tmp_path / "dead.csv", "timestamp_ns,gx,gy,gz,ax,ay,az\n" + "\n".join(dead) + "\n")
    (fusable,) = (s.text for s in inspect_path(path).advice if s.matter is Matter.FUSE)
    assert fusable == "nothing yet: a heading in a corridor needs pictures"


def test_the_file_at_fault_is_named_and_what_was_only_taken_is_a_remark(
    office: ImuStream, tmp_path: Path
) -> None:
    values = np.hstack([np.degrees(office.gyro_rad_s), office.accel_m_s2])
    lines = [f"{t},{','.join(map(str, row))}" for t, row in zip(office.t_ns, values, strict=True)]
    head = "timestamp_ns,gx,gy,gz,ax,ay,az\n"
    written(tmp_path / "imu.csv", head + "\n".join(lines) + "\n")
    table = f'log = "{OFFICE.as_posix()}"\n[imu]\nfile = "imu.csv"\n[attitude]\nuse = false\n'
    manifest = written(tmp_path / "flight.toml", table)
    with pytest.raises(InputError, match=r"imu: .* it is in degrees/s") as caught:
        load_flight(manifest)
    assert caught.value.file == tmp_path / "imu.csv"
    written(manifest, table + '[imu.columns]\ngyro_unit = "deg/s"\n')
    problems = load_flight(manifest).problems
    lost = [text for text in problems if not isinstance(text, Remark)]
    assert [text[:12] for text in lost] == ["imu: it cove"]  # less than the whole flight
    assert any("axes assumed frd (the accelerometer reads gravity along -z)" in text for text in problems)


def test_a_phones_folder_is_one_imu(office: ImuStream, tmp_path: Path) -> None:
    """As Sensor Logger writes it: a file per sensor, z first, the accelerometer on times of its own."""
    folder = tmp_path / "2024-05-01"
    gyro, accel = office.gyro_rad_s, office.accel_m_s2
    t_ns, late_ns = office.t_ns, office.t_ns[::2] + 1_000_000
    for name, times, values in (("Gyroscope", t_ns, gyro), ("TotalAcceleration", late_ns, accel[::2])):
        lines = [f"{t},{(t - t_ns[0]) / 1e9},{z},{y},{x}" for t, (x, y, z) in zip(times, values, strict=True)]
        written(folder / f"{name}.csv", "time,seconds_elapsed,z,y,x\n" + "\n".join(lines) + "\n")
    written(folder / "Gravity.csv", "time,seconds_elapsed,z,y,x\n1,0,0,0,0\n")
    log = open_log(folder)
    assert log.format == "folder of a phone's sensors"
    imu = log.imu("imu").value
    np.testing.assert_array_equal(imu.t_ns, t_ns)
    np.testing.assert_allclose(imu.gyro_rad_s, gyro)
    assert np.nanmedian(imu.accel_m_s2[:, 2]) == pytest.approx(np.median(accel[:, 2]), abs=0.05)
    assert log.problems == ()
    written(folder / "Gyroscope.csv", "time,a,b,c\n" + "1,2,3,4\n" * 3)
    with pytest.raises(InputError, match="has no columns x, y, z of the gyro: time, a, b, c"):
        open_log(folder)


def test_gyroflows_log_is_in_its_scales(office: ImuStream, tmp_path: Path) -> None:
    head = (
        "GYROFLOW IMU LOG\nversion,1.3\nid,logger\norientation,YxZ\nnote,a, b\ntscale,0.000001\n"
        "gscale,0.001\nascale,0.0005\nt,gx,gy,gz,ax,ay,az\n"
    )
    t_us = (office.t_ns - office.t_ns[0]) // 1000
    counts = np.rint(np.hstack([office.gyro_rad_s / 0.001, office.accel_m_s2 / (0.0005 * 9.80665)]))
    lines = [f"{t},{','.join(f'{v:.0f}' for v in row)}" for t, row in zip(t_us, counts, strict=True)]
    path = written(tmp_path / "clip.gcsv", head + "\n".join(lines) + "\n")
    log = open_log(path)
    assert log.format == "Gyroflow IMU log"
    imu = log.imu("imu").value
    np.testing.assert_array_equal(imu.t_ns, office.t_ns - office.t_ns[0])
    np.testing.assert_allclose(imu.gyro_rad_s, office.gyro_rad_s, atol=0.0005001)
    np.testing.assert_allclose(imu.accel_m_s2, office.accel_m_s2, atol=0.00246)
    written(path, head.replace("gscale,0.001\n", "") + "\n".join(lines) + "\n")
    with pytest.raises(InputError, match="gscale is missing"):
        open_log(path)
    written(path, head.split("t,gx")[0])
    with pytest.raises(InputError, match="has no table of samples"):
        open_log(path)
    without = "\n".join(",".join(line.split(",")[:4]) for line in lines)
    written(path, head.replace(",ax,ay,az", "") + without + "\n")
    assert np.isnan(open_log(path).imu("imu").value.accel_m_s2).all()


@pytest.mark.parametrize("burst", [3, 10])
def test_inspect_tells_the_rate_that_bursts_are_spread_to(
    office: ImuStream, tmp_path: Path, burst: int
) -> None:
    n = len(office.t_ns) // burst * burst
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for k, (t_ns, gyro, accel) in enumerate(rows(office)):
            if k < n:
                stamp_ns = int(office.t_ns[k // burst * burst + burst - 1]) + k % burst * 60_000
                bag.write("/imu", bag.imu(stamp_ns, gyro, accel), t_ns)
    found = inspect_path(tmp_path / "bag")
    (stream,) = found.streams
    assert stream.timing.rate_hz == pytest.approx(200.0, rel=0.01)
    assert stream.timing.gap_count == 0
    assert any("/imu, 200 Hz" in sentence.text for sentence in found.advice)


# --- clocks ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("of_boot", ["/imu", "/cam", "both", "each its own"])
def test_headers_of_different_clocks_are_put_on_that_of_the_receipt(
    office: ImuStream, tmp_path: Path, of_boot: str
) -> None:
    """The IMU's driver counts from boot, the camera's in Unix time, or the other way about."""
    boot_ns = int(office.t_ns[0]) - 12_345_000_000_000
    imu_by = boot_ns if of_boot in ("/imu", "both", "each its own") else 0
    cam_by = {"/cam": boot_ns, "both": boot_ns, "each its own": boot_ns // 2}.get(of_boot, 0)
    with Bag(tmp_path / "bag", "sqlite3") as bag:
        for k, (t_ns, gyro, accel) in enumerate(rows(office)):
            late_ns = 2_000_000 + 50_000 * (k % 7)
            bag.write("/imu", bag.imu(t_ns - imu_by, gyro, accel), t_ns + late_ns)
            if k % 10 == 0:
                picture = bag.image(t_ns - cam_by, np.full((4, 6), k % 250, np.uint8))
                bag.write("/cam", picture, t_ns + 30_000_000)
    log = open_log(tmp_path / "bag")
    imu, imu_problems = log.imu("/imu")
    frames, _ = log.frames("/cam")
    if of_boot == "both":  # one clock: nothing has to be done, least of all by guessing at delays
        np.testing.assert_array_equal(imu.t_ns, office.t_ns - boot_ns)
        np.testing.assert_array_equal(frames.t_ns, office.t_ns[::10] - boot_ns)
        return
    delay_ns = 2_000_000 if imu_by else 0
    assert np.abs(imu.t_ns - office.t_ns - delay_ns).max() < 1_000
    delay_ns = 30_000_000 if cam_by else 0
    assert np.abs(frames.t_ns - office.t_ns[::10] - delay_ns).max() < 1_000
    assert any("of another clock" in text for text in imu_problems) == bool(imu_by)
    assert not [f for f in inspect_path(tmp_path / "bag").findings if f.kind == "overlap"]
