"""Input of `corridor inspect`: one log, or the logs of a ``flight.toml`` as one."""

from __future__ import annotations

from pathlib import Path

from fusion.inspection.log import Inspection, inspect_log
from fusion.logs.contents import Kind
from fusion.logs.manifest.assembly import checked_flight
from fusion.logs.manifest.file import find_manifest, read_manifest
from fusion.logs.manifest.manifest import Manifest
from fusion.logs.manifest.sources import ManifestLog
from vision import InputError


def inspect_path(path: Path) -> Inspection:
    """Describe a log file, a flight's folder or a manifest.

    Raises
    ------
    InputError
        If there is no known format, or nothing can be read.
    """
    if not path.exists():
        raise InputError("there is no such file or folder", file=path, remedy="check the path")
    described = find_manifest(path)
    if described is not None:
        log = ManifestLog(read_manifest(described), described)
    else:
        log = ManifestLog(Manifest(log=path.resolve()))
        log.log(Kind.IMU)  # raises if it cannot be opened: there is nothing else to describe
    refusal = None
    try:
        checked_flight(log, described or path)
    except InputError as error:
        refusal = error
    return inspect_log(log, name=str(path), choose=log.choose, advice=log.advice(), refusal=refusal)
