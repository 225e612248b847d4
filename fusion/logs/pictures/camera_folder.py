"""A camera's folder of pictures, and their times."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.files import is_inside_folder
from fusion.flight import FrameStream
from fusion.logs.csv.rows import parse_time, read_blocks
from fusion.logs.csv.stamped_table import check_columns, read_table_head
from fusion.logs.samples import (
    MIN_STEP_NS,
    Problems,
    WithProblems,
    counted,
    in_order,
    refuse_placeholder,
)
from vision import Camera, InputError
from vision.images import GreyImage, read_image

PICTURE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp"})

_TRIES = 5
_SAMPLED, _MIN_CONTRAST, _MAX_BLACK = 5, 2.0, 16.0
_CUT = 0.05  # pictures whose size differs by less were cut or padded, not scaled
_REMEDY_OF_CUT = (
    "give the calibration of these pictures; where they were cut out of the larger ones, subtract the first column "
    "and row from cx and cy, and write resolution: [{}, {}]"
)
_MIN_FOCAL = 0.05  # of the picture's width; that of the widest fisheye is about a quarter
MAX_FRAME_NUMBER, MAX_FRAME_STEP = 10**8, 10  # larger numbers may be times


@dataclass(frozen=True, slots=True, eq=False)
class PictureFiles:
    """Pictures as files, one per frame; a `fusion.flight.FrameSource`."""

    paths: tuple[Path, ...]

    def read(self, index: int) -> GreyImage:
        """Decode a picture."""
        return read_image(self.paths[index])


def read_frames(cam: Path) -> WithProblems[FrameStream]:
    """Read ``data.csv`` (time, file name) of a camera folder, or, without it, times from the pictures' names.

    A picture that is listed but missing stays in the stream and is counted as unreadable.

    Raises
    ------
    InputError
        If there are no frames.
    """
    if not cam.is_dir():
        raise InputError(
            "there is no such folder", file=cam, remedy="a flight needs cam0/data.csv and cam0/data/"
        )
    label = f"{cam.name}/data.csv"
    folder = cam / "data"
    present = set(os.listdir(folder)) if folder.is_dir() else set()
    if (cam / "data.csv").exists():
        (times, names), problems = _read_list(cam / "data.csv", label)
    else:
        (times, names), problems = _times_from_names(cam, sorted(present))
    t_ns = np.array(times, dtype=np.int64)
    index, disorder = in_order(t_ns, label, MIN_STEP_NS, file=cam / "data.csv")
    problems += disorder
    t_ns = t_ns[index]
    names = [names[i] for i in index]
    missing = [name for name in names if name not in present and not isfile(folder / name)]
    if len(missing) == len(names):
        raise InputError(
            f"none of its {counted(len(names), 'picture')} is in data/, such as {missing[0]}",
            file=cam / "data.csv",
            remedy="copy the pictures beside it",
        )
    if missing:
        problems += (f"{label}: {counted(len(missing), 'picture')} missing in data/ (first {missing[0]})",)
    return WithProblems(FrameStream(t_ns, PictureFiles(tuple(folder / name for name in names))), problems)


_TimesAndNames = tuple[list[int], list[str]]


def _read_list(path: Path, label: str) -> WithProblems[_TimesAndNames]:
    head = read_table_head(path)
    check_columns(path, head, 2, ("timestamp", "filename"))
    times: list[int] = []
    names: list[str] = []
    broken: list[str] = []
    problems: Problems = ()
    for rows, cut in read_blocks(path, head.separator, skip_lines=head.lines):
        for row in rows:
            time, _, name = (part.strip().strip('"') for part in row.partition(head.separator))
            t_ns = parse_time(time)
            if t_ns is not None and name and head.separator not in name:
                times.append(t_ns)
                names.append(name)
            else:
                broken.append(row)
            if not is_inside_folder(name):
                raise InputError(
                    f"names {name!r}, outside data/", file=path, remedy="copy the pictures there"
                )
        if cut:
            problems += (f"{label}: the last line is cut short, dropped",)
    if not times:
        raise InputError(
            "has no row of time and file name", file=path, remedy="write nanoseconds, then the name"
        )
    if broken:
        what = f"{counted(len(broken), 'row')} not of time and name dropped"
        problems += (f"{label}: {what}, the first is {broken[0][:60]!r}",)
    return WithProblems((times, names), problems)


def _times_from_names(cam: Path, present: list[str]) -> WithProblems[_TimesAndNames]:
    pictures = [name for name in present if Path(name).suffix.lower() in PICTURE_SUFFIXES]
    timed = {name: t_ns for name in pictures if (t_ns := parse_time(Path(name).stem)) is not None}
    if not timed:
        raise InputError(
            "is missing, and no picture in data/ is named by its time",
            file=cam / "data.csv",
            remedy="write it: nanoseconds and file name in each line",
        )
    if are_numbers_of_frames(np.array(list(timed.values()), dtype=np.int64)):
        raise InputError(
            f"is missing, and the pictures in data/ are numbered ({next(iter(timed))} ...), not named by their times",
            file=cam / "data.csv",
            remedy="write it: nanoseconds and file name in each line; or give data/ as [camera] file, with rate_hz",
        )
    problems: Problems = (
        f"{cam.name}/data.csv is missing: times taken from the names of {counted(len(timed), 'picture')}",
    )
    if len(timed) < len(pictures):
        other = next(name for name in pictures if name not in timed)
        problems += (
            f"{cam.name}/data: {counted(len(pictures) - len(timed), 'picture')} not named by a time left out "
            f"(first {other})",
        )
    return WithProblems((list(timed.values()), list(timed)), problems)


def darkness_problem(frames: FrameStream) -> str | None:
    """Return a sentence if pictures throughout the log are black, else None."""
    brightest = 0.0
    count = 0
    for index in np.unique(np.linspace(0, len(frames.t_ns) - 1, _SAMPLED).astype(int)).tolist():
        with suppress(InputError):
            picture = frames.read(index)
            if float(picture.std()) >= _MIN_CONTRAST or float(picture.mean()) >= _MAX_BLACK:
                return None
            brightest, count = max(brightest, float(picture.mean())), count + 1
    if not count:
        return None
    return (
        f"the pictures are black: brightness up to {brightest:.1f} of 255 in {counted(count, 'picture')} over the "
        "log (exposure, a covered lens, or a wrong bit depth)"
    )


def are_numbers_of_frames(numbers: npt.NDArray[np.generic]) -> bool:
    """Whether the numbers (n,) in pictures' names are frame numbers: small, and mostly one or a few apart."""
    if len(numbers) < 2 or numbers.dtype.kind != "i":
        return False
    steps = np.diff(np.sort(numbers))
    return bool(float(np.max(numbers)) < MAX_FRAME_NUMBER and float(np.median(steps)) <= MAX_FRAME_STEP)


def check_size(frames: FrameStream, camera: Camera, file: Path | None = None) -> None:
    """Raise `InputError` if the first picture that can be decoded does not have the camera's resolution."""
    paths = frames.source.paths if isinstance(frames.source, PictureFiles) else ()
    first = next((path for path in paths if path.exists()), file)
    if first is not None and first.exists():
        refuse_placeholder(first)
    size = size_of_pictures(frames)
    if size is None:
        return
    try:
        camera.require_size(*size, file=first)
    except InputError as error:
        if not camera.is_scaled_to(*size):
            raise
        if abs(size[0] / camera.width_px - 1.0) < _CUT:
            raise InputError(error.problem, file=first, remedy=_REMEDY_OF_CUT.format(*size)) from error
        remedy = f"{error.remedy}; rescale_calibration = true for [camera] in flight.toml does that"
        raise InputError(error.problem, file=first, remedy=remedy) from error


def check_focal_length(camera: Camera, file: Path | None) -> None:
    """Raise `InputError` if the camera's focal length cannot be in pixels; ``file`` is its calibration."""
    for name, focal_px in (("fx", camera.fx_px), ("fy", camera.fy_px)):
        if focal_px < _MIN_FOCAL * camera.width_px:
            raise InputError(
                f"the focal length {name} = {focal_px:g} is not in pixels of a picture {camera.width_px} wide",
                file=file,
                remedy=f"give pixels: a share of the width times {camera.width_px}, or millimetres times "
                f"{camera.width_px} over the sensor's width in millimetres",
            )


def size_of_pictures(frames: FrameStream) -> tuple[int, int] | None:
    """Return width and height of the first picture that can be decoded; None if the first few cannot."""
    tries = 0
    for index in range(len(frames.t_ns)):
        source = frames.source
        if isinstance(source, PictureFiles) and not source.paths[index].exists():  # any number may be missing
            continue
        try:
            height_px, width_px = frames.read(index).shape
        except InputError:
            tries += 1
            if tries == _TRIES:
                break
            continue
        return width_px, height_px
    return None
