"""Advice on a log: what can be fused, what is missing, and how to supply it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from fusion.inspection.findings import StreamFindings
from fusion.logs.contents import Kind
from fusion.logs.plausibility.findings import Finding, Severity
from vision import InputError


class Matter(StrEnum):
    """Subject of a sentence."""

    FUSE = "fuse"  # what can be fused as it is
    MISSING = "missing"  # needed before anything can be fused
    BETTER = "better"  # would help, but is not needed


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence of advice."""

    matter: Matter
    text: str


_WHAT = {
    Kind.FRAMES: "pictures",
    Kind.IMU: "gyroscope and accelerometer",
    Kind.ATTITUDE: "attitude",
    Kind.POSITION: "position",
    Kind.VELOCITY: "velocity",
    Kind.RANGE: "distance to the floor",
}


def advise(
    name: str,
    streams: Sequence[StreamFindings],
    findings: Sequence[Finding],
    unclear: Mapping[Kind, str],
    refusal: InputError | None = None,
) -> Iterator[Sentence]:
    """Yield what can be fused, what must be supplied first, and what would improve the result.

    Parameters
    ----------
    name
        The user's name of the log.
    streams
        All streams found in it.
    findings
        Implausible properties of the chosen streams.
    unclear
        Reasons why no topic of a kind was chosen.
    refusal
        Reason why the flight would be rejected.
    """
    usable = {stream.kind: stream for stream in streams if stream.chosen and _is_usable(stream)}
    missing = list(_missing(name, usable, findings, unclear))
    camera = usable.get(Kind.FRAMES)
    is_calibrated = camera is not None and camera.camera is not None
    is_reported = any(refusal is not None and refusal.problem in text for text in missing)
    if refusal is not None and not is_reported and (is_calibrated or not missing):
        missing.insert(
            0, refusal.problem if refusal.remedy is None else f"{refusal.problem} ({refusal.remedy})"
        )
    yield Sentence(Matter.FUSE, _fusable(name, usable, possible=not missing))
    for text in missing:
        yield Sentence(Matter.MISSING, text)
    for text in _better(usable, unclear):
        yield Sentence(Matter.BETTER, text)


def _is_usable(stream: StreamFindings) -> bool:
    if stream.error is not None or stream.timing.samples == 0:
        return False
    return stream.pictures is None or stream.pictures.first_index is not None


def _fusable(name: str, usable: Mapping[Kind, StreamFindings], *, possible: bool) -> str:
    parts = [f"{_stream_words(stream)} ({stream.name}, {_rate(stream)})" for stream in usable.values()]
    if Kind.FRAMES not in usable:
        held = f"; it has {_listed(parts)}" if parts else ""
        return f"nothing yet: a heading in a corridor needs pictures{held}"
    if possible:
        return f"corridor fuse {name} uses {_listed(parts)}"
    return f"{_listed(parts)}, once the following is resolved"


def _stream_words(stream: StreamFindings) -> str:
    has_accel = stream.imu is None or stream.imu.usual_accel_m_s2 is not None
    return _WHAT[stream.kind] if has_accel else "gyroscope"


def _missing(
    name: str,
    usable: Mapping[Kind, StreamFindings],
    findings: Sequence[Finding],
    unclear: Mapping[Kind, str],
) -> Iterator[str]:
    camera = usable.get(Kind.FRAMES)
    if camera is None:
        if Kind.FRAMES in unclear:
            yield unclear[Kind.FRAMES]
        else:
            yield f"pictures: corridor fuse {name} --video VIDEO --camera CAM.yaml, or [camera] file in a flight.toml"
    elif camera.camera is None:
        has_gyro = Kind.IMU in usable
        yield (
            "the camera's calibration: --camera CAM.yaml (EuRoC, Kalibr, ROS camera_info or OpenCV), or [camera] "
            "calibration in a flight.toml"
            + (
                f"; where there is none, `corridor align {name} --write` finds the focal length"
                if has_gyro
                else ""
            )
        )
    if Kind.IMU not in usable and Kind.IMU in unclear:
        yield unclear[Kind.IMU]
    for finding in findings:
        if finding.severity is Severity.ERROR:
            yield finding.sentence


def _better(usable: Mapping[Kind, StreamFindings], unclear: Mapping[Kind, str]) -> Iterator[str]:
    camera = usable.get(Kind.FRAMES)
    if camera is not None and camera.camera is not None and camera.pictures is not None:
        size = (camera.camera.width_px, camera.camera.height_px)
        for other in camera.pictures.sizes if size in camera.pictures.sizes else ():
            if other != size:
                yield f"pictures of {other[0]}x{other[1]} are left out: the calibration is for {size[0]}x{size[1]}"
    imu = usable.get(Kind.IMU)
    if imu is None and Kind.IMU not in unclear:
        carried = (
            "the attitude's yaw propagates"
            if Kind.ATTITUDE in usable
            else "only a constant-rate model propagates"
        )
        yield f"no gyroscope: {carried} the heading between pictures; --imu LOG names one, or [imu] in a flight.toml"
    no_accel = imu is not None and imu.imu is not None and imu.imu.usual_accel_m_s2 is None
    if no_accel and Kind.ATTITUDE in usable:
        yield "no accelerometer: roll and pitch come from the attitude alone"
    if imu is not None:
        yield from _noise(imu)
    if Kind.ATTITUDE in unclear and Kind.ATTITUDE not in usable:
        yield unclear[Kind.ATTITUDE]
    elif Kind.ATTITUDE not in usable:
        lacks = "neither accelerometer nor attitude" if no_accel else "no attitude stream"
        tilt = "are assumed to be zero" if imu is None else "come from gyroscope and accelerometer"
        yield f"{lacks}: roll and pitch {'come from the gyroscope alone, starting level' if no_accel else tilt}"
    if Kind.VELOCITY in unclear and Kind.VELOCITY not in usable:
        yield unclear[Kind.VELOCITY]
    if Kind.RANGE in unclear and Kind.RANGE not in usable:
        yield unclear[Kind.RANGE]


def _noise(imu: StreamFindings) -> Iterator[str]:
    found = imu.imu
    if found is None:
        return
    measured = found.at_rest.gyro if found.at_rest is not None else None
    remark = "" if measured is None else f"; at rest it is {measured:.2g} rad/s/sqrt(Hz)"
    if found.declared_gyro_noise is None:
        yield (
            f"the gyroscope's noise is not declared, so a default is used{remark}; name Kalibr's imu.yaml with "
            "[imu] noise in a flight.toml"
        )
    elif measured is not None and not 1 / 3 < measured / found.declared_gyro_noise < 3:
        yield (
            f"the gyroscope is declared with {found.declared_gyro_noise:.2g} rad/s/sqrt(Hz) but has {measured:.2g} "
            "at rest: correct the declaration"
        )


def _rate(stream: StreamFindings) -> str:
    rate = stream.timing.rate_hz
    return f"{stream.timing.samples} samples" if rate is None else f"{rate:.3g} Hz"


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1]
