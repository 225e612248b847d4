"""Tables, autopilots' logs, data sets and videos as people have them, with the sample flight's pictures beside."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from fractions import Fraction
from functools import partial
from math import degrees
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.files import written
from tests.fusion.log_cases import FLU, SENSOR_YAML, Build, Case, Part

G = 9.80665
NAMES = "gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
Stamp = Callable[[Part, int], str]


# --- tables -------------------------------------------------------------------------------------------------------


def with_pictures(sensors: Build, extra: str = "") -> Build:
    """Return what names a log for everything but the pictures, which are a flight folder's."""

    def build(part: Part, folder: Path) -> Path:
        cameras = part.camera_folder(folder / "pictures")
        log = sensors(part, folder)
        text = f'log = "{log.as_posix()}"\n[camera]\nfile = "{cameras.as_posix()}"\n{extra}'
        return written(folder / "flight.toml", text)

    return build


def rows_of(
    part: Part, between: str, stamp: Callable[[int], str] = str, scales: Any = (*FLU, *FLU)
) -> list[str]:
    """A row for each sample: its time, then gyroscope and accelerometer times their scales."""
    values = np.hstack([part.gyro, part.accel]) * scales
    times = map(stamp, part.t_ns.tolist())
    return [between.join((t, *(f"{v:.7f}" for v in row))) for t, row in zip(times, values, strict=True)]


def ns(part: Part, t_ns: int) -> str:
    """Nanoseconds, as they are."""
    return str(t_ns)


def date(form: str) -> Stamp:
    """A date in UTC of some form."""
    return lambda part, t_ns: datetime.fromtimestamp(t_ns / 1e9, UTC).strftime(form)


def counter(start: int, unit_ns: int, bits: int) -> Stamp:
    """A counter from boot that starts over."""
    return lambda part, t_ns: str((start + (t_ns - int(part.t_ns[0])) // unit_ns) % 2**bits)


def table(
    stamp: Stamp = ns,
    header: str = f"timestamp_ns,{NAMES}",
    *,
    gyro: float = 1.0,
    accel: float = 1.0,
    axes: Any = (1.0, 1.0, 1.0),
    name: str = "imu.csv",
    row: Callable[[str], str] = lambda row: row,
    encoding: str = "utf-8",
    end: str = "\n",
) -> Build:
    """Return what writes the IMU as a table: its times, a header, factors and axes."""

    def build(part: Part, folder: Path) -> Path:
        scales = np.repeat([gyro, accel], 3) * np.tile(axes, 2)
        lines = [header, *rows_of(part, ",", partial(stamp, part), scales)]
        path = folder / name
        path.write_bytes((end.join(row(line) for line in lines) + end).encode(encoding))
        return path

    return build


TABLES = {
    "plain": Case(with_pictures(table())),
    "a comma at the end of each row": Case(
        with_pictures(table(row=lambda r: r if r.startswith("t") else r + ","))
    ),
    "a header behind # and commas": Case(
        with_pictures(
            table(header=f"#timestamp_ns,{NAMES}", row=lambda r: r if r.startswith("#") else r + ",")
        )
    ),
    "semicolons and decimal commas": Case(
        with_pictures(table(row=lambda r: r.replace(",", ";").replace(".", ",")))
    ),
    "ISO dates": Case(with_pictures(table(date("%Y-%m-%dT%H:%M:%S.%fZ"), f"time,{NAMES}"))),
    "dates with slashes": Case(with_pictures(table(date("%Y/%m/%d %H:%M:%S.%f"), f"time,{NAMES}"))),
    "dates with dots": Case(with_pictures(table(date("%d.%m.%Y %H:%M:%S.%f"), f"time,{NAMES}"))),
    "times of day": Case(with_pictures(table(date("%H:%M:%S.%f"), f"time,{NAMES}")), refused="the frames"),
    "microseconds that start over": Case(
        with_pictures(table(counter(4_291_000_000, 1000, 32), f"time_us,{NAMES}")), refused="the frames"
    ),
    "milliseconds of 16 bits": Case(
        with_pictures(table(counter(62_000, 10**6, 16), f"time_ms,{NAMES}")), refused="the frames"
    ),
    "a line of units": Case(
        with_pictures(
            table(
                lambda p, t: f"{t / 1e9:.6f}",
                f"time,{NAMES}\ns,deg/s,deg/s,deg/s,g,g,g",
                gyro=degrees(1.0),
                accel=1 / G,
            )
        )
    ),
    "quotes, BOM and CRLF": Case(
        with_pictures(
            table(row=lambda r: ",".join(f'"{f}"' for f in r.split(",")), encoding="utf-8-sig", end="\r\n")
        )
    ),
    "UTF-16 with tabs": Case(with_pictures(table(row=lambda r: r.replace(",", "\t"), encoding="utf-16"))),
    "Crazyflie": Case(
        with_pictures(
            table(
                counter(5000, 10**6, 32),
                "timestamp,gyro.x,gyro.y,gyro.z,acc.x,acc.y,acc.z",
                gyro=degrees(1.0),
                accel=1 / G,
                axes=FLU,
            )
        ),
        refused="the frames",
    ),
    "Betaflight's blackbox": Case(
        with_pictures(
            table(
                counter(7_000_000, 1000, 32),
                "time (us),gyroADC[0],gyroADC[1],gyroADC[2],accSmooth[0],accSmooth[1],accSmooth[2]",
                gyro=degrees(1.0),
                accel=2048 / G,
                axes=FLU,
            )
        ),
        refused="the frames",
    ),
    "degrees under names without a unit": Case(
        with_pictures(table(gyro=degrees(1.0))), refused="it is in degrees/s, not rad/s"
    ),
    "axes told wrongly": Case(
        with_pictures(table(axes=FLU), '[imu]\nframe = "frd"\n'), refused="axes look like FLU"
    ),
    "axes told wrongly the other way": Case(
        with_pictures(table(), '[imu]\nframe = "flu"\n'), refused="axes look like FRD, not FLU"
    ),
    "twentieths of degrees": Case(
        with_pictures(table(gyro=degrees(1.0) / 20)), caused="times as much as the gyroscope", dense=True
    ),
}


# --- autopilots ---------------------------------------------------------------------------------------------------

BOOT_US = 5_000_000
COMBINED = (
    "sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;"
)
ATTITUDE = "vehicle_attitude:uint64_t timestamp;uint64_t timestamp_sample;float[4] q;"


def ulog(
    order: Callable[[int], Iterable[int]] = range,
    logged_us: Callable[[int, int], int] = lambda k, t: t,
    sampled_us: Callable[[int, int], int] = lambda k, t: t,
) -> Build:
    """Return what writes a ULog: samples in an order, with times of logging, and of the attitude's samples."""
    from tests.fusion.test_log_ulog import Writer

    def build(part: Part, folder: Path) -> Path:
        writer = Writer()
        writer.formats(COMBINED, ATTITUDE)
        writer.subscribe(0, "sensor_combined")
        writer.subscribe(1, "vehicle_attitude")
        t_us = BOOT_US + (part.t_ns - part.t_ns[0]) // 1000
        for k in order(len(t_us)):
            logged = logged_us(k, int(t_us[k]))
            writer.sample(0, "Q3fIi3fI", logged, *part.gyro[k], 5000, 0, *part.accel[k], 5000)
        for k, t in enumerate((BOOT_US + (part.attitude_ns - part.t_ns[0]) // 1000).tolist()):
            writer.sample(1, "QQ4f", t, sampled_us(k, t), *part.q[k])
        return writer.save(folder / "flight.ulg")

    return build


def swapped(n: int) -> list[int]:
    """Some samples that were logged in the wrong order."""
    order = list(range(n))
    for k in range(100, n - 10, 50):
        order[k], order[k + 3] = order[k + 3], order[k]
    return order


def tlog(received_us: int, boot_ms: int) -> Build:
    """Return what writes a telemetry log of a computer's clock and a vehicle's counter of milliseconds."""

    def build(part: Part, folder: Path) -> Path:
        from pymavlink.dialects.v20 import ardupilotmega as mavlink

        from tests.fusion.test_log_tlog import Writer

        writer = Writer(mavlink)
        for k in range(0, len(part.t_ns), 4):
            since_us = int(part.t_ns[k] - part.t_ns[0]) // 1000
            boot = (boot_ms + since_us // 1000) % 2**32
            counts = [round(v / G * 1000) for v in part.accel[k]] + [round(v * 1000) for v in part.gyro[k]]
            writer.send(mavlink.MAVLink_scaled_imu_message(boot, *counts, 0, 0, 0), received_us + since_us)
            q = part.q[min(len(part.q) - 1, int(np.searchsorted(part.attitude_ns, part.t_ns[k])))]
            message = mavlink.MAVLink_attitude_quaternion_message(boot, *q, *part.gyro[k])
            writer.send(message, received_us + since_us)
        return writer.save(folder / "flight.tlog")

    return build


def dataflash_text(part: Part, folder: Path) -> Path:
    """What Mission Planner writes."""
    head = (
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
        "FMT, 129, 43, IMU, QBffffffIIfBBHH, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz\n"
    )
    rows = (
        f"IMU, {BOOT_US + (t - int(part.t_ns[0])) // 1000}, 0, "
        + ", ".join(f"{v:.6f}" for v in (*g, *a))
        + ", 0, 0, 25.0, 1, 1, 200, 200\n"
        for t, g, a in zip(part.t_ns.tolist(), part.gyro, part.accel, strict=True)
    )
    return written(folder / "flight.log", head + "".join(rows))


UNIX_US = 1_600_000_000_000_000
AUTOPILOTS = {
    name: Case(with_pictures(build), refused="the frames")
    for name, build in {
        "ULog": ulog(),
        "ULog out of order": ulog(swapped),
        "ULog whose attitude was sampled in Unix time": ulog(sampled_us=lambda k, t: UNIX_US + t),
        "ULog whose attitude lacks every second time of sampling": ulog(
            sampled_us=lambda k, t: 0 if k % 2 else t - 3000
        ),
        "tlog": tlog(UNIX_US, 60_000),
        "tlog of a computer without a clock": tlog(47_000_000, 60_000),
        "tlog whose counter starts over": tlog(UNIX_US, 2**32 - 4000),
        "DataFlash as text": dataflash_text,
    }.items()
}


# --- data sets ----------------------------------------------------------------------------------------------------


def pictures(part: Part, folder: Path, names: Iterable[str], deep: bool = False) -> None:
    """Write the pictures under these names."""
    folder.mkdir(parents=True)
    for picture, name in zip(part.pictures, names, strict=True):
        stored = picture.astype(np.uint16) << 8 if deep else picture
        cv2.imwrite(str(folder / name), stored, [cv2.IMWRITE_PNG_COMPRESSION, 1])


def uzh_fpv(part: Part, folder: Path) -> Path:
    """A folder of UZH-FPV."""
    drive = folder / "drive"
    names = [f"image_0_{k}.png" for k in range(len(part.pictures))]
    pictures(part, drive / "img", names)
    rows = (
        f"{k} {t / 1e9:.9f} img/{name}\n"
        for k, (t, name) in enumerate(zip(part.frames_ns, names, strict=True))
    )
    written(drive / "images.txt", "# id timestamp image_name\n" + "".join(rows))
    head = "# id timestamp ang_vel_x ang_vel_y ang_vel_z lin_acc_x lin_acc_y lin_acc_z\n"
    numbered = enumerate(rows_of(part, " ", lambda t: f"{t / 1e9:.9f}"))
    written(drive / "imu.txt", head + "".join(f"{k} {row}\n" for k, row in numbered))
    return drive


def tum_rgbd(part: Part, folder: Path) -> Path:
    """A folder of TUM RGB-D: no gyroscope."""
    drive = folder / "drive"
    names = [f"{t / 1e9:.6f}.png" for t in part.frames_ns.tolist()]
    pictures(part, drive / "rgb", names)
    written(drive / "rgb.txt", "# timestamp filename\n" + "".join(f"{n[:-4]} rgb/{n}\n" for n in names))
    rows = (
        f"{t / 1e9:.6f} {a[0]:.4f} {a[1]:.4f} {a[2]:.4f}\n"
        for t, a in zip(part.t_ns, part.accel, strict=True)
    )
    written(drive / "accelerometer.txt", "# timestamp ax ay az\n" + "".join(rows))
    return drive


def tum_vi(part: Part, folder: Path) -> Path:
    """An export of TUM-VI: 16 bits, no sensor.yaml, a motion capture."""
    mav0 = folder / "drive" / "mav0"
    pictures(part, mav0 / "cam0" / "data", [f"{t}.png" for t in part.frames_ns.tolist()], deep=True)
    rows = "".join(f"{t},{t}.png\r\n" for t in part.frames_ns.tolist())
    written(mav0 / "cam0" / "data.csv", "#timestamp [ns],filename\r\n" + rows)
    rows = "".join(f"{row}\n" for row in rows_of(part, ","))
    head = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
    written(mav0 / "imu0" / "data.csv", head + "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n" + rows)
    head = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    written(
        mav0 / "mocap0" / "data.csv", head + "".join(f"{t},0,0,0,1,0,0,0\n" for t in part.frames_ns.tolist())
    )
    return folder / "drive"


def kitti(part: Part, folder: Path) -> Path:
    """A raw drive: an inertial navigation as often as the pictures."""
    drive = folder / "drive"

    def stamp(t_ns: int) -> str:
        return (
            datetime.fromtimestamp(t_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S.")
            + f"{t_ns % 10**9:09d}\n"
        )

    pictures(part, drive / "image_00" / "data", [f"{k:010d}.png" for k in range(len(part.pictures))])
    written(drive / "image_00" / "timestamps.txt", "".join(map(stamp, part.frames_ns.tolist())))
    chosen = range(0, len(part.t_ns), 10)  # at 20 Hz a tenth is heard: means of it
    for k, i in enumerate(chosen):
        near = slice(max(0, i - 5), i + 5)
        gyro, accel = part.gyro[near].mean(axis=0) * FLU, part.accel[near].mean(axis=0) * FLU
        q = part.q[min(len(part.q) - 1, int(np.searchsorted(part.attitude_ns, part.t_ns[i])))]
        w, x, y, z = q * np.array([1.0, *FLU])
        roll, pitch = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), np.arcsin(2 * (w * y - z * x))
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        numbers = [
            49.0,
            8.4,
            112.8,
            roll,
            pitch,
            yaw,
            0.0,
            0.0,
            0.8,
            0.0,
            0.0,
            *accel,
            *accel,
            *gyro,
            *gyro,
            *[0.1] * 7,
        ]
        written(drive / "oxts" / "data" / f"{k:010d}.txt", " ".join(f"{v:.7f}" for v in numbers) + "\n")
    written(drive / "oxts" / "timestamps.txt", "".join(stamp(int(part.t_ns[i])) for i in chosen))
    return drive


DATASETS = {
    name: Case(build, refused=refused, gyro=gyro, rmse_deg=rmse_deg, dense=not gyro)
    for name, build, refused, gyro, rmse_deg in (
        ("UZH-FPV", uzh_fpv, "holds no calibration of the camera", True, 0.5),
        ("TUM RGB-D", tum_rgbd, "holds no calibration of the camera", False, 0.5),
        ("TUM-VI", tum_vi, "there is no such file", True, 0.5),
        ("KITTI", kitti, "holds no calibration of the camera", True, 1.0),
    )
}


# --- videos -------------------------------------------------------------------------------------------------------


def encode(part: Part, path: Path, start_ms: int = 0, b_frames: int = 0) -> Path:
    """Write the pictures as a video; milliseconds are its clock."""
    import av

    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=20)
        stream.height, stream.width = part.pictures[0].shape
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "14", "bf": str(b_frames), "preset": "ultrafast"}
        stream.codec_context.time_base = Fraction(1, 1000)
        for t_ns, picture in zip(part.frames_ns.tolist(), part.pictures, strict=True):
            frame = av.VideoFrame.from_ndarray(picture, format="gray").reformat(format="yuv420p")
            frame.pts = start_ms + round((t_ns - int(part.frames_ns[0])) / 1e6)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def remux(source: Path, target: Path, change: Callable[[int, Any], None]) -> Path:
    """Copy a video packet by packet, each changed by its number."""
    import av

    with av.open(str(source)) as old, av.open(str(target), "w") as new:
        stream = new.add_stream_from_template(old.streams.video[0])
        for number, packet in enumerate(p for p in old.demux(video=0) if p.dts is not None):
            packet.stream = stream
            change(number, packet)
            new.mux(packet)
    return target


def repeating(number: int, packet: Any, seen: list[int]) -> None:
    """Give the tenth packet the stamp of the one before."""
    if number == 10:
        packet.pts = packet.dts = seen[-1]
    seen.append(packet.pts)


def video(make: Callable[[Part, Path], Path], *, times: bool = True) -> Build:
    """Return what names a video, the times of its frames, its calibration and a table of the IMU."""

    def build(part: Part, folder: Path) -> Path:
        path, imu = make(part, folder), table()(part, folder)
        written(folder / "times.csv", "timestamp_ns\n" + "".join(f"{t}\n" for t in part.frames_ns.tolist()))
        lines = [f'file = "{path.as_posix()}"', f'calibration = "{SENSOR_YAML.as_posix()}"']
        lines += [f'times = "{(folder / "times.csv").as_posix()}"'] if times else []
        text = "[camera]\n" + "\n".join(lines) + f'\n[imu]\nfile = "{imu.as_posix()}"\nframe = "frd"\n'
        return written(folder / "flight.toml", text)

    return build


VIDEOS = {
    "a video with times": Case(video(lambda p, d: encode(p, d / "a.mkv"))),
    "two frames with one stamp": Case(
        video(lambda p, d: remux(encode(p, d / "a.mkv"), d / "b.mkv", partial(repeating, seen=[])))
    ),
    "a video that starts late": Case(
        video(lambda p, d: encode(p, d / "a.mkv", 10_000), times=False), refused="the frames"
    ),
    "B frames and no times": Case(
        video(lambda p, d: encode(p, d / "a.mp4", b_frames=2), times=False), refused="the frames"
    ),
}
