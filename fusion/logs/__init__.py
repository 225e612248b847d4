"""Logs of flights, one module per format, read into a `fusion.flight.Flight`.

May import `fusion.flight`, `fusion.files`, `fusion.settings` and `vision`. Begin reading at `fusion.logs.contents`,
the interface of an opened log, and `fusion.logs.series`, the readers' common functions.

A format is a module with two functions, ``recognises(path)`` and ``open_log(path)``; to add one, write the
module and list it in `FORMATS`. A module is imported only when a log is opened.
"""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from fusion.logs.contents import Kind, LogContents
from fusion.logs.samples import refuse_placeholder
from vision import Camera, InputError

if TYPE_CHECKING:
    from fusion.flight import Flight
    from fusion.logs.manifest.manifest import Manifest

#: In the order of recognition: by magic bytes first, by names and extensions last.
FORMATS = {
    "ASL / EuRoC folder (mav0/cam0 ...)": "fusion.logs.asl",
    "PX4 ULog": "fusion.logs.autopilot.ulog",
    "ROS bag or MCAP": "fusion.logs.rosbag.bag",
    "ArduPilot DataFlash log": "fusion.logs.autopilot.dataflash",
    "MAVLink tlog": "fusion.logs.autopilot.tlog",
    "video": "fusion.logs.pictures.video",
    "TUM RGB-D, UZH-FPV or KITTI folder": "fusion.logs.datasets",
    "folder of a phone's sensors": "fusion.logs.csv.phone_folder",
    "folder of pictures": "fusion.logs.pictures.picture_folder",
    "Gyroflow IMU log": "fusion.logs.csv.gyroflow",
    "CSV": "fusion.logs.csv.columns",
}


#: Formats with pictures or samples only, which need other files to make a flight.
_PICTURES = ("fusion.logs.pictures.video", "fusion.logs.pictures.picture_folder")
_PARTS = (
    *_PICTURES,
    "fusion.logs.csv.phone_folder",
    "fusion.logs.csv.gyroflow",
    "fusion.logs.csv.columns",
)

_PACKED, _WRITTEN = (
    "unpack it first, and give what is in it",
    "write its samples as CSV with a column of times",
)
#: Remedies for files that contain a log in another form.
_OTHER_FILES = dict.fromkeys(
    (".gz", ".bz2", ".xz", ".zst", ".zip", ".tar", ".7z", ".rar"), _PACKED
) | dict.fromkeys(
    (".xlsx", ".xls", ".ods", ".npy", ".npz", ".mat", ".parquet", ".h5", ".hdf5", ".json", ".jsonl", ".pkl"),
    _WRITTEN,
)


class LogFormat(Protocol):
    """Interface of a module in `FORMATS`."""

    def recognises(self, path: Path) -> bool:
        """Return whether an existing file or folder has this format, without reading more than needed."""

    def open_log(self, path: Path) -> LogContents:
        """Open it and list its contents."""


def open_log(path: str | Path) -> LogContents:
    """Open a log of any supported format.

    Raises
    ------
    InputError
        If it does not exist, has no known format, or cannot be opened.
    """
    path = _existing(path)
    refuse_placeholder(path)
    module = format_of(path)
    if module is None:
        remedy = _OTHER_FILES.get(path.suffix.lower()) or "give a flight.toml, " + ", ".join(FORMATS)
        remedy = _manifest_remedy(path) or remedy
        within = _flight_within(path)
        if within is not None:
            remedy = f"give a flight within it, such as {within}; `corridor batch {path}` fuses all of them"
        raise InputError("is not a flight of a known format", file=path, remedy=remedy)
    return cast(LogFormat, import_module(module)).open_log(path)


def _existing(path: object) -> Path:
    found = _as_path(path, "path")
    if not found.exists():
        raise InputError("there is no such file or folder", file=found, remedy="check the path")
    return found


def _as_path(value: object, name: str) -> Path:
    if not isinstance(value, str | PathLike):
        raise InputError(f"{name} is of type {type(value).__name__}", remedy="give a path as str or Path")
    return Path(value)


def _flight_within(path: Path) -> Path | None:
    """Return the first flight in a folder; pictures or samples alone do not count."""
    from fusion.logs.manifest.file import find_manifest

    for inside in sorted(path.iterdir()) if path.is_dir() else ():
        with suppress(InputError):  # unreadable files are no example
            if find_manifest(inside) is not None or format_of(inside) not in (None, *_PARTS):
                return inside
    return None


def _manifest_remedy(path: Path) -> str | None:
    """Propose a manifest of the pictures and samples in a folder; None if it lacks one of them."""
    places: dict[str, str] = {}
    for inside in sorted(path.iterdir()) if path.is_dir() else ():
        with suppress(InputError):
            module = format_of(inside)
            if module in _PICTURES:
                places.setdefault("camera", inside.name)
            elif module in _PARTS:
                topics = cast(LogFormat, import_module(module)).open_log(inside).topics
                if any(topic.kind is Kind.IMU for topic in topics):
                    places.setdefault("imu", inside.name)
    if not {"camera", "imu"} <= places.keys():
        return None
    tables = ", ".join(f'[{table}] file = "{places[table]}"' for table in ("camera", "imu"))
    return f"list its files in {path / 'flight.toml'}, as in {tables}; `corridor fuse --help` has an example"


def format_of(path: Path) -> str | None:
    """Return the module of `FORMATS` that reads an existing file or folder; None if none does.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    for module in FORMATS.values():
        if find_spec(module) is None:
            continue
        log_format = cast(LogFormat, import_module(module))
        try:
            known = log_format.recognises(path)
        except OSError as error:
            raise InputError(
                f"cannot be read: {error.strerror}", file=path, remedy="check the file"
            ) from error
        if known:
            return module
    return None


def load_flight(
    path: str | Path | None = None,
    camera: Camera | str | Path | None = None,
    *,
    imu: str | Path | None = None,
    video: str | Path | None = None,
    attitude: str | Path | None = None,
    clock_offset_s: float | None = None,
) -> Flight:
    """Read a logged flight of any supported format, or one whose files are named one by one.

    Parameters
    ----------
    path
        A ``flight.toml`` or its folder, an ASL / EuRoC flight folder or the ``mav0`` in it, or a log file that
        contains pictures. None: the files below make the flight.
    camera
        Calibration in place of the log's own: a `Camera`, or a file whose extrinsics refer to the log's body axes.
    imu, video, attitude
        A log for the IMU's samples (without ``path``, for all streams but the pictures), a video or a folder of
        pictures, and a log for the attitude alone; they replace the streams of ``path``.
    clock_offset_s
        Added to the pictures' times to give those of the rest.

    Returns
    -------
    Flight
        In SI units, body FRD, world z down. What was dropped or repaired is listed in ``problems``.

    Raises
    ------
    InputError
        If the log cannot be used; in one line: file, field, value and remedy.
    """
    from fusion.logs.manifest.separate import manifest_of_files

    if path is None and video is None:
        raise InputError("no pictures are named", remedy="give a flight, or video and imu")
    if camera is not None and not isinstance(camera, Camera):
        camera = _as_path(camera, "camera")
    if isinstance(camera, Path) and not camera.exists():
        raise InputError("there is no such file", file=camera, remedy="check --camera")
    if all(one is None for one in (imu, video, attitude, clock_offset_s)):
        return _load_whole(_existing(path), camera)
    flight, *files = (None if one is None else _existing(one) for one in (path, imu, video, attitude))
    manifest = manifest_of_files(
        flight, imu=files[0], video=files[1], attitude=files[2], clock_offset_s=clock_offset_s
    )
    return load_manifest(manifest, camera, flight or files[0] or files[1])


def _load_whole(path: Path, camera: Camera | Path | None) -> Flight:
    """Read the flight of a manifest, or of a log that contains everything."""
    from fusion.logs.manifest.file import MANIFEST_NAME, find_manifest, read_manifest
    from fusion.logs.manifest.manifest import Manifest

    described = find_manifest(path)
    if described is None:
        return load_manifest(Manifest(log=path.resolve()), camera, path)
    manifest = read_manifest(described)
    if manifest.name is None:
        name = described.resolve().parent.name if described.name == MANIFEST_NAME else described.stem
        manifest = manifest.model_copy(update={"name": name})
    return load_manifest(manifest, camera, described)


def load_manifest(
    manifest: Manifest, camera: Camera | Path | None = None, path: Path | None = None
) -> Flight:
    """Read the flight that a manifest describes; ``path`` is named if the streams contradict each other.

    Raises
    ------
    InputError
        As `load_flight`.
    """
    from fusion.logs.manifest.assembly import checked_flight
    from fusion.logs.manifest.sources import ManifestLog

    if isinstance(camera, Path):
        manifest, camera = manifest.with_calibration(camera), None
    sources = ManifestLog(manifest, camera=camera)
    return checked_flight(sources, path or sources.path)
