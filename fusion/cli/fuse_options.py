"""Input of ``corridor fuse``: a flight, a manifest, a log, or separate files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fusion.flight import Flight
from vision.errors import InputError

_EXAMPLES = "corridor fuse FLIGHT, or corridor fuse --imu LOG --video VIDEO --camera CAM.yaml"


def flight_from_options(
    flight: Path | None = None,
    *,
    imu: Path | None = None,
    video: Path | None = None,
    attitude: Path | None = None,
    camera: Path | None = None,
    clock_offset_s: float | None = None,
) -> Flight:
    """Load the flight that the options of ``corridor fuse`` name.

    Parameters
    ----------
    flight
        A flight's folder, a manifest or a log; the other options override its streams.
    imu
        A log for the IMU's samples; without ``flight``, for all streams but the pictures.
    video
        A video or a folder of pictures.
    attitude
        A log for the attitude alone.
    camera
        A calibration file.
    clock_offset_s
        Added to the pictures' times to give those of the rest.

    Raises
    ------
    InputError
        If files are missing or cannot be read.
    """
    from fusion.logs import load_flight, load_manifest
    from fusion.logs.manifest.file import make_manifest

    _check_exist(
        {"--imu": imu, "--video": video, "--attitude": attitude, "--camera": camera, "FLIGHT": flight}
    )
    if imu is None and video is None and attitude is None and clock_offset_s is None:
        if flight is None:
            raise InputError("no flight is named", remedy=_EXAMPLES)
        return load_flight(flight, camera=camera)
    if flight is None and video is None:
        raise InputError("no pictures are named", remedy=_EXAMPLES)
    values = _values_of_flight(flight)
    if flight is None and video is not None:
        values["name"] = video.name if video.is_dir() else video.stem
    _put(values, "camera", {"file": video, "calibration": camera})
    if clock_offset_s is not None:
        values.setdefault("camera", {})["clock_offset_s"] = float(clock_offset_s)
    if flight is None and imu is not None:
        values["log"] = imu
    else:
        _put(values, "imu", {"file": imu})
    _put(values, "attitude", {"file": attitude})
    return load_manifest(make_manifest(values), path=flight or imu or video)


def _check_exist(named: dict[str, Path | None]) -> None:
    """Raise `InputError` for the first option whose path does not exist."""
    for option, path in named.items():
        if path is not None and not path.exists():
            raise InputError(
                f"there is no such file or folder ({option})", file=path, remedy="check the path"
            )


def _values_of_flight(flight: Path | None) -> dict[str, Any]:
    """Return the manifest's initial values: the flight's own, or its log's path; none without a flight."""
    from fusion.logs.manifest.file import find_manifest, read_manifest

    if flight is None:
        return {}
    described = find_manifest(flight)
    if described is None:
        return {"log": flight}
    values = read_manifest(described).model_dump(exclude_unset=True)
    values.setdefault("name", described.absolute().parent.name)
    return values


def outside_text(flight: Path | None) -> str | None:
    """List the files outside a flight's folder that its manifest names; None if there are none."""
    from fusion.logs.manifest.file import find_manifest, read_manifest
    from fusion.logs.manifest.manifest import files_outside

    described = None if flight is None else find_manifest(flight)
    if described is None:
        return None
    outside = files_outside(read_manifest(described), described.parent)
    more = f" and {len(outside) - 1} more" if len(outside) > 1 else ""
    return f"{described} reads {outside[0]}{more}, outside its folder" if outside else None


def _put(values: dict[str, Any], table: str, new: dict[str, Path | None]) -> None:
    """Set a stream's new file; entries about the old one, such as topic and columns, are removed."""
    given = {key: path.absolute() for key, path in new.items() if path is not None}
    if not given:
        return
    before = dict(values.get(table, {}))
    if "file" in given:
        for key in ("topic", "columns", "frame", "times", "start_ns", "clock_offset_s"):
            before.pop(key, None)
    values[table] = before | given
