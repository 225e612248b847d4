"""A folder of pictures, with a CSV of their times or with times in their names; no calibration.

The CSV may be in the folder (``*.csv`` or ``*.txt``, if there is exactly one with times) or be named in the manifest.
Its columns are detected: time stamps by name or position, file names by their extensions. Without file names, the
rows belong to the pictures in natural order, ``2.png`` before ``10.png``.
"""

from __future__ import annotations

import os
import re
from os.path import isfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.files import is_inside_folder
from fusion.flight import FrameStream, Remark, TimeArray
from fusion.logs.contents import Kind, Topic
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.csv.time_units import MISSING, dates_to_ns, guess_unit, in_words, to_ns
from fusion.logs.csv.times import read_times
from fusion.logs.pictures.camera_folder import PICTURE_SUFFIXES, PictureFiles, are_numbers_of_frames
from fusion.logs.samples import Problems, WithProblems, counted, in_order
from fusion.logs.series import SeriesLog, no_such_topic
from vision import InputError

_LISTS_BESIDE = ("timestamps.txt", "images.txt", "left_images.txt", "right_images.txt", "rgb.txt")
_TIME_FILES = frozenset({".csv", ".txt", ".tsv"})
_REMEDY = (
    "give a CSV of time and file name, times under [camera] in flight.toml or in the folder, or the pictures' rate: "
    "rate_hz = 20"
)
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_DAY, _TIME = r"((?:19|20)\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)", r"([0-2]\d)[-_.:h]?([0-5]\d)[-_.:m]?([0-6]\d)"
_DATE = re.compile(rf"(?<!\d){_DAY}[-_T ]+{_TIME}(?:[-_.,s]+(\d{{1,9}}))?(?!\d)")
TOPIC = "pictures"


def recognises(path: Path) -> bool:
    """Whether a folder contains pictures."""
    return path.is_dir() and any(_is_picture(name) for name in os.listdir(path))


def open_log(path: Path) -> PictureFolder:
    """Open a folder with its own times."""
    return open_folder(path)


def open_folder(
    path: Path,
    *,
    times: Path | None = None,
    columns: ColumnMap | str | None = None,
    rate_hz: float | None = None,
    start_ns: int = 0,
) -> PictureFolder:
    """Open a folder of pictures and find their times.

    Parameters
    ----------
    path
        The folder.
    times, columns
        A CSV with the times, and its columns; else one in the folder or beside it, else the pictures' names.
    rate_hz, start_ns
        Pictures a second, for pictures that are numbered, and the time of the first.

    Raises
    ------
    InputError
        If there are no pictures, or there are no times.
    """
    names = sorted((name for name in os.listdir(path) if _is_picture(name)), key=_natural)
    if not names:
        raise InputError("contains no pictures", file=path, remedy="give the folder that the pictures lie in")
    if rate_hz is not None:
        t_ns = start_ns + np.rint((_numbers(names)) * (1e9 / rate_hz)).astype(np.int64)
        return PictureFolder(path, t_ns, tuple(names), ())
    file = times or _times_inside(path)
    if file is not None:
        (t_ns, names), problems = _times_from_list(path, file, columns, names)
    else:
        (t_ns, names), problems = _times_from_names(path, names, columns)
    return PictureFolder(path, t_ns, tuple(names), problems)


class PictureFolder(SeriesLog):
    """A folder of pictures as `fusion.logs.contents.LogContents`, without other streams."""

    def __init__(self, path: Path, t_ns: TimeArray, names: tuple[str, ...], problems: Problems) -> None:
        super().__init__(path, "folder of pictures", (), problems)
        self.topics = (Topic(TOPIC, Kind.FRAMES, t_ns),)
        self._names = names

    def frames(self, topic: str) -> WithProblems[FrameStream]:
        """Pictures, decoded one at a time; one that is missing counts as unreadable."""
        if topic != TOPIC:
            raise no_such_topic(self.path, self.topics, Kind.FRAMES, topic)
        t_ns = self.topics[0].t_ns
        index, problems = in_order(t_ns, self.path.name, file=self.path, remedy=_REMEDY)
        pictures = PictureFiles(tuple(self.path / self._names[i] for i in index))
        return WithProblems(FrameStream(t_ns[index], pictures), problems)


def _is_picture(name: str) -> bool:
    return Path(name).suffix.lower() in PICTURE_SUFFIXES and not name.startswith(".")


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def _numbers(names: list[str]) -> npt.NDArray[np.int64]:
    """Frame numbers (n,) relative to the first, from the pictures' names, or else their order."""
    found = [_NUMBER.findall(Path(name).stem) for name in names]
    last = np.array([int(numbers[-1]) if numbers and numbers[-1].isdigit() else -1 for numbers in found])
    counts = are_numbers_of_frames(last) and last.min() >= 0 and len(set(last.tolist())) == len(last)
    return last - last.min() if counts else np.arange(len(names))


def _times_inside(path: Path) -> Path | None:
    """Find the one text file of a folder that gives times; None unless there is exactly one.

    Public data sets have it beside the folder, under various names.
    """
    texts = [path / name for name in sorted(os.listdir(path)) if Path(name).suffix.lower() in _TIME_FILES]
    if not texts:
        texts = [path.parent / name for name in _LISTS_BESIDE if (path.parent / name).is_file()]
    found = []
    for text in texts:
        try:
            read_times(text, None)
        except InputError:
            continue
        found.append(text)
    return found[0] if len(found) == 1 else None


_TimesAndNames = tuple[TimeArray, list[str]]


def _times_from_list(
    path: Path, file: Path, columns: ColumnMap | str | None, names: list[str]
) -> WithProblems[_TimesAndNames]:
    """Read times from a file: by its file names, or else row by row in the pictures' order."""
    listed, problems = read_times(file, columns)
    if listed.names is None:
        n_rows = int(listed.row[-1]) + 1
        if n_rows != len(names):
            raise InputError(
                f"has {counted(n_rows, 'row')} without file names, {path.name} {counted(len(names), 'picture')}",
                file=file,
                remedy="add a column of file names",
            )
        return WithProblems((listed.t_ns, [names[row] for row in listed.row]), problems)
    chosen = [os.path.relpath(_beside(path, file, name), path) for name in listed.names]
    missing = [name for name in chosen if not isfile(path / name)]
    if len(missing) == len(chosen):
        raise InputError(
            f"none of its {counted(len(chosen), 'picture')} is in {path.name}, such as {missing[0]}",
            file=file,
            remedy="name the folder that they lie in",
        )
    if missing:
        problems += (f"{path.name}: {counted(len(missing), 'picture')} missing (first {missing[0]})",)
    unlisted = len(set(names) - set(chosen))
    if unlisted:
        problems += (f"{path.name}: {counted(unlisted, 'picture')} not in {file.name} left out",)
    return WithProblems((listed.t_ns, chosen), problems)


def _beside(path: Path, file: Path, name: str) -> Path:
    """Return the path of a listed picture: in the folder, or relative to the list's folder."""
    name = name.strip().strip('"').replace("\\", "/")
    if not is_inside_folder(name):
        raise InputError(f"names {name!r}, outside the folder", file=file, remedy="copy the pictures there")
    for candidate in (path / name, file.parent / name, path / Path(name).name):
        if isfile(candidate):
            return candidate
    return path / name


def _date_ns(stem: str) -> int:
    """Time from a date in a picture's name, as in ``IMG_20200913_124320_123``; `MISSING` if there is none."""
    found = _DATE.search(stem)
    if found is None:
        return MISSING
    year, month, day, hour, minute, second, fraction = found.groups()
    date = f"{year}-{month}-{day} {hour}:{minute}:{second}" + (f".{fraction}" if fraction else "")
    return int(dates_to_ns(np.array([date], dtype=object))[0])


def _times_from_names(
    path: Path, names: list[str], columns: ColumnMap | str | None
) -> WithProblems[_TimesAndNames]:
    """Read times from the pictures' names: the last number in each, if it has enough digits."""
    dated = np.array([_date_ns(Path(name).stem) for name in names], dtype=np.int64)
    if (dated != MISSING).all() and 2 * len(np.unique(dated)) > len(dated):
        return WithProblems(
            (dated, names), (Remark(f"{path.name}: times taken from the dates in the pictures' names"),)
        )
    found = [_NUMBER.findall(Path(name).stem) for name in names]
    texts = [numbers[-1] if numbers else "" for numbers in found]
    timed = [(name, text) for name, text in zip(names, texts, strict=True) if len(text.replace(".", "")) >= 8]
    if not timed:
        raise InputError(
            f"nothing says when its {counted(len(names), 'picture')} were taken", file=path, remedy=_REMEDY
        )
    whole = all("." not in text for _, text in timed)
    numbers = np.array(
        [int(text) if whole else float(text) for _, text in timed], dtype="i8" if whole else "f8"
    )
    if are_numbers_of_frames(numbers):
        raise InputError(
            f"its {counted(len(names), 'picture')} are numbered ({timed[0][0]} ...), not named by their times",
            file=path,
            remedy=_REMEDY,
        )
    declared = columns.time_unit if isinstance(columns, ColumnMap) else None
    unit = declared or guess_unit(numbers)
    t_ns = to_ns(numbers, unit)
    kept = [name for (name, _), t in zip(timed, t_ns, strict=True) if t != MISSING]
    problems: Problems = (Remark(f"{path.name}: times taken from the pictures' names, as {in_words(unit)}"),)
    if len(kept) < len(names):
        problems += (
            f"{path.name}: {counted(len(names) - len(kept), 'picture')} not named by a time left out",
        )
    return WithProblems((t_ns[t_ns != MISSING], kept), problems)
