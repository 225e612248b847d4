"""Folders of pictures: times from a list, in any shape, or from the pictures' names."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from fusion.logs import open_log
from fusion.logs.csv.column_map import ColumnMap
from fusion.logs.pictures.picture_folder import TOPIC, open_folder, recognises
from tests.fusion.reading import Told
from vision import InputError

T0 = 1_600_001_000_000_000_000
N = 12


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Pictures 0.png to 11.png, each as bright as its number."""
    path = tmp_path / "pictures"
    path.mkdir()
    for i in range(N):
        cv2.imwrite(str(path / f"{i}.png"), np.full((12, 16), 10 * i, np.uint8))
    return path


def brightness(log: object) -> list[int]:
    frames = log.frames(TOPIC).value  # type: ignore[attr-defined]
    return [int(frames.read(i)[0, 0]) // 10 for i in range(len(frames.t_ns))]


@pytest.mark.parametrize(
    "row",
    [
        "{ns},{i}.png",
        "{i}.png,{ns}",
        "{ms};pictures/{i}.png",
        "{s:.6f}\t{i}.png",
        "{s:.6f} rgb/{i}.png",
        "{i},{us},{i}.png,0.3",
    ],
    ids=["asl", "name first", "milliseconds", "tabs", "tum", "more columns"],
)
@pytest.mark.parametrize("inside", [True, False])
def test_lists_of_any_shape(folder: Path, row: str, inside: bool) -> None:
    text = "".join(
        row.format(
            i=i, ns=T0 + i * 50_000_000, us=(T0 + i * 50_000_000) // 1000, ms=(T0 // 10**6) + 50 * i, s=i / 20
        )
        + "\n"
        for i in range(N)
    )
    if row.startswith("{i},{us}"):
        text = "index,time_us,file,x\n" + text
    file = (folder if inside else folder.parent) / "times.csv"
    file.write_text(text)
    log = open_log(folder) if inside else open_folder(folder, times=file)
    frames = log.frames(TOPIC).value
    assert brightness(log) == list(range(N))
    start = 0 if "{s" in row else T0
    np.testing.assert_allclose(frames.t_ns, start + np.arange(N) * 50_000_000, atol=1000)


def test_rows_without_names_go_by_the_order_of_numbers(folder: Path) -> None:
    """2.png comes before 10.png."""
    (folder / "times.txt").write_text("".join(f"{50 * i}\n" for i in range(N)))
    log = open_log(folder)
    assert brightness(log) == list(range(N))
    assert log.topics[0].t_ns[1] == 50_000_000
    (folder / "times.txt").write_text("".join(f"{50 * i}\n" for i in range(N - 1)))
    with pytest.raises(
        InputError, match=r"has 11 rows without file names, pictures 12 pictures \(add a column"
    ):
        open_folder(folder, times=folder / "times.txt")


def test_columns_are_taken_as_told(folder: Path) -> None:
    (folder / "list.csv").write_text(
        "a,b,c\n" + "".join(f"{T0 + i},{50 * i},{N - 1 - i}.png\n" for i in range(N))
    )
    columns = ColumnMap(time="b", time_unit="ms", picture="c")
    log = open_folder(folder, times=folder / "list.csv", columns=columns)
    assert brightness(log) == list(range(N))[::-1]
    assert log.topics[0].t_ns[:2].tolist() == [0, 50_000_000]


@pytest.mark.parametrize(
    ("name", "ns"),
    [("{ns}.png", 1), ("frame_{ns}.png", 1), ("cam0-{us}.png", 1000), ("{s}.{us6}.png", 1000)],
)
def test_times_from_names(folder: Path, name: str, ns: int) -> None:
    for i in range(N):
        t = T0 + i * 50_000_000
        new = name.format(ns=t, us=t // 1000, s=t // 10**9, us6=f"{t % 10**9 // 1000:06d}")
        (folder / f"{i}.png").rename(folder / new)
    log = open_log(folder)
    assert brightness(log) == list(range(N))
    np.testing.assert_allclose(log.topics[0].t_ns, T0 + np.arange(N) * 50_000_000, atol=1000)
    assert any("times taken from the pictures' names" in text for text in log.problems)


def test_what_is_missing_is_counted(folder: Path) -> None:
    (folder / "times.csv").write_text("".join(f"{T0 + i * 50_000_000},{i}.png\n" for i in range(2, N + 2)))
    log = open_log(folder)
    assert set(log.problems) == {
        "times.csv: times assumed to be in nanoseconds; set time_unit if they are not",
        "pictures: 2 pictures missing (first 12.png)",
        "pictures: 2 pictures not in times.csv left out",
    }
    frames = log.frames(TOPIC).value
    assert len(frames.t_ns) == N
    with pytest.raises(InputError, match=r"12\.png"):
        frames.read(10)


def test_shuffled_and_repeated_rows_are_put_in_order(folder: Path) -> None:
    order = [3, 1, 2, 0, 0, *range(4, N)]
    (folder / "times.csv").write_text("".join(f"{T0 + i * 50_000_000},{i}.png\n" for i in order))
    problems = Told()
    frames = problems.take(open_log(folder).frames(TOPIC))
    assert [int(frames.read(i)[0, 0]) // 10 for i in range(N)] == list(range(N))
    assert any("repeated time" in text for text in problems)
    assert any("go backwards" in text for text in problems)


def test_nothing_says_when(folder: Path) -> None:
    with pytest.raises(
        InputError, match=r"nothing says when its 12 pictures were taken \(give a CSV of time and"
    ):
        open_log(folder)


def test_a_list_of_other_pictures(folder: Path) -> None:
    (folder.parent / "times.csv").write_text("".join(f"{T0 + i * 50_000_000},x{i}.png\n" for i in range(N)))
    with pytest.raises(
        InputError, match=r"times\.csv: none of its 12 pictures is in pictures, such as x0\.png"
    ):
        open_folder(folder, times=folder.parent / "times.csv")


def test_folders_that_hold_none(tmp_path: Path) -> None:
    assert not recognises(tmp_path)
    with pytest.raises(InputError, match="contains no pictures"):
        open_folder(tmp_path)


def test_it_has_nothing_but_pictures(folder: Path) -> None:
    (folder / "times.csv").write_text("".join(f"{T0 + i * 50_000_000},{i}.png\n" for i in range(N)))
    log = open_log(folder)
    assert log.camera(TOPIC) is None
    for kind in ("imu", "attitude", "position", "velocity", "range"):
        with pytest.raises(InputError, match=f"has no {kind} topic x"):
            getattr(log, kind)("x")
