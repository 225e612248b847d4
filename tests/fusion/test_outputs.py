"""What `fusion.outputs.folder` leaves on disk, and what it leaves alone."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fusion
import fusion.report
from fusion import load_flight
from fusion.estimator.tables import ESTIMATE_DTYPE, FRAME_DTYPE
from fusion.flight import Flight, FrameStream
from fusion.logs.manifest.file import read_manifest
from fusion.logs.pictures.camera_folder import PictureFiles
from fusion.outputs.folder import OUTPUT_FILES, check_out_dir, write_outputs
from fusion.outputs.provenance import provenance
from fusion.result import tables_csv
from fusion.result.summary_json import write_summary
from fusion.result.tables_csv import read_table, write_table
from tests.files import OFFICE
from vision import Camera, InputError

# Made by hand: it has no manifest.
FLIGHT = Flight("bare", Camera.from_fov(64, 48, 1.2), FrameStream(np.zeros(0, np.int64), PictureFiles(())))


@pytest.fixture
def result(monkeypatch: pytest.MonkeyPatch) -> Any:
    def write_report(result: Any, flight: Any, path: Path, provenance: Any) -> None:
        path.write_text("<html></html>")

    monkeypatch.setattr(fusion.report, "write_report", write_report)
    return SimpleNamespace(
        estimates=np.zeros(3, ESTIMATE_DTYPE),
        smoothed=np.zeros(3, ESTIMATE_DTYPE),
        frames=np.zeros(2, FRAME_DTYPE),
        summary={
            "verdict": "pass",
            "unknown": float("nan"),
            "count": np.int64(3),
            "list": (1.5, np.float32(2)),
        },
    )


def names_in(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir()}


class TestTables:
    def test_a_row_is_written_to_the_contract(self, tmp_path: Path) -> None:
        table = np.zeros(1, FRAME_DTYPE)
        table["timestamp_ns"] = 1403636579763555584
        table["accepted"] = True
        table["reason"] = "ok"
        table["n_lines"] = 41
        table["vp_x_px"] = 319.123456789
        table["vp_y_px"] = np.nan
        table["heading_rad"] = -1e-12
        write_table(table, tmp_path / "frames.csv")
        assert (tmp_path / "frames.csv").read_bytes() == (
            b"timestamp_ns,accepted,reason,n_lines,n_inliers,vp_x_px,vp_y_px,heading_rad,heading_std_rad,"
            b"lateral_offset_norm,lateral_offset_norm_std,position,paper_yaw_rad,innovation_rad,test_ratio,vision_ms\n"
            b"1403636579763555584,true,ok,41,0,319.123457,,-1e-12,0,0,0,,0,0,0,0\n"
        )

    @given(
        st.lists(
            st.tuples(
                st.integers(-(2**63), 2**63 - 1),
                st.booleans(),
                st.floats(width=64),
                st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8),
            ),
            max_size=20,
        )
    )
    def test_reading_gives_back_what_was_written(self, tmp_path_factory: Any, rows: Any) -> None:
        dtype = np.dtype([("t", "i8"), ("b", "?"), ("x", "f8"), ("s", "U8")])
        table = np.array(rows, dtype)
        path = tmp_path_factory.mktemp("table") / "t.csv"
        write_table(table, path)
        back = read_table(path, dtype)
        assert len(back) == len(table)
        for name in ("t", "b", "s"):
            np.testing.assert_array_equal(back[name], table[name])
        np.testing.assert_allclose(back["x"], table["x"], rtol=1e-8)

    def test_chunks_join_without_seam(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(tables_csv, "_CHUNK_ROWS", 4)
        table = np.zeros(10, ESTIMATE_DTYPE)
        table["timestamp_ns"] = np.arange(10)
        table["heading_rad"] = np.arange(10) / 3
        table["heading_rad"][4:8] = np.nan  # a whole chunk without a number
        write_table(table, tmp_path / "t.csv")
        back = read_table(tmp_path / "t.csv", ESTIMATE_DTYPE)
        np.testing.assert_array_equal(back["timestamp_ns"], np.arange(10))
        np.testing.assert_allclose(back["heading_rad"], table["heading_rad"], rtol=1e-8)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "the file is empty"),
            ("a,b\n1,2\n", r"columns are a,b .*expected t,x"),
            ("t,x\n1,2.0\n5", "line 3 has 1 of 2 columns"),
            ("t,x\n1,2.0\n5,two\n", "line 3: x is 'two'"),
            ("t,x\n1.5,2.0\n", r"line 2: t is '1.5' \(expected an integer"),
            ("t,x\n99999999999999999999,2.0\n", "line 2: t is '99999999999999999999'"),
        ],
    )
    def test_a_spoilt_file_is_named_with_its_line(self, tmp_path: Path, text: str, message: str) -> None:
        path = tmp_path / "t.csv"
        path.write_text(text)
        with pytest.raises(InputError, match=message) as caught:
            read_table(path, np.dtype([("t", "i8"), ("x", "f8")]))
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_a_missing_file_is_an_input_error(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="No such file"):
            read_table(tmp_path / "none.csv", ESTIMATE_DTYPE)


def test_summary_is_json_for_every_reader(tmp_path: Path) -> None:
    write_summary(
        {"a": np.nan, "b": [np.float64(1.5), np.int32(2)], "c": Path("x"), "d": np.inf}, tmp_path / "s.json"
    )
    assert json.loads((tmp_path / "s.json").read_text()) == {"a": None, "b": [1.5, 2], "c": "x", "d": None}


class TestFolder:
    def test_all_five_files_and_nothing_else(self, result: Any, tmp_path: Path) -> None:
        folder = write_outputs(result, FLIGHT, tmp_path / "deep" / "out")
        assert folder == tmp_path / "deep" / "out"
        assert names_in(folder) == set(OUTPUT_FILES) - {"flight.toml"}
        assert names_in(tmp_path / "deep") == {"out"}

    def test_an_earlier_output_is_replaced_whole(self, result: Any, tmp_path: Path) -> None:
        write_outputs(result, FLIGHT, tmp_path / "out")
        (tmp_path / "out" / "estimates.csv").write_text("old")
        write_outputs(result, FLIGHT, tmp_path / "out", report=False)
        assert names_in(tmp_path / "out") == set(OUTPUT_FILES) - {"flight.toml"} - {"report.html"}
        assert (tmp_path / "out" / "estimates.csv").read_text() != "old"
        assert names_in(tmp_path) == {"out"}

    def test_a_failure_leaves_nothing(
        self, result: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(*args: Any) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(fusion.report, "write_report", fail)
        with pytest.raises(KeyboardInterrupt):
            write_outputs(result, FLIGHT, tmp_path / "out")
        assert names_in(tmp_path) == set()

    def test_a_failure_keeps_the_earlier_output(
        self, result: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        write_outputs(result, FLIGHT, tmp_path / "out")
        (tmp_path / "out" / "estimates.csv").write_text("old")

        def fail(*args: Any) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(fusion.report, "write_report", fail)
        with pytest.raises(InputError, match="No space left on device"):
            write_outputs(result, FLIGHT, tmp_path / "out")
        assert (tmp_path / "out" / "estimates.csv").read_text() == "old"
        assert names_in(tmp_path) == {"out"}

    def test_a_foreign_folder_is_refused_and_kept(self, result: Any, tmp_path: Path) -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "thesis.tex").write_text("years of work")
        with pytest.raises(InputError, match=r"holds 'thesis.tex', which corridor did not write"):
            write_outputs(result, FLIGHT, tmp_path / "out")
        assert names_in(tmp_path / "out") == {"thesis.tex"}
        assert names_in(tmp_path) == {"out"}

    def test_a_table_of_the_users_own_is_not_taken_for_ours(self, result: Any, tmp_path: Path) -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "estimates.csv").write_text("t,x\n1,2\n")
        with pytest.raises(InputError, match=r"holds 'estimates.csv', which corridor did not write"):
            write_outputs(result, FLIGHT, tmp_path / "out")
        (tmp_path / "out" / "summary.json").write_text('{"files": ["estimates.csv"]}')  # no summary of ours
        with pytest.raises(InputError, match=r"holds 'estimates.csv' and 1 more"):
            write_outputs(result, FLIGHT, tmp_path / "out")
        assert (tmp_path / "out" / "estimates.csv").read_text() == "t,x\n1,2\n"

    def test_a_file_added_to_an_output_is_the_users(self, result: Any, tmp_path: Path) -> None:
        write_outputs(result, FLIGHT, tmp_path / "out", report=False)
        (tmp_path / "out" / "report.html").write_text("mine")
        with pytest.raises(InputError, match=r"holds 'report.html', which corridor did not write"):
            write_outputs(result, FLIGHT, tmp_path / "out")

    def test_a_summary_cannot_name_files_elsewhere(
        self, result: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "precious.csv").write_text("1")
        (tmp_path / "out").mkdir()
        mark = {"verdict": "pass", "files": ["summary.json", "../precious.csv"]}
        (tmp_path / "out" / "summary.json").write_text(json.dumps(mark))
        monkeypatch.chdir(tmp_path / "out")
        write_outputs(result, FLIGHT, ".")
        assert (tmp_path / "precious.csv").read_text() == "1"

    def test_an_error_names_the_file_the_user_knows(
        self, result: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(self: Path, *args: Any, **kwargs: Any) -> None:
            raise OSError(28, "No space left on device", str(self))

        monkeypatch.setattr(Path, "open", fail)
        with pytest.raises(InputError, match="No space left on device") as caught:
            write_outputs(result, FLIGHT, tmp_path / "out")
        assert caught.value.file == tmp_path / "out" / "estimates.csv"
        assert names_in(tmp_path) == set()

    def test_a_folder_named_like_an_output_is_foreign(self, tmp_path: Path) -> None:
        (tmp_path / "out" / "frames.csv").mkdir(parents=True)
        with pytest.raises(InputError, match=r"frames\.csv"):
            check_out_dir(tmp_path / "out")

    def test_a_file_in_the_way_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "out").write_text("")
        with pytest.raises(InputError, match="is an existing file"):
            check_out_dir(tmp_path / "out")

    def test_what_cannot_be_written_is_found_before_the_work(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "file").write_text("")
        with pytest.raises(InputError, match="the output folder cannot be used: Not a directory"):
            check_out_dir(tmp_path / "file" / "out")
        check_out_dir(tmp_path / "new" / "out")
        (tmp_path / "old").mkdir()
        check_out_dir(tmp_path / "old")
        monkeypatch.setattr(os, "access", lambda place, mode: place != tmp_path)
        with pytest.raises(InputError, match="the output folder cannot be used: Permission denied"):
            check_out_dir(tmp_path / "new" / "out")

    def test_the_current_folder_keeps_its_identity(
        self, result: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        before = os.stat(".").st_ino
        write_outputs(result, FLIGHT, ".")
        write_outputs(result, FLIGHT, ".", report=False)
        assert os.stat(".").st_ino == before
        assert names_in(Path()) == set(OUTPUT_FILES) - {"flight.toml"} - {"report.html"}

    def test_a_linked_folder_stays_a_link(self, result: Any, tmp_path: Path) -> None:
        (tmp_path / "disk").mkdir()
        (tmp_path / "out").symlink_to(tmp_path / "disk")
        write_outputs(result, FLIGHT, tmp_path / "out")
        assert (tmp_path / "out").is_symlink()
        assert names_in(tmp_path / "disk") == set(OUTPUT_FILES) - {"flight.toml"}


def test_the_summary_tells_where_the_flight_came_from(tmp_path: Path) -> None:
    shutil.copytree(OFFICE, tmp_path / "office", ignore=shutil.ignore_patterns("*.jpg"))
    (tmp_path / "flight.toml").write_text('log = "office"\n[camera]\nfile = "office"\n')
    flight = load_flight(OFFICE)
    manifest = read_manifest(tmp_path / "flight.toml")
    told = provenance(replace(flight, manifest=manifest), "corridor fuse office")
    assert (told["version"], told["command"]) == (fusion.__version__, "corridor fuse office")
    assert told["camera"]["focal_px"] == [flight.camera.fx_px, flight.camera.fy_px]
    by_path = {Path(entry["path"]).relative_to(tmp_path).as_posix(): entry for entry in told["inputs"]}
    imu = by_path["office/mav0/imu0/data.csv"]
    data = (OFFICE / "mav0" / "imu0" / "data.csv").read_bytes()
    assert (imu["bytes"], imu["sha256"]) == (len(data), hashlib.sha256(data).hexdigest())
    assert provenance(replace(flight, manifest=None))["inputs"] == []
