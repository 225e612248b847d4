"""Find flights: below a folder, by a pattern, or in a list."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from glob import glob, has_magic
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, field_validator

from fusion.files import is_inside_folder
from fusion.logs import format_of
from fusion.logs.manifest.file import MANIFEST_NAME, find_manifest, read_manifest
from fusion.logs.manifest.manifest import files_of
from fusion.settings.toml import build, read_toml
from vision.errors import InputError

#: Formats of which one file or folder may be a flight; tables are excluded because they contain no pictures.
_FILES = frozenset(
    {
        "fusion.logs.autopilot.ulog",
        "fusion.logs.rosbag.bag",
        "fusion.logs.autopilot.dataflash",
        "fusion.logs.autopilot.tlog",
        "fusion.logs.pictures.video",
    }
)
_FOLDERS = frozenset({"fusion.logs.rosbag.bag", "fusion.logs.datasets"})
_ASL = "fusion.logs.asl"
#: Formats that a folder of flights may be mistaken for: a vehicle called mav0, a stray picture.
_FOLDERS_WITHOUT_FLIGHTS = frozenset({_ASL, "fusion.logs.pictures.picture_folder"})
_DATE = re.compile(r"(?<!\d)(20\d\d)[-_]?(\d\d)[-_]?(\d\d)(?!\d)")


@dataclass(frozen=True, slots=True)
class FoundFlight:
    """A flight to be fused.

    Parameters
    ----------
    name
        Of the flight, unique in its fleet: its path below the folder that was searched.
    path
        Argument of ``corridor fuse``, absolute.
    vehicle
        Name of the vehicle; empty if unknown.
    date
        ISO 8601 day, from a list or the path; if empty, the log's clock may give it.
    config
        Settings for this flight only; None: those of the batch.
    """

    name: str
    path: Path
    vehicle: str = ""
    date: str = ""
    config: Path | None = None


class _Listed(BaseModel):
    """A flight, or several, in a list."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    path: str = Field(
        min_length=1, description="Flight, folder of flights or pattern, seen from the list's folder."
    )
    name: str | None = Field(default=None, min_length=1, description="Name of the flight.")
    vehicle: str = Field(default="", description="Which vehicle flew.")
    date: str = Field(
        default="", pattern=r"^(\d{4}-\d\d-\d\d)?$", description='The day of the flight: date = "2026-03-01".'
    )
    config: Path | None = Field(default=None, description="Settings for this flight.")

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str | None) -> str | None:
        if name is not None and (not is_inside_folder(name) or Path(name).parts == ()):
            raise ValueError(f"name = {name!r} names a place elsewhere: give a plain name")
        return name


class _FlightList(BaseModel):
    """A list of flights."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    flight: tuple[_Listed, ...] = Field(min_length=1, description="A table [[flight]] for each.")


def find_flights(sources: Iterable[str | Path]) -> tuple[FoundFlight, ...]:
    """Find all flights of the sources, each once, by name.

    Parameters
    ----------
    sources
        Each is a flight, a folder to search, a pattern such as ``logs/*.bag``, or a list: a TOML file with a table
        ``[[flight]]`` per flight.

    Raises
    ------
    InputError
        If a source does not exist, or a list cannot be used. A missing flight of a list is
        returned nevertheless: it becomes a row with the reason.
    """
    found: dict[Path, FoundFlight] = {}
    for source in sources:
        for flight in _of_source(str(source)):
            found.setdefault(flight.path, flight)
    return tuple(sorted(_with_unique_names(list(found.values())), key=lambda flight: flight.name))


def _of_source(source: str) -> Iterator[FoundFlight]:
    path = Path(source)
    if path.is_file() and path.suffix.lower() == ".toml" and "flight" in read_toml(path):
        yield from _listed(path)
    elif path.exists():
        yield from _at(path)
    elif has_magic(source):
        for match in sorted(glob(source, recursive=True)):
            yield from _at(Path(match))
    else:
        raise InputError("there is no such file or folder", file=path, remedy="check the path")


def _listed(file: Path) -> Iterator[FoundFlight]:
    flights = build(_FlightList, read_toml(file), file).flight
    for entry in flights:
        path = file.absolute().parent / entry.path
        if has_magic(entry.path):
            found = [
                flight for match in sorted(glob(str(path), recursive=True)) for flight in _at(Path(match))
            ]
        elif path.exists():
            found = list(_at(path))
        else:
            found = [FoundFlight(path.stem, path)]
        if entry.name is not None and len(found) > 1:
            problem = f"name = {entry.name!r} names {len(found)} flights below {entry.path}"
            raise InputError(problem, file=file, remedy="leave the name out, or list the flights one by one")
        config = None if entry.config is None else (file.absolute().parent / entry.config).resolve()
        for flight in found:
            yield replace(
                flight,
                name=entry.name or flight.name,
                vehicle=entry.vehicle or flight.vehicle,
                date=entry.date or flight.date,
                config=config,
            )


def _at(root: Path) -> Iterator[FoundFlight]:
    """Yield the flight at a path, or those below it."""
    root = root.resolve()
    if root.is_file():
        yield _described(root, root.name, "")
        return
    for path in _search(root, set()):
        inside = path.relative_to(root)
        name = root.name if path == root else inside.as_posix()
        vehicle = inside.parts[0] if len(inside.parts) > 1 else ""
        yield _described(path, name, vehicle)


def _described(path: Path, name: str, vehicle: str) -> FoundFlight:
    manifest = find_manifest(path)
    if manifest is not None:
        name = name.removesuffix(".toml")
        with suppress(InputError):  # reported in the flight's row, when it is read again to be fused
            vehicle = read_manifest(manifest).vehicle or vehicle
    return FoundFlight(name, path, vehicle, date_in(path))


def date_in(path: Path) -> str:
    """Return the last date in a path, as ISO 8601; empty if there is none."""
    for part in reversed(path.parts):
        for match in _DATE.finditer(part):
            try:
                return date(*map(int, match.groups())).isoformat()
            except ValueError:
                continue
    return ""


def _search(folder: Path, seen: set[Path]) -> Iterator[Path]:
    """Yield the flights at and below a folder, without outputs of `corridor` and hidden files."""
    if folder.resolve() in seen or _is_output(folder):
        return
    seen.add(folder.resolve())
    try:
        entries = sorted(entry for entry in folder.iterdir() if not entry.name.startswith("."))
        kind = format_of(folder)
    except (OSError, InputError):
        yield folder  # cannot be read: reported in the flight's row
        return
    has_camera = any((folder / inside).is_dir() for inside in ("cam0", "mav0/cam0"))
    if (folder / MANIFEST_NAME).is_file() or kind in _FOLDERS or (kind == _ASL and has_camera):
        yield folder
        return
    empty = True
    for path in _flights_among(entries, seen):
        empty = False
        yield path
    if empty and kind in _FOLDERS_WITHOUT_FLIGHTS:
        yield folder


def _flights_among(entries: Sequence[Path], seen: set[Path]) -> Iterator[Path]:
    """Yield the flights among a folder's entries; a log that a manifest beside it names is part of that flight."""
    manifests = [path for path in entries if _is_manifest(path)]
    named = {file for path in manifests for file in _files_named(path)}
    for path in entries:
        if path.resolve() in named:
            continue
        if path.is_dir():
            yield from _search(path, seen)
        elif path in manifests or (path.is_file() and _is_log(path)):
            yield path


def _is_manifest(path: Path) -> bool:
    if path.suffix.lower() != ".toml" or not path.is_file():
        return False
    try:
        values = read_toml(path)
    except InputError:
        return False
    camera = values.get("camera")
    return "log" in values or (isinstance(camera, dict) and "file" in camera)


def _files_named(manifest: Path) -> set[Path]:
    try:
        return {path.resolve() for _, path in files_of(read_manifest(manifest))}
    except InputError:
        return set()


def _is_log(path: Path) -> bool:
    try:
        return format_of(path) in _FILES
    except InputError:
        return True


def _is_output(folder: Path) -> bool:
    is_fused = (folder / "summary.json").is_file() and (folder / "estimates.csv").is_file()
    return is_fused or (folder / "fleet.jsonl").is_file()


def _with_unique_names(flights: Sequence[FoundFlight]) -> Iterator[FoundFlight]:
    """Prefix a name with as much of the path as makes it unique."""
    names = {flight.path: flight.name for flight in flights}
    for _ in range(max((len(flight.path.parts) for flight in flights), default=0)):
        taken: dict[str, list[FoundFlight]] = {}
        for flight in flights:
            taken.setdefault(names[flight.path], []).append(flight)
        alike = [flight for same in taken.values() if len(same) > 1 for flight in same]
        if not alike:
            break
        for flight in alike:
            parts, inside = flight.path.parts[1:], len(Path(names[flight.path]).parts)
            above = parts[-inside - 1] if inside < len(parts) else "root"
            names[flight.path] = f"{above}/{names[flight.path]}"
    return (replace(flight, name=names[flight.path]) for flight in flights)
