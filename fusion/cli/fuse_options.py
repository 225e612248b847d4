"""Input of ``corridor fuse``: a flight, a manifest, a log, or separate files."""

from __future__ import annotations

from pathlib import Path

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
    from fusion.logs import load_flight

    _check_exist(
        {"--imu": imu, "--video": video, "--attitude": attitude, "--camera": camera, "FLIGHT": flight}
    )
    if flight is None and video is None:
        named = imu is not None or attitude is not None or clock_offset_s is not None
        raise InputError("no pictures are named" if named else "no flight is named", remedy=_EXAMPLES)
    return load_flight(flight, camera, imu=imu, video=video, attitude=attitude, clock_offset_s=clock_offset_s)


def _check_exist(named: dict[str, Path | None]) -> None:
    """Raise `InputError` for the first option whose path does not exist."""
    for option, path in named.items():
        if path is not None and not path.exists():
            raise InputError(
                f"there is no such file or folder ({option})", file=path, remedy="check the path"
            )


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
