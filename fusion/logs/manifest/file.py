"""``flight.toml``, a manifest as a file: found, read, checked and written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from fusion.files import replacing
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.manifest.manifest import CameraSource, ImuSource, Manifest, RangeSource, StreamSource
from fusion.logs.manifest.text import manifest_text
from fusion.settings.sentences import OWN_CHECK, UNKNOWN_NAME, Complaint, complaints, did_you_mean
from fusion.settings.toml import read_toml
from vision import InputError

MANIFEST_NAME = "flight.toml"

_WORDS = {"path_type": "it should be a path in quotes", "model_type": "it should be a table"}


def find_manifest(path: Path) -> Path | None:
    """Return the manifest at a path: a TOML file, or ``flight.toml`` in a folder; else None."""
    if path.is_dir():
        inside = path / MANIFEST_NAME
        return inside if inside.is_file() else None
    return path if path.suffix.lower() == ".toml" and path.is_file() else None


def read_manifest(path: str | Path) -> Manifest:
    """Read and check a manifest; its paths become absolute.

    Raises
    ------
    InputError
        If the file is missing or truncated, or has an unknown key or a value out of bounds.
    """
    path = Path(path)
    return make_manifest(read_toml(path, 'file = "video.mp4"'), file=path)


def make_manifest(values: Mapping[str, Any], *, file: Path | None = None) -> Manifest:
    """Check a manifest's values; paths are relative to the file's folder, or else to the current one.

    Raises
    ------
    InputError
        With the key, its value and the remedy.
    """
    try:
        manifest = Manifest.model_validate(dict(values))
    except ValidationError as error:
        problem, remedy = _explain(complaints(error, Manifest)[0])
        raise InputError(problem, file=file, remedy=remedy) from error
    try:
        return _with_paths(manifest, (file or Path("x")).absolute().parent)
    except (ValueError, RuntimeError) as error:  # invalid path: a null byte, an unknown user
        raise InputError(f"names a path that cannot be: {error}", file=file, remedy="correct it") from error


def _with_paths(manifest: Manifest, folder: Path) -> Manifest:
    def absolute(model: BaseModel) -> dict[str, Any]:
        changes: dict[str, Any] = {}
        for key, value in model:
            if isinstance(value, Path):
                changes[key] = (folder / value.expanduser()).resolve()
            elif isinstance(value, StreamSource) and key in model.model_fields_set:
                changes[key] = value.model_copy(update=absolute(value))
        return changes

    return manifest.model_copy(update=absolute(manifest))


def _explain(complaint: Complaint) -> tuple[str, str | None]:
    """Return the error of a problem, with its remedy."""
    if complaint.kind == OWN_CHECK:
        prefix = f"[{complaint.path[0]}] " if complaint.path else ""
        problem, _, remedy = complaint.message.partition(": ")
        return prefix + problem, remedy or "see `corridor fuse --help` for an example"
    if complaint.kind == UNKNOWN_NAME:
        return f"unknown key {complaint.dotted} = {complaint.shown}", _place_of(complaint)
    message = _WORDS.get(complaint.kind) or complaint.message
    known = complaint.field
    return f"{complaint.dotted} = {complaint.shown}: {message}", known.description if known else None


def _place_of(complaint: Complaint) -> str:
    """Suggest what an unknown key may mean, or the table it belongs to."""
    key, model = complaint.name, complaint.model
    near = did_you_mean(key, model.model_fields, cutoff=0.72)
    if near:
        return near
    places: dict[str, type[BaseModel]] = {
        "at the top": Manifest,
        "in [camera]": CameraSource,
        "in [imu]": ImuSource,
        "in [range]": RangeSource,
        "in a stream's table": StreamSource,
        "in a stream's columns": ColumnMap,
    }
    for place, other in places.items():
        if other is not model and key in other.model_fields:
            return f"{key} belongs {place}"
    near = did_you_mean(key, model.model_fields) or f"known here: {', '.join(model.model_fields)}."
    return f"{near} Settings of the filter belong in the file for --config"


def write_manifest(manifest: Manifest, path: str | Path, notes: Mapping[str, str] | None = None) -> None:
    """Write a manifest with a comment on each line that needs one; `read_manifest` gives it back.

    Parameters
    ----------
    manifest
        Paths that share more than the root with the file's folder are made relative to it.
    path
        The file, written atomically.
    notes
        Further comments by key, such as ``{"camera.clock_offset_s": "sigma 0.8 ms, corridor align"}``.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    path = Path(path)
    with replacing(path) as draft:
        draft.write_text(manifest_text(manifest, path.absolute().parent, notes or {}), encoding="utf-8")
