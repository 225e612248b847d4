"""GoPro's telemetry (GPMF): gyroscope and accelerometer in a separate track of the video file.

A packet holds nested records: four letters, a type, the size of a sample, how many there are, and the samples, most
significant byte first, padded to four bytes. ``DEVC`` holds a ``STRM`` for each sensor, in which ``SCAL`` divides
what follows. Samples have no times: they are spread evenly from each packet to the next.

The order of the axes differs between models and is not changed; ``camera_axis`` declares the one along which the
camera looks, see `fusion.logs.manifest.manifest`. The sign of a turn does not depend on it, but on gravity.

Format: https://github.com/gopro/gpmf-parser
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion.flight import FloatArray, ImuStream, TimeArray, VectorStream
from fusion.logs.imu_series import joined_imu
from fusion.logs.samples import WithProblems
from fusion.logs.series import Where

if TYPE_CHECKING:
    from av.container import InputContainer

NESTED = 0
DEVICE, STREAM, SCALE, GYRO, ACCEL = b"DEVC", b"STRM", b"SCAL", b"GYRO", b"ACCL"
_TYPES = {"b": ">i1", "B": ">u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8"}
_HEADER = struct.Struct(">4sBBH")


@dataclass(slots=True)
class _Sensor:
    """Packets of one sensor: start of each, in seconds of the video, and its samples."""

    begins_s: list[float] = field(default_factory=list)
    values: list[FloatArray] = field(default_factory=list)
    end_s: float = 0.0

    def add(self, begin_s: float, end_s: float, values: FloatArray) -> None:
        """Add a packet's samples (n, 3)."""
        self.begins_s.append(begin_s)
        self.values.append(values)
        self.end_s = end_s

    def stream(self, start_ns: int) -> VectorStream:
        """Return the samples with their times, spread evenly between packets."""
        counts = np.array([len(values) for values in self.values])
        first = np.concatenate([[0], np.cumsum(counts)])
        known_s = np.array([*self.begins_s, self.end_s])
        t_s = np.interp(np.arange(first[-1]), first, known_s)
        return VectorStream(start_ns + np.rint(t_s * 1e9).astype(np.int64), np.concatenate(self.values))


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """Gyroscope, rad/s, and accelerometer, m/s^2, along the camera's own axes; None if missing."""

    gyro: VectorStream
    accel: VectorStream | None

    @property
    def t_ns(self) -> TimeArray:
        """Times (n,) of the gyroscope."""
        return self.gyro.t_ns

    def imu(self, where: Where) -> WithProblems[ImuStream]:
        """Join the two by time."""
        return joined_imu(self.gyro.t_ns, self.gyro.xyz, self.accel, where, where)


def read_telemetry(container: InputContainer, first_frame_s: float, start_ns: int) -> Telemetry | None:
    """Read the telemetry of an open video; None if it has none.

    Parameters
    ----------
    container
        The file.
    first_frame_s, start_ns
        The first frame's time stamp in seconds, and its time in the flight.
    """
    sensors = {GYRO: _Sensor(), ACCEL: _Sensor()}
    for track in container.streams.data:
        container.seek(0)
        for packet in container.demux(track):
            data = bytes(packet)
            if packet.pts is None or not data.startswith(DEVICE):
                continue
            unit_s = Fraction(packet.time_base or 1)
            begin_s = float(packet.pts * unit_s) - first_frame_s
            end_s = begin_s + float((packet.duration or 0) * unit_s)
            for key, values in samples_of(data):
                sensors[key].add(begin_s, end_s, values)
    if not sensors[GYRO].values:
        return None
    accel = sensors[ACCEL].stream(start_ns) if sensors[ACCEL].values else None
    return Telemetry(sensors[GYRO].stream(start_ns), accel)


def samples_of(data: bytes) -> Iterator[tuple[bytes, FloatArray]]:
    """Yield the samples (n, 3) of the sensors in a packet, in their units."""
    for key, kind, _, payload in _records(data):
        if kind == NESTED and key != STREAM:
            yield from samples_of(payload)
        elif key == STREAM:
            scale = np.ones(1)
            for name, form, size, content in _records(payload):
                if name == SCALE:
                    scale = _numbers(content, form, size).astype(float).ravel()
                elif name in (GYRO, ACCEL):
                    values = _numbers(content, form, size)
                    if values.ndim == 2 and values.shape[1] == 3 and len(scale) in (1, 3) and scale.all():
                        yield name, values.astype(float) / scale


def _records(data: bytes) -> Iterator[tuple[bytes, int, int, bytes]]:
    """Yield key, type, sample size and content of consecutive records, up to a truncated one."""
    at = 0
    while at + _HEADER.size <= len(data):
        key, kind, size, repeat = _HEADER.unpack_from(data, at)
        length = size * repeat
        content = data[at + _HEADER.size : at + _HEADER.size + length]
        if len(content) < length or key == b"\0\0\0\0":
            return
        yield key, kind, size, content
        at += _HEADER.size + (length + 3) // 4 * 4


def _numbers(content: bytes, form: int, size: int) -> np.ndarray[Any, Any]:
    """Numbers (n, k) of a record; none if its type is unknown."""
    dtype = np.dtype(_TYPES.get(chr(form), "V1"))
    if dtype.kind == "V" or not size or size % dtype.itemsize:
        return np.zeros((0, 0))
    return np.frombuffer(content, dtype).reshape(-1, size // dtype.itemsize)
