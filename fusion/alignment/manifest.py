"""An alignment in ``flight.toml``: location of the file, and the changes in it."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion.alignment.result import Alignment, Quantity
from fusion.alignment.text import note_of
from fusion.files import replacing
from fusion.flight import Flight
from fusion.logs.manifest.file import MANIFEST_NAME, find_manifest, read_manifest, write_manifest
from fusion.logs.manifest.manifest import Manifest
from vision.cameras.camera import BodyFrame, Camera
from vision.errors import InputError

_FIRST_LINE = "# Found by corridor align"


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A flight to be aligned, and whether its camera is calibrated."""

    flight: Flight
    camera_known: bool


def load_to_align(path: str | Path, camera: Path | None = None) -> Loaded:
    """Read a flight as `fusion.load_flight` does, even if its camera is not calibrated.

    Raises
    ------
    InputError
        As `fusion.load_flight`.
    """
    from fusion.logs import load_flight
    from fusion.logs.manifest.assembly import assemble_flight

    path = Path(path)
    if camera is None and path.exists():
        described = find_manifest(path)
        manifest = Manifest(log=path.resolve()) if described is None else read_manifest(described)
        size = _size_of_uncalibrated(manifest)
        if size is not None:
            from vision.axis.field_of_view import ordinary_field_of_view

            view = ordinary_field_of_view(*size)
            assumed = Camera.from_fov(*size, view.horizontal_rad)
            return Loaded(assemble_flight(manifest, assumed), False)
    return Loaded(load_flight(path, camera=camera), True)


def _size_of_uncalibrated(manifest: Manifest) -> tuple[int, int] | None:
    """Width and height of the pictures if neither manifest nor log has a calibration; None if one has."""
    from fusion.logs.contents import Kind
    from fusion.logs.manifest.sources import ManifestLog
    from fusion.logs.pictures.camera_folder import size_of_pictures

    path = manifest.camera.file or manifest.log
    if manifest.camera.calibration is not None or path is None or not path.exists():
        return None
    log = ManifestLog(manifest)
    topic = log.choose(Kind.FRAMES).value
    if topic is None or log.camera(topic) is not None:
        return None
    return size_of_pictures(log.frames(topic).value)


def place_of(flight: Path) -> Path:
    """Return the path of a flight's own manifest, which may not exist yet: in its folder, or beside its log.

    Raises
    ------
    InputError
        If something else is there.
    """
    described = find_manifest(flight)
    if described is not None:
        return described
    place = flight / MANIFEST_NAME if flight.is_dir() else flight.with_suffix(".toml")
    if place.exists():
        raise InputError("is there already", file=place, remedy="name another file with -o")
    return place


def former_of(place: Path) -> Path:
    """Return where the first former file is kept, with its comments."""
    return place.with_name(f"{place.name}.bak")


def check_place(place: Path) -> None:
    """Raise `InputError` if a manifest cannot be written, before the work is done."""
    if place.suffix.lower() != ".toml":
        raise InputError("is not named like a manifest", file=place, remedy="name it something.toml")
    if place.is_dir():
        raise InputError("is a folder", file=place, remedy=f"name a file, such as {place / MANIFEST_NAME}")
    folder = place.absolute().parent
    if not folder.is_dir():
        raise InputError("there is no such folder", file=folder, remedy="make it, or choose another place")
    if place.exists():
        try:
            read_manifest(place)
        except InputError as error:
            raise InputError(
                "is there already, and is not a manifest", file=place, remedy="name another"
            ) from error
    if not os.access(folder, os.W_OK):
        raise InputError("cannot be written to", file=folder, remedy="choose another place with -o")


def write_alignment(alignment: Alignment, flight: Flight, place: Path) -> tuple[Path, ...]:
    """Write a manifest with an alignment's corrections, and a calibration if there was none.

    Quantities that are not usable or not significant stay as they are. A former file is kept as `former_of` it,
    unless one is kept already: the first is the one written by hand.

    Returns
    -------
    tuple of Path
        The files written.

    Raises
    ------
    InputError
        If the flight does not come from a log, or a file cannot be written.
    """
    if not isinstance(flight.manifest, Manifest):
        raise InputError(f"flight {flight.name} came from no log", remedy="load it with fusion.load_flight")
    manifest, notes = corrected(flight.manifest, alignment)
    written = [place]
    if not alignment.camera_known:
        calibration = place.absolute().with_name(f"{place.stem}_camera.yaml")
        _write_calibration(alignment, calibration, _body_frame(manifest, calibration))
        source = manifest.camera.model_copy(update={"calibration": calibration})
        manifest = manifest.model_copy(update={"camera": source})
        written.insert(0, calibration)
    if place.exists() and not former_of(place).exists():
        shutil.copyfile(place, former_of(place))
    write_manifest(manifest, place, notes)
    return tuple(written)


def corrected(manifest: Manifest, alignment: Alignment) -> tuple[Manifest, dict[str, str]]:
    """Add an alignment's corrections to those in a manifest; return it with their comments."""
    source = manifest.camera
    notes: dict[str, str] = {}
    changes: dict[str, float] = {}

    def put(quantity: Quantity, value: float, digits: int) -> None:
        if quantity.changes:
            changes[quantity.name] = round(value, digits)
        if quantity.usable:
            notes[f"camera.{quantity.name}"] = note_of(quantity)

    put(alignment.clock_rate, source.clock_rate * alignment.clock_rate.value, 6)
    put(alignment.clock_offset, source.clock_offset_s + alignment.clock_offset.value, 6)
    if alignment.camera_known:
        put(alignment.focal_scale, source.focal_scale * alignment.focal_scale.value, 5)
        put(alignment.mount_yaw, source.mount_yaw_rad + alignment.mount_yaw.value, 5)
        put(alignment.mount_pitch, source.mount_pitch_rad + alignment.mount_pitch.value, 5)
        put(alignment.mount_roll, source.mount_roll_rad + alignment.mount_roll.value, 5)
    return manifest.model_copy(update={"camera": source.model_copy(update=changes)}), notes


def _body_frame(manifest: Manifest, calibration: Path) -> BodyFrame:
    """Return the body axes in which a calibration at this path will be read."""
    from fusion.logs.manifest.opening import open_as_declared
    from vision.cameras.calibration import check_body_frame, read_body_frame

    source = manifest.camera
    path = source.file or manifest.log
    frame = None if path is None else open_as_declared(path, source).body_frame
    if frame is None:
        return read_body_frame(calibration.parent.parent / "body.yaml")
    return check_body_frame(frame)


def _write_calibration(alignment: Alignment, path: Path, body_frame: BodyFrame) -> None:
    """Write a camera as ``sensor.yaml`` in the given body axes."""
    from vision.cameras.calibration import to_frd

    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(_FIRST_LINE):
        raise InputError(
            "is there already", file=path, remedy="move it away, or name the camera with --camera"
        )
    camera, focal = alignment.camera, alignment.focal_scale
    pose = np.eye(4)
    pose[:3, :3] = to_frd(body_frame) @ camera.R_body_camera
    rows = ",\n         ".join(", ".join(f"{value:.9g}" for value in row) for row in pose.tolist())
    pinhole = ", ".join(f"{v:.8g}" for v in (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px))
    sigma_px = focal.sigma / focal.value * camera.fx_px
    text = (
        f"{_FIRST_LINE} from the flight itself: focal length {camera.fx_px:.1f} +- {sigma_px:.1f} px, no distortion\n"
        "# and the principal point in the middle assumed. A calibration with a target is better.\n"
        f"sensor_type: camera\nT_BS:   # camera (x right, y down, z forward) to body {body_frame}\n"
        f"  cols: 4\n  rows: 4\n  data: [{rows}]\n"
        f"resolution: [{camera.width_px}, {camera.height_px}]\ncamera_model: pinhole\n"
        f"intrinsics: [{pinhole}]   # fu, fv, cu, cv\n"
        "distortion_model: none\ndistortion_coefficients: []\n"
    )
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
