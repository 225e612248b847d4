"""A camera's folder of pictures and the times they were taken at."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from fusion.flight import FrameStream
from fusion.logs.csv_table import (
    MIN_STEP_NS,
    check_nanoseconds,
    check_row,
    counted,
    order_times,
    parse_time,
    read_rows,
)
from vision import Camera, InputError
from vision.images import read_image

PICTURE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp"})

_TRIES = 5


def read_frames(cam: Path, problems: list[str]) -> FrameStream:
    """Read ``data.csv`` (time, file name) of a camera folder, or, without it, times from the pictures' names.

    A picture that is listed but missing stays in the stream, so that its time is counted as unreadable.

    Raises
    ------
    InputError
        Where there are no frames to be had.
    """
    if not cam.is_dir():
        raise InputError(
            "there is no such folder", file=cam, remedy="a flight needs cam0/data.csv and cam0/data/"
        )
    label = f"{cam.name}/data.csv"
    folder = cam / "data"
    present = set(os.listdir(folder)) if folder.is_dir() else set()
    if (cam / "data.csv").exists():
        times, names = _read_list(cam / "data.csv", problems, label)
    else:
        times, names = _times_from_names(cam, sorted(present), problems)
    t_ns = np.array(times, dtype=np.int64)
    index = order_times(t_ns, problems, label)
    t_ns = t_ns[index]
    check_nanoseconds(t_ns, cam / "data.csv", MIN_STEP_NS)
    names = [names[i] for i in index]
    missing = [name for name in names if name not in present and not (folder / name).is_file()]
    if len(missing) == len(names):
        raise InputError(
            f"none of its {counted(len(names), 'picture')} is in data/, such as {missing[0]}",
            file=cam / "data.csv",
            remedy="copy the pictures beside it",
        )
    if missing:
        problems.append(f"{label}: {counted(len(missing), 'picture')} missing in data/ (first {missing[0]})")
    return FrameStream(t_ns, tuple(folder / name for name in names))


def _read_list(path: Path, problems: list[str], label: str) -> tuple[list[int], list[str]]:
    _, rows = read_rows(path, problems, label)
    check_row(path, rows, 2, ("timestamp", "filename"))
    times: list[int] = []
    names: list[str] = []
    broken: list[str] = []
    for row in rows:
        time, _, name = row.partition(",")
        t_ns, name = parse_time(time.strip()), name.strip()
        if t_ns is not None and name and "," not in name:
            times.append(t_ns)
            names.append(name)
        else:
            broken.append(row)
    if not times:
        raise InputError(
            "has no row of time and file name", file=path, remedy="write nanoseconds, then the name"
        )
    if broken:
        what = f"{counted(len(broken), 'row')} not of time and name dropped"
        problems.append(f"{label}: {what}, the first is {broken[0][:60]!r}")
    return times, names


def _times_from_names(cam: Path, present: list[str], problems: list[str]) -> tuple[list[int], list[str]]:
    pictures = [name for name in present if Path(name).suffix.lower() in PICTURE_SUFFIXES]
    timed = {name: t_ns for name in pictures if (t_ns := parse_time(Path(name).stem)) is not None}
    if not timed:
        raise InputError(
            "is missing, and no picture in data/ is named by its time",
            file=cam / "data.csv",
            remedy="write it: nanoseconds and file name in each line",
        )
    problems.append(
        f"{cam.name}/data.csv is missing: times taken from the names of {counted(len(timed), 'picture')}"
    )
    if len(timed) < len(pictures):
        other = next(name for name in pictures if name not in timed)
        problems.append(
            f"{cam.name}/data: {counted(len(pictures) - len(timed), 'picture')} not named by a time left out "
            f"(first {other})"
        )
    return list(timed.values()), list(timed)


def check_size(frames: FrameStream, camera: Camera) -> None:
    """Raise `InputError` where the first picture that decodes is not of the camera's resolution."""
    for path in [path for path in frames.paths if path.is_file()][:_TRIES]:
        try:
            height_px, width_px = read_image(path).shape
        except InputError:
            continue
        camera.require_size(width_px, height_px, file=path)
        return
