"""A kill at any operation on files leaves the earlier output whole, or the new one; the next run clears the rest."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fusion.report
import fusion.simulate.flight
from fusion.estimator.tables import ESTIMATE_DTYPE, FRAME_DTYPE
from fusion.files import replacing
from fusion.flight import Flight, FrameStream
from fusion.logs.pictures.camera_folder import PictureFiles
from fusion.outputs.folder import check_out_dir, write_outputs
from fusion.pictures.measure import measure_images
from fusion.simulate import SimulationConfig, simulate_flight
from tests.files import OFFICE
from tests.kills import kill_at_every_change
from vision import Camera, InputError

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="kills are tried in forked processes"),
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
]
FLIGHT = Flight("bare", Camera.from_fov(64, 48, 1.2), FrameStream(np.zeros(0, np.int64), PictureFiles(())))
OLD = {"estimates.csv", "smoothed.csv", "frames.csv", "summary.json", "report.html"}
NEW = OLD - {"report.html"}


@pytest.fixture
def write(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Write an output whose tables have so many rows; the first of them has a report, too."""

    def write_report(result: Any, flight: Any, path: Path, provenance: Any) -> None:
        path.write_text("<html></html>")

    monkeypatch.setattr(fusion.report, "write_report", write_report)

    def write(folder: Path, rows: int) -> None:
        result: Any = SimpleNamespace(
            estimates=np.zeros(rows, ESTIMATE_DTYPE),
            smoothed=np.zeros(rows, ESTIMATE_DTYPE),
            frames=np.zeros(rows, FRAME_DTYPE),
            summary={"verdict": "pass", "rows": rows},
        )
        write_outputs(result, FLIGHT, folder, report=rows == 1)

    return write


def rows_in(folder: Path) -> set[int]:
    """Rows of each table of an output: one number where all are of one run."""
    return {
        len((folder / f"{name}.csv").read_text().splitlines()) - 1
        for name in ("estimates", "smoothed", "frames")
    }


def assert_whole(folder: Path) -> None:
    """All files of one of the two runs, none of the other, and nothing else in the folder or beside it."""
    names = {entry.name for entry in folder.iterdir()}
    assert (rows_in(folder), names) in (({1}, OLD), ({2}, NEW))
    assert f'"rows": {rows_in(folder).pop()}' in (folder / "summary.json").read_text()
    assert [entry.name for entry in folder.parent.iterdir()] == [folder.name]


def test_an_output_in_place_of_another(write: Callable[..., None], tmp_path: Path) -> None:
    folder = tmp_path / "here" / "out"

    def prepare() -> None:
        shutil.rmtree(folder.parent, ignore_errors=True)
        write(folder, 1)

    def check() -> None:
        if folder.exists():  # whole even before anything is put in order
            assert len(rows_in(folder)) == 1
        check_out_dir(folder)
        assert_whole(folder)

    assert kill_at_every_change(lambda: write(folder, 2), tmp_path, prepare, check) > 20
    assert rows_in(folder) == {2}


def test_an_output_where_there_was_none(write: Callable[..., None], tmp_path: Path) -> None:
    folder = tmp_path / "here" / "out"

    def prepare() -> None:
        shutil.rmtree(folder.parent, ignore_errors=True)
        folder.parent.mkdir()

    def check() -> None:
        check_out_dir(folder)
        if folder.exists():
            assert_whole(folder)
        else:
            assert list(folder.parent.iterdir()) == []

    assert kill_at_every_change(lambda: write(folder, 2), tmp_path, prepare, check) > 15


def test_an_output_in_the_present_folder(
    write: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "here" / "out"

    def prepare() -> None:
        monkeypatch.chdir(tmp_path)
        shutil.rmtree(folder.parent, ignore_errors=True)
        write(folder, 1)
        monkeypatch.chdir(folder)

    mixed = []

    def check() -> None:
        mixed.append(rows_in(folder) == {1, 2})
        check_out_dir(Path())
        assert_whole(folder)

    assert kill_at_every_change(lambda: write(Path(), 2), tmp_path, prepare, check) > 20
    assert any(mixed)  # files are moved one by one here: the next run has to finish what was begun
    assert rows_in(folder) == {2}


def test_what_is_set_aside_comes_back_with_the_next_run(write: Callable[..., None], tmp_path: Path) -> None:
    folder = tmp_path / "here" / "out"
    write(folder, 1)
    folder.rename(folder.parent / ".out.corridor-0123abcd.old")
    (folder.parent / ".out.corridor-0123abcd.partial").mkdir()
    check_out_dir(folder)
    assert rows_in(folder) == {1}
    assert_whole(folder)


def test_a_run_at_work_keeps_its_draft(write: Callable[..., None], tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with replacing(path) as draft:
        draft.write_text("first")
        with replacing(path) as other:
            other.write_text("second")
        assert draft.exists()
    assert path.read_text() == "first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


def test_a_file_in_place_of_another(tmp_path: Path) -> None:
    path = tmp_path / "here" / "table.csv"

    def write(text: str) -> None:
        with replacing(path) as draft:
            draft.write_text(text)

    def prepare() -> None:
        shutil.rmtree(path.parent, ignore_errors=True)
        write("old")

    def check() -> None:
        assert path.read_text() in ("old", "new")
        write("next")
        assert [entry.name for entry in path.parent.iterdir()] == ["table.csv"]

    assert kill_at_every_change(lambda: write("new"), tmp_path, prepare, check) >= 5


def test_a_full_disk_leaves_no_cut_drawing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = sorted((OFFICE / "mav0" / "cam0" / "data").iterdir())[0]

    def fill(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[:100])
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", fill)
    drawing = tmp_path / "drawn" / f"{picture.stem}_overlay.jpg"
    with pytest.raises(InputError, match="No space left on device") as caught:
        measure_images([picture], overlay_dir=tmp_path / "drawn")
    assert caught.value.file == drawing
    assert list(drawing.parent.iterdir()) == []


def test_a_simulated_flight_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(config: Any, root: Path, *others: Any) -> None:
        for name in ("imu0", "cam0"):
            (root / name).mkdir()
            (root / name / "data.csv").write_text(name)

    monkeypatch.setattr(fusion.simulate.flight, "_write", write)
    folder = tmp_path / "here" / "flight"

    def prepare() -> None:
        shutil.rmtree(folder.parent, ignore_errors=True)

    def check() -> None:
        if not folder.exists():
            simulate_flight(SimulationConfig(), folder)
        assert [(folder / name / "data.csv").read_text() for name in ("imu0", "cam0")] == ["imu0", "cam0"]
        assert [entry.name for entry in folder.parent.iterdir()] == ["flight"]

    assert kill_at_every_change(lambda: _simulate(folder), tmp_path, prepare, check) > 10


def _simulate(folder: Path) -> None:
    simulate_flight(SimulationConfig(), folder)
