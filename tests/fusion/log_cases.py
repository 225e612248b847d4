"""A part of the sample flight, written as logs in other people's forms; and remedies, followed to the letter.

`REMEDIED` is what a case comes to: the log is right as it is, or is refused, or its verdict names a cause, and the
remedy in that one line, put into a ``flight.toml`` by `follow`, leads there.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fusion import FusionResult, fuse_flight, load_flight
from fusion.alignment import align_flight
from fusion.alignment.manifest import write_alignment
from fusion.flight import Flight, FloatArray, TimeArray
from tests.files import OFFICE, written
from vision import Camera, InputError
from vision.images import GreyImage

SECONDS = 8.0
FLU = np.array([1.0, -1.0, -1.0])
SENSOR_YAML = OFFICE / "mav0" / "cam0" / "sensor.yaml"
MAX_TURN_RAD = 0.06  # between sums of the gyroscope's samples; a tenth of what the vehicle turns
MAX_STEPS = 6  # remedies followed one after another

Table = dict[str, Any]
Build = Callable[["Part", Path], Path]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The first seconds of the sample flight, body FRD, and what is true of them."""

    t_ns: TimeArray
    gyro: FloatArray
    accel: FloatArray
    attitude_ns: TimeArray
    q: FloatArray
    frames_ns: TimeArray
    pictures: tuple[GreyImage, ...]
    names: tuple[str, ...]
    heading_rad: FloatArray  # at the frames
    camera: Camera

    @classmethod
    def of(cls, office: Flight, every: int) -> Part:
        """Cut it out, with one frame of so many."""
        imu, attitude, truth = office.imu, office.attitude, office.truth
        assert imu is not None
        assert attitude is not None
        assert truth is not None
        end_ns = int(office.frames.t_ns[0] + SECONDS * 1e9)
        k, a = imu.t_ns < end_ns, attitude.t_ns < end_ns
        chosen = np.flatnonzero(office.frames.t_ns < end_ns)[::every]
        frames_ns = office.frames.t_ns[chosen]
        listed = sorted(path.name for path in (OFFICE / "mav0" / "cam0" / "data").iterdir())
        return cls(
            imu.t_ns[k],
            imu.gyro_rad_s[k],
            imu.accel_m_s2[k],
            attitude.t_ns[a],
            attitude.q_world_body[a],
            frames_ns,
            tuple(office.frames.read(int(i)) for i in chosen),
            tuple(listed[int(i)] for i in chosen),
            np.interp(frames_ns - frames_ns[0], truth.t_ns - frames_ns[0], np.unwrap(truth.heading_rad)),
            office.camera,
        )

    def camera_folder(self, folder: Path) -> Path:
        """Write the pictures as a flight folder without any other sensor."""
        cam = folder / "mav0" / "cam0"
        rows = "".join(f"{t},{name}\n" for t, name in zip(self.frames_ns, self.names, strict=True))
        written(cam / "data.csv", "#timestamp [ns],filename\n" + rows)
        written(cam / "sensor.yaml", SENSOR_YAML.read_text())
        written(folder / "mav0" / "body.yaml", (OFFICE / "mav0" / "body.yaml").read_text())
        (cam / "data").symlink_to(OFFICE / "mav0" / "cam0" / "data")
        return folder


@dataclass(frozen=True, slots=True)
class Case:
    """A log, and what comes of it.

    Parameters
    ----------
    build
        Writes it into a folder; returns what is given to ``corridor fuse``.
    refused
        Words of the refusal that comes first; None: it is taken as it is.
    caused
        Words of the likely cause that the verdict names, where it is taken but cannot be right.
    followed
        Whether the remedy can be followed without recording anew.
    gyro
        Whether the flight has its gyroscope.
    rmse_deg
        Bound of the heading's error in the end.
    gyro_scale
        Of the numbers that are right in the end: a clock that runs fast makes turns slow.
    dense
        Whether it takes twenty frames a second to tell.
    """

    build: Build
    refused: str | None = None
    caused: str | None = None
    followed: bool = True
    gyro: bool = True
    rmse_deg: float = 0.5
    gyro_scale: float = 1.0
    dense: bool = False


@dataclass(eq=False)
class Manifest:
    """A ``flight.toml`` under way: what a user has written into it so far."""

    path: Path
    values: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def beside(cls, log: Path, folder: Path) -> Manifest:
        """Begin with the manifest that was given, else with a log."""
        values = tomllib.loads(log.read_text()) if log.suffix == ".toml" else {"log": log.as_posix()}
        return cls(folder / "followed" / "flight.toml", values)

    def put(self, table: str, key: str, value: object) -> None:
        """Set a key of a table such as ``imu`` or ``imu.columns``."""
        inner = self.values
        for part in table.split("."):
            inner = inner.setdefault(part, {})
        inner[key] = value

    def write(self) -> Path:
        """Write it; returns its path."""
        lines: list[str] = []

        def add(name: str, table: Table) -> None:
            own = {key: value for key, value in table.items() if not isinstance(value, dict)}
            lines.extend([f"[{name}]"] if name and own else [])
            lines.extend(f"{key} = {_toml(value)}" for key, value in own.items())
            for key, value in table.items():
                if isinstance(value, dict):
                    add(f"{name}.{key}" if name else key, value)

        add("", self.values)
        return written(self.path, "\n".join(lines) + "\n")


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return repr(value)


_VALUE = r"(\"[^\"]*\"|\[[^\]]*\]|[-+\w.]*\w)"
_SETTINGS = (  # as remedies put them, the groups named
    rf"(?P<key>\w+) = (?P<value>{_VALUE}) (?:for|in|under) \[(?P<table>[\w.]+)\]",
    rf"\[(?P<table>[\w.]+)\] (?P<key>\w+) = (?P<value>{_VALUE})",
    rf"(?P<key>rate_hz) = (?P<value>{_VALUE})",
)


def follow(remedy: str, manifest: Manifest, flight: Flight | None = None) -> None:
    """Do the first thing that a remedy says, and nothing else."""
    added = re.search(
        r"[Aa]dd (-?[\d.]+) to (?:\[camera\] clock_offset_s|clock_offset_s for \[camera\])", remedy
    )
    if added is not None:
        before = manifest.values.get("camera", {}).get("clock_offset_s", 0.0)
        manifest.put("camera", "clock_offset_s", before + float(added[1]))
        return
    away = re.search(r"Take (\w+) of \[(\w+)\] away and (.*)", remedy)
    if away is not None:
        del manifest.values[away[2]][away[1]]
        remedy = away[3]
    for pattern in _SETTINGS:
        told = re.search(pattern, remedy)
        if told is not None:
            manifest.put(
                told.groupdict().get("table") or "camera",
                told["key"],
                tomllib.loads(f"x = {told['value']}")["x"],
            )
            break
    else:
        if "--camera" not in remedy:
            raise AssertionError(f"nothing to follow in {remedy!r}")
        manifest.put("camera", "calibration", SENSOR_YAML.as_posix())
    also = re.search(r"and add (-?[\d.]+) to its clock_offset_s", remedy)
    if also is not None:
        manifest.put("camera", "clock_offset_s", float(also[1]))


def align(flight: Flight, manifest: Manifest) -> None:
    """Run ``corridor align --write``."""
    write_alignment(align_flight(flight), flight, manifest.path)
    manifest.values = tomllib.loads(manifest.path.read_text())


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a case came to: what was refused or named on the way, and the flight and result in the end."""

    told: tuple[str, ...]
    flight: Flight
    result: FusionResult


def lead(log: Path, folder: Path, case: Case) -> Outcome:
    """Load and fuse a log, following each remedy in turn."""
    manifest, path, told = Manifest.beside(log, folder), log, []
    for _ in range(MAX_STEPS):
        try:
            flight = load_flight(path)
        except InputError as error:
            told.append(error.problem)
            follow(error.remedy or "", manifest)
        else:
            result = fuse_flight(flight)
            cause = likely_cause_of(result)
            if cause is None or (case.caused is None and case.refused is None):
                return Outcome(tuple(told), flight, result)
            told.append(cause[0])
            follow(cause[1], manifest)
        path = manifest.write()
    raise AssertionError(f"not right after {MAX_STEPS} remedies: {told}")


def likely_cause_of(result: FusionResult) -> tuple[str, str] | None:
    """Return value and action of the verdict's likely cause, if it names one."""
    assert result.overview is not None
    found = [check for check in result.overview.checks if check.name == "Likely cause"]
    return (found[0].value, found[0].action) if found else None


def judge(part: Part, outcome: Outcome, case: Case) -> None:
    """Assert that times, counts, units, axes and the heading are those of the part."""
    flight, estimates = outcome.flight, outcome.result.estimates
    t_ns = flight.frames.t_ns
    # Logs of other clocks keep their own zero; within the log the times are those of the part.
    since_s = (t_ns - t_ns[0]) * 1e-9 / case.gyro_scale
    first = int(np.argmin([_difference(flight.frames.read(0), picture) for picture in part.pictures[:25]]))
    taken_s = (part.frames_ns - part.frames_ns[first]) * 1e-9
    nearest = np.array([int(np.argmin(np.abs(taken_s - s))) for s in since_s])
    assert np.abs(taken_s[nearest] - since_s).max() < 0.01
    assert (flight.imu is not None) == case.gyro
    if flight.imu is not None:
        inside = (t_ns >= flight.imu.t_ns[0]) & (t_ns <= flight.imu.t_ns[-1])
        assert inside.mean() > 0.5
        turned = _turned(flight.imu.t_ns, flight.imu.gyro_rad_s, t_ns[inside])
        true = _turned(part.t_ns, part.gyro, part.frames_ns[nearest][inside])
        assert np.abs(turned - true).max() < MAX_TURN_RAD
    estimates = estimates[np.isfinite(estimates["heading_rad"])]
    heading = np.interp(t_ns, estimates["timestamp_ns"], np.unwrap(estimates["heading_rad"]))
    known = since_s > 2.0 if since_s[-1] > 3.0 else since_s > 0.8
    away = heading[known] - part.heading_rad[nearest][known]
    away = (away + np.pi / 2) % np.pi - np.pi / 2
    assert np.degrees(np.sqrt((away**2).mean())) < case.rmse_deg


def _turned(t_ns: TimeArray, gyro: FloatArray, at_ns: TimeArray) -> FloatArray:
    """Integral (n, 3) of the rates from the first of some times on."""
    t_s = (t_ns - at_ns[0]) * 1e-9
    total = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(np.diff(t_s)[:, None] * (gyro[1:] + gyro[:-1]) / 2, axis=0)]
    )
    at_frames = np.stack([np.interp((at_ns - at_ns[0]) * 1e-9, t_s, axis) for axis in total.T], axis=1)
    return np.asarray(at_frames - at_frames[0])


def _difference(a: GreyImage, b: GreyImage) -> float:
    if a.shape != b.shape:
        import cv2

        b = np.asarray(cv2.resize(b, a.shape[::-1], interpolation=cv2.INTER_AREA))
    return min(float(np.abs(a.astype(int) - c.astype(int)).mean()) for c in (b, b[::-1, ::-1]))
