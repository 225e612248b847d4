"""Short hashes of everything that a flight's result depends on: the log's files, the settings, the program."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from platform import python_version
from typing import Any

from fusion.files import sha256_of
from fusion.logs.manifest.file import find_manifest, read_manifest
from fusion.logs.manifest.manifest import files_of
from vision.errors import InputError

_LENGTH = 16  # hexadecimal digits: 64 bits are enough for a million flights


def flight_files(path: Path) -> list[Path]:
    """Return all files of a flight, sorted: those in its folder, and those that its manifest names."""
    manifest = find_manifest(path)
    named = {path} if manifest is None else {manifest, path}
    if manifest is not None:
        with suppress(InputError):  # an invalid manifest is reported when the flight is fused
            named |= {file for _, file in files_of(read_manifest(manifest))}
    return sorted({file for place in named for file in _files_below(place)})


def _files_below(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
        return
    for folder, folders, names in os.walk(path):
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (Path(folder, name) for name in names if not name.startswith("."))


def stamp_of(path: Path) -> tuple[str, int]:
    """Return a quick hash of names, sizes and modification times of a flight's files, and their total bytes."""
    digest, size = hashlib.sha256(), 0
    for file in flight_files(path):
        try:
            found = file.stat()
        except OSError:
            continue
        size += found.st_size
        digest.update(f"{file}\0{found.st_size}\0{found.st_mtime_ns}\0".encode(errors="surrogateescape"))
    return digest.hexdigest()[:_LENGTH], size


def hashes_of(path: Path) -> dict[Path, str]:
    """Return the SHA-256 of each file of a flight, without pipes, which may never end.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    return {file: sha256_of(file) for file in flight_files(path) if file.is_file()}


def content_of(path: Path, hashes: Mapping[Path, str]) -> str:
    """Return a hash of the contents of a flight's files, from `hashes_of`, and of their relative names."""
    digest = hashlib.sha256()
    for file, content in hashes.items():
        digest.update(os.path.relpath(file, path).encode(errors="surrogateescape") + b"\0" + content.encode())
    return digest.hexdigest()[:_LENGTH]


def settings_hash(settings: Mapping[str, Any], *files: Path | None) -> str:
    """Return a hash of settings as plain values, and of the contents of their files."""
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True, default=str).encode())
    for file in files:
        digest.update(b"\0" if file is None else file.read_bytes())
    return digest.hexdigest()[:_LENGTH]


@cache
def program_version() -> str:
    """Return the version with a hash of the source, to detect changes in a checkout."""
    digest = hashlib.sha256()
    for package in ("fusion", "vision"):
        spec = find_spec(package)
        for root in (spec.submodule_search_locations or ()) if spec is not None else ():
            for file in sorted(Path(root).rglob("*")):
                if file.suffix in (".py", ".onnx", ".npz", ".json"):
                    digest.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
    return f"{version('corridor-fusion')}+{digest.hexdigest()[:8]}"


@cache
def library_versions() -> str:
    """Return the versions of Python and of the libraries that affect the numbers."""
    modules = {name: import_module(name).__version__ for name in ("numpy", "scipy", "cv2", "numba")}
    versions = {"python": python_version()} | modules
    return ", ".join(f"{name} {number}" for name, number in versions.items())
