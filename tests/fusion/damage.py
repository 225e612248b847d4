"""Cut and corrupt a log, and see that its reader says so or refuses in one line, and does nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from vision import InputError

MAX_CUTS = 200
FLIPS = 200
KILOBYTE = 1024


def cuts(data: bytes, n: int = MAX_CUTS) -> Iterator[bytes]:
    """The file's beginnings, ending at every kilobyte, or at n places where these are more."""
    whole = range(KILOBYTE, len(data), KILOBYTE)
    for size in whole if len(whole) <= n else np.linspace(1, len(data) - 1, n).astype(int):
        yield data[:size]


def flips(data: bytes, n: int = FLIPS, seed: int = 7) -> Iterator[bytes]:
    """The file with one byte changed, at n random places; every tenth has 50 bytes changed."""
    rng = np.random.default_rng(seed)
    for trial in range(n):
        damaged = bytearray(data)
        for place in rng.integers(0, len(data), 50 if trial % 10 == 0 else 1):
            damaged[place] ^= int(rng.integers(1, 256))
        yield bytes(damaged)


def check_stream(stream: Any) -> None:
    """Times strictly increase, and every number that has to be one is one."""
    assert len(stream.t_ns) > 0
    assert (np.diff(stream.t_ns) > 0).all()
    assert stream.t_ns.dtype == np.int64
    for name in ("gyro_rad_s", "q_world_body", "xyz"):
        values = getattr(stream, name, None)
        if values is not None:
            assert len(values) == len(stream.t_ns)
            assert np.isfinite(values).all()


def read_everything(reader: ModuleType, path: Path, pictures: int = 2) -> tuple[int, int, list[str]]:
    """Open a log and read every topic: how many samples, how many topics refused, and what is said.

    Anything but an `InputError` of one line fails the test that calls this.
    """
    said: list[str] = []
    samples, refused = 0, 0
    log = reader.open_log(path)
    said += log.problems
    for topic in log.topics:
        try:
            stream, problems = getattr(log, topic.kind)(topic.name)
            said += problems
            samples += len(stream.t_ns)
            check_stream(stream)
            if topic.kind == "frames":
                for index in np.linspace(0, len(stream.t_ns) - 1, pictures).astype(int):
                    assert stream.read(int(index)).ndim == 2
                log.camera(topic.name)
        except InputError as error:
            refused += 1
            said.append(str(error))
    assert not [sentence for sentence in said if "\n" in sentence]
    return samples, refused, said


def survives(reader: ModuleType, variants: Iterator[bytes], path: Path) -> tuple[int, int]:
    """Read every variant: how many opened, how many were refused."""
    opened = 0
    refusals: list[str] = []
    for data in variants:
        path.write_bytes(data)
        try:
            read_everything(reader, path)
            opened += 1
        except InputError as error:
            refusals.append(str(error))
    assert not [line for line in refusals if "\n" in line]
    return opened, len(refusals)
