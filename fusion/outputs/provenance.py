"""Provenance of a fused flight: the program's version, the command, and each input file with its hash."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fusion.files import sha256_of
from fusion.flight import Flight

MAX_FILES = 200  # of one folder; pictures are not hashed one by one
TEXTS = frozenset({".csv", ".toml", ".txt", ".yaml", ".yml"})


def provenance(
    flight: Flight, command: str | None = None, hashes: Mapping[Path, str] | None = None
) -> dict[str, Any]:
    """Return the provenance of a flight for ``summary.json``.

    Parameters
    ----------
    flight
        The flight; its ``manifest`` names its files, unless the caller constructed it.
    command
        The command line, if any.
    hashes
        Known SHA-256 of files; the other files are read.

    Returns
    -------
    dict
        ``version``, ``python``, ``command``, ``inputs`` (path, bytes, sha256 of each file; of a folder, its tables
        and calibrations) and ``camera``, the calibration as it was used.
    """
    import fusion

    camera = flight.camera
    return {
        "version": fusion.__version__,
        "python": platform.python_version(),
        "command": command,
        "inputs": [_described(path, hashes or {}) for path in _files(flight)],
        "camera": {
            "size_px": [camera.width_px, camera.height_px],
            "focal_px": [camera.fx_px, camera.fy_px],
            "centre_px": [camera.cx_px, camera.cy_px],
            "distortion": str(camera.distortion),
            "coefficients": list(camera.coefficients),
            "R_body_camera": camera.R_body_camera.tolist(),
        },
    }


def _files(flight: Flight) -> list[Path]:
    """Files that the manifest names, each once, sorted by path."""
    from fusion.logs.manifest.manifest import Manifest

    manifest = flight.manifest
    if not isinstance(manifest, Manifest):
        return []
    named = [manifest.log, manifest.camera.calibration, manifest.camera.times, manifest.imu.noise]
    named += [source.file for source in manifest.streams().values() if source.use]
    return sorted({file for path in named if path is not None for file in _of(path)})


def _of(path: Path) -> Iterator[Path]:
    if path.is_dir():
        texts = sorted(p for p in path.rglob("*") if p.suffix.lower() in TEXTS and p.is_file())
        yield from texts[:MAX_FILES]
    elif path.is_file():
        yield path


def _described(path: Path, hashes: Mapping[Path, str]) -> dict[str, Any]:
    try:
        content = hashes.get(path) or sha256_of(path)
        return {"path": str(path), "bytes": path.stat().st_size, "sha256": content}
    except OSError as error:  # it existed when the flight was read
        return {"path": str(path), "error": error.strerror}
