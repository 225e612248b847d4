"""The command line as a user meets it: what it prints where, its exit codes, and what it leaves behind."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from fusion.cli.simulate_options import simulation_config
from fusion.estimator.tables import ESTIMATE_DTYPE, FRAME_DTYPE
from fusion.outputs.folder import OUTPUT_FILES
from fusion.pictures import measure as measure_images
from fusion.result.tables_csv import read_table
from tests import command
from tests.command import Corridor, Run
from tests.files import OFFICE
from tests.pictures import read_colour, read_grey

N_FRAMES = 30


@pytest.fixture(scope="session")
def start_of_office(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the first 1.5 s of the sample flight."""
    flight = tmp_path_factory.mktemp("flights") / "start"
    for sensor in ("cam0/sensor.yaml", "imu0/sensor.yaml", "body.yaml"):
        if (OFFICE / "mav0" / sensor).exists():
            (flight / "mav0" / sensor).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(OFFICE / "mav0" / sensor, flight / "mav0" / sensor)
    rows = {"mav0/cam0/data.csv": 20, "mav0/imu0/data.csv": 200, "mav0/attitude0/data.csv": 50}
    for name, rate_hz in (rows | {"corridor_truth.csv": 200}).items():
        lines = (OFFICE / name).read_text().splitlines(keepends=True)
        (flight / name).parent.mkdir(parents=True, exist_ok=True)
        (flight / name).write_text("".join(lines[: 1 + N_FRAMES * rate_hz // 20]))
    pictures = sorted((OFFICE / "mav0/cam0/data").iterdir())[:N_FRAMES]
    (flight / "mav0/cam0/data").mkdir()
    for picture in pictures:
        shutil.copy(picture, flight / "mav0/cam0/data")
    return flight


@pytest.fixture
def flight(start_of_office: Path, tmp_path: Path) -> Path:
    """A copy of it to spoil."""
    return Path(shutil.copytree(start_of_office, tmp_path / "flight"))


@pytest.fixture
def pictures(start_of_office: Path) -> list[Path]:
    return sorted((start_of_office / "mav0/cam0/data").iterdir())


def edit_lines(path: Path, edit: Callable[[list[str]], list[str]]) -> None:
    path.write_text("\n".join(edit(path.read_text().splitlines())) + "\n")


def refused(run: Run, *words: str) -> None:
    """As `tests.command.refused`, after lines that say what the command assumes."""
    lines = run.err.splitlines(keepends=True)
    err = "".join(line for line in lines if not line.startswith("corridor: no --"))
    command.refused(run._replace(err=err), *words)


class TestFuse:
    def test_the_five_files_and_the_table(self, corridor: Corridor, start_of_office: Path) -> None:
        run = corridor("fuse", start_of_office)
        assert run.code == 0, run.err
        assert os.listdir() == ["start_fused"]
        assert set(os.listdir("start_fused")) == set(OUTPUT_FILES)
        estimates = read_table("start_fused/estimates.csv", ESTIMATE_DTYPE)
        assert len(estimates) == len(read_table("start_fused/smoothed.csv", ESTIMATE_DTYPE)) == N_FRAMES * 10
        frames = read_table("start_fused/frames.csv", FRAME_DTYPE)
        assert len(frames) == N_FRAMES
        summary = json.loads(Path("start_fused/summary.json").read_text())
        assert summary["verdict"] in run.out
        accepted = int(frames["accepted"].sum())
        assert f"{accepted} of {N_FRAMES}" in run.out
        for word in ("heading", "lateral", "filter", "smoother", "RMSE", "MAE", "real time", "start_fused"):
            assert word in run.out

    def test_without_a_terminal_only_plain_text(self, start_of_office: Path, tmp_path: Path) -> None:
        command = [
            sys.executable,
            "-m",
            "fusion.cli.app",
            "fuse",
            str(start_of_office),
            "-o",
            str(tmp_path / "o"),
        ]
        run = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        assert run.returncode == 0, run.stderr
        assert "\x1b" not in run.stdout + run.stderr
        assert all(line.startswith("corridor: ") for line in run.stderr.splitlines())

    def test_one_bad_sample_among_many_is_survived_and_told(self, corridor: Corridor, flight: Path) -> None:
        def spoil(lines: list[str]) -> list[str]:
            time, *values = lines[50].split(",")
            lines[50] = ",".join([time, "nan", *values[1:]])
            lines[60], lines[61] = lines[61], lines[60]
            return [*lines, lines[-1], lines[-1][:30]]

        edit_lines(flight / "mav0/imu0/data.csv", spoil)
        edit_lines(
            flight / "mav0/attitude0/data.csv",
            lambda lines: [*lines[:9], lines[9].split(",")[0] + ",0,0,0,0", *lines[10:]],
        )
        (flight / f"mav0/cam0/data/{sorted(os.listdir(flight / 'mav0/cam0/data'))[5]}").write_bytes(
            b"\xff\xd8"
        )
        run = corridor("fuse", flight, "-o", "out")
        assert run.code == 0, run.err
        frames = read_table("out/frames.csv", FRAME_DTYPE)
        assert list(frames["reason"]).count("unreadable") == 1
        problems = " ".join(json.loads(Path("out/summary.json").read_text())["problems"])
        for word in ("imu0", "attitude0", "repeated time", "backwards"):
            assert word in problems
        assert "1 unreadable" in run.out

    def test_the_articles_method_runs_too(self, corridor: Corridor, start_of_office: Path) -> None:
        run = corridor("fuse", start_of_office, "-o", "out", "--method", "paper")
        assert run.code == 0, run.err
        assert json.loads(Path("out/summary.json").read_text())["method"] == "paper"

    def test_exports_in_ros_signs_and_their_evaluation(
        self, corridor: Corridor, start_of_office: Path
    ) -> None:
        assert corridor("fuse", start_of_office, "-o", "frd").code == 0
        run = corridor("fuse", start_of_office, "-o", "ros", "--export", "tum", "--frame", "ros")
        assert run.code == 0, run.err
        assert "estimates.tum, smoothed.tum" in run.out
        assert "positive to the left" in run.out
        assert set(os.listdir("ros")) == {*OUTPUT_FILES, "estimates.tum", "smoothed.tum"}
        frd, ros = (
            read_table(f"{name}/estimates.csv", ESTIMATE_DTYPE)["heading_rad"] for name in ("frd", "ros")
        )
        np.testing.assert_allclose(ros, -frd, atol=1e-9)
        run = corridor("evaluate", "frd", "ros", "--truth", start_of_office, "--json")
        assert run.code == 0, run.err
        one, other = (output["causal"]["heading"] for output in json.loads(run.out)["outputs"])
        assert one["rmse_rad"] == pytest.approx(other["rmse_rad"])
        assert one["rmse_rad"] < np.radians(0.5)

    def test_an_unknown_export_is_refused_before_the_work(
        self, corridor: Corridor, start_of_office: Path
    ) -> None:
        refused(corridor("fuse", start_of_office, "--export", "hdf5"), "hdf5", "parquet, tum, mcap")

    def test_a_folder_that_is_missing(self, corridor: Corridor) -> None:
        refused(corridor("fuse", "nowhere"), "nowhere", "no such")

    def test_a_folder_that_is_no_flight(self, corridor: Corridor, tmp_path: Path) -> None:
        refused(corridor("fuse", tmp_path), str(tmp_path), "flight")

    @pytest.mark.parametrize(
        ("file", "content", "words"),
        [
            ("mav0/cam0/data.csv", "", ["data.csv", "empty"]),
            ("mav0/imu0/data.csv", "", ["imu0", "empty"]),
            ("mav0/cam0/data.csv", "#timestamp [ns],filename\n16000010000", ["data.csv"]),
            ("mav0/imu0/data.csv", "#t,x,y,z\n1,2,3\n4,5,6\n", ["imu0", "columns"]),
            ("mav0/cam0/sensor.yaml", "resolution: [640, 480\n", ["sensor.yaml", "YAML"]),
            ("mav0/body.yaml", "body_frame: enu\n", ["body.yaml", "body_frame", "enu", "frd"]),
        ],
    )
    def test_a_spoilt_file_is_named(
        self, corridor: Corridor, flight: Path, file: str, content: str, words: list[str]
    ) -> None:
        (flight / file).write_text(content)
        refused(corridor("fuse", flight), *words)

    def test_every_gyro_row_nan(self, corridor: Corridor, flight: Path) -> None:
        edit_lines(
            flight / "mav0/imu0/data.csv",
            lambda lines: [lines[0], *(line.split(",")[0] + ",nan,nan,nan,0,0,9.8" for line in lines[1:])],
        )
        refused(corridor("fuse", flight), "imu0")

    def test_every_quaternion_zero(self, corridor: Corridor, flight: Path) -> None:
        edit_lines(
            flight / "mav0/attitude0/data.csv",
            lambda lines: [lines[0], *(line.split(",")[0] + ",0,0,0,0" for line in lines[1:])],
        )
        refused(corridor("fuse", flight), "attitude0", "quaternion")

    def test_a_camera_with_three_coefficients(self, corridor: Corridor, flight: Path) -> None:
        yaml = flight / "mav0/cam0/sensor.yaml"
        yaml.write_text(yaml.read_text().replace("[0.0, 0.0, 0.0, 0.0]", "[0.1, 0.0, 0.0]"))
        refused(corridor("fuse", flight), "sensor.yaml", "distortion_coefficients has 3", "4 or 5 or 8")
        refused(corridor("fuse", flight, "--camera", yaml), "sensor.yaml", "distortion_coefficients has 3")

    def test_a_camera_file_that_is_missing(self, corridor: Corridor, flight: Path) -> None:
        refused(corridor("fuse", flight, "--camera", "none.yaml"), "none.yaml", "no such file")

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("corridor_widht_m = 2.2\n", ["corridor_widht_m"]),
            ('corridor_width_m = "wide"\n', ["corridor_width_m"]),
            ("corridor_width_m = -2.2\n", ["corridor_width_m"]),
            ("corridor_width_m = \n", ["f.toml"]),
        ],
    )
    def test_a_setting_that_is_wrong(
        self, corridor: Corridor, start_of_office: Path, tmp_path: Path, text: str, words: list[str]
    ) -> None:
        (tmp_path / "f.toml").write_text(text)
        refused(corridor("fuse", start_of_office, "--config", tmp_path / "f.toml"), "f.toml", *words)

    def test_a_settings_file_that_is_missing(self, corridor: Corridor, start_of_office: Path) -> None:
        refused(corridor("fuse", start_of_office, "--config", "f.toml"), "f.toml")

    def test_a_foreign_output_folder_is_refused_before_the_work(
        self, corridor: Corridor, tmp_path: Path
    ) -> None:
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "notes.txt").write_text("keep")
        refused(corridor("fuse", "nowhere", "-o", tmp_path / "mine"), "notes.txt")
        assert os.listdir(tmp_path / "mine") == ["notes.txt"]

    def test_a_wrong_method_is_a_usage_error(self, corridor: Corridor, start_of_office: Path) -> None:
        run = corridor("fuse", start_of_office, "--method", "magic")
        assert run.code == 2
        assert "magic" in run.err
        assert "Traceback" not in run.err

    def test_an_interrupt_ends_with_130_and_leaves_nothing(
        self, corridor: Corridor, start_of_office: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(*args: object, **kwargs: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr("fusion.fuse_flight", interrupt)
        run = corridor("fuse", start_of_office)
        assert run.code == 130
        assert "Traceback" not in run.err
        assert os.listdir() == []


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


class TestMeasure:
    def test_pictures_are_rows_in_natural_order(
        self, corridor: Corridor, pictures: list[Path], tmp_path: Path
    ) -> None:
        folder = tmp_path / "pictures"
        folder.mkdir()
        for name, picture in zip(("10.jpg", "2.jpg", "left, then right.jpg"), pictures, strict=False):
            shutil.copy(picture, folder / name)
        (folder / "readme.txt").write_text("not a picture")
        run = corridor("measure", folder)
        assert run.code == 0, run.err
        rows = rows_of(run.out)
        assert [Path(row["image"]).name for row in rows] == ["2.jpg", "10.jpg", "left, then right.jpg"]
        assert [row["timestamp_ns"] for row in rows] == ["2", "10", ""]
        rival = ["second_heading_rad", "second_score"]
        assert list(rows[0]) == ["image", *(FRAME_DTYPE.names or ()), *rival]
        assert all(row["reason"] == "ok" and abs(float(row["heading_rad"])) < 0.2 for row in rows)
        assert all(row["innovation_rad"] == row["test_ratio"] == "" for row in rows)
        assert "assuming a horizontal field of view of" in run.err
        assert "no distortion" in run.err
        assert "assuming level" in run.err
        assert "3 pictures: 3 measured" in run.err

    def test_camera_and_attitude_make_it_agree_with_the_truth(
        self, corridor: Corridor, start_of_office: Path
    ) -> None:
        mav0 = start_of_office / "mav0"
        run = corridor(
            *("measure", mav0 / "cam0/data", "--camera", mav0 / "cam0/sensor.yaml"),
            *("--attitude", mav0 / "attitude0/data.csv", "-o", "deep/frames.csv"),
        )
        assert run.code == 0, run.err
        assert run.out == ""
        assert "assuming" not in run.err
        rows = rows_of(Path("deep/frames.csv").read_text())
        truth = {
            row["timestamp_ns"]: row for row in rows_of((start_of_office / "corridor_truth.csv").read_text())
        }
        errors = [
            float(row["heading_rad"]) - float(truth[row["timestamp_ns"]]["heading_rad"])
            for row in rows
            if row["accepted"] == "true"
        ]
        assert len(errors) >= 0.9 * N_FRAMES
        assert np.sqrt(np.mean(np.square(errors))) < np.radians(0.3)

    def test_attitude_by_picture_name(self, corridor: Corridor, pictures: list[Path], tmp_path: Path) -> None:
        table = tmp_path / "tilt.csv"
        table.write_text(
            f"image,roll_rad,pitch_rad\n{pictures[0].name},0.0,0.0\n{pictures[1].name},0.0,0.1\n"
        )
        run = corridor("measure", *pictures[:3], "--attitude", table)
        assert run.code == 0, run.err
        assert "1 picture without an attitude" in run.err

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("image,roll,pitch\na.jpg,0,0\n", ["roll_rad"]),
            ("image,roll_rad,pitch_rad\na.jpg,0\n", ["line 2"]),
            ("image,roll_rad,pitch_rad\na.jpg,0,2.0\n", ["line 2", "pitch_rad 2"]),
            ("image,roll_rad,pitch_rad\n", ["no rows"]),
            ("", ["empty"]),
            ("#timestamp [ns],qw,qx,qy,qz\n1,0,0,0,0\n", ["unit length"]),
        ],
    )
    def test_an_attitude_file_that_is_wrong(
        self, corridor: Corridor, pictures: list[Path], tmp_path: Path, text: str, words: list[str]
    ) -> None:
        (tmp_path / "tilt.csv").write_text(text)
        refused(corridor("measure", pictures[0], "--attitude", tmp_path / "tilt.csv"), "tilt.csv", *words)

    def test_a_calibration_of_other_size_is_scaled(
        self, corridor: Corridor, start_of_office: Path, pictures: list[Path], tmp_path: Path
    ) -> None:
        small = tmp_path / "small.png"
        image = read_grey(pictures[0])
        cv2.imwrite(str(small), cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA))
        run = corridor("measure", pictures[0], small, "--camera", start_of_office / "mav0/cam0/sensor.yaml")
        whole, half = (float(row["heading_rad"]) for row in rows_of(run.out))
        assert half == pytest.approx(whole, abs=np.radians(0.5))

    def test_a_calibration_of_other_shape_is_refused(
        self, corridor: Corridor, start_of_office: Path, tmp_path: Path
    ) -> None:
        cv2.imwrite(str(tmp_path / "wide.png"), np.zeros((360, 640), np.uint8))
        camera = start_of_office / "mav0/cam0/sensor.yaml"
        refused(
            corridor("measure", tmp_path / "wide.png", "--camera", camera), "wide.png", "640x360", "640x480"
        )

    def test_an_unreadable_picture_is_a_row(
        self, corridor: Corridor, pictures: list[Path], tmp_path: Path
    ) -> None:
        (tmp_path / "torn.jpg").write_bytes(b"\xff\xd8\xff")
        run = corridor("measure", tmp_path / "torn.jpg", pictures[0])
        assert run.code == 0
        torn, good = rows_of(run.out)
        assert (torn["reason"], torn["accepted"], torn["heading_rad"]) == ("unreadable", "false", "")
        assert good["reason"] == "ok"
        assert "1 unreadable" in run.err

    def test_nothing_but_unreadable_pictures(self, corridor: Corridor, tmp_path: Path) -> None:
        for name in ("a.jpg", "b.jpg"):
            (tmp_path / name).write_bytes(b"\xff\xd8\xff")
        refused(corridor("measure", tmp_path / "a.jpg", "-o", "frames.csv"), "a.jpg", "does not decode")
        refused(corridor("measure", tmp_path / "a.jpg", tmp_path / "b.jpg"), "none of the 2", "a.jpg")

    def test_a_phone_s_heic_is_to_be_converted(self, corridor: Corridor, tmp_path: Path) -> None:
        (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(40))
        for source in (tmp_path / "a.heic", tmp_path):
            refused(corridor("measure", source), "a.heic", "HEIC", "convert it to JPEG")

    def test_a_picture_that_is_too_large_is_to_be_scaled_down(
        self, corridor: Corridor, tmp_path: Path
    ) -> None:
        cv2.imwrite(str(tmp_path / "a.png"), np.zeros((6000, 8000), np.uint8))
        refused(corridor("measure", tmp_path / "a.png"), "8000x6000 pixels is too large", "scale it down")

    def test_nothing_to_measure(self, corridor: Corridor, tmp_path: Path, flight: Path) -> None:
        refused(corridor("measure", "nowhere.jpg"), "nowhere.jpg", "no such")
        refused(corridor("measure", tmp_path), "no pictures")
        verbs = {
            "flight.mp4": ("video", "`corridor fuse --video "),
            "data.csv": ("CSV", "`corridor inspect "),
        }
        for name, (what, verb) in verbs.items():
            (tmp_path / name).write_text("t,gx,gy,gz\n1,2,3,4\n")
            refused(
                corridor("measure", tmp_path / name), f"{name}: is of the format {what}, no picture", verb
            )
        refused(corridor("measure", flight), "corridor fuse")
        assert corridor("measure").code == 2

    def test_overlays_lie_apart_and_never_meet(
        self, corridor: Corridor, pictures: list[Path], tmp_path: Path
    ) -> None:
        (tmp_path / "other").mkdir()
        twin = Path(shutil.copy(pictures[0], tmp_path / "other"))
        run = corridor("measure", pictures[0], twin, "--overlay", "drawn")
        assert run.code == 0, run.err
        stem = twin.stem
        assert set(os.listdir("drawn")) == {f"{stem}_overlay.jpg", f"{stem}_overlay_2.jpg"}
        drawn = read_colour(f"drawn/{stem}_overlay.jpg")
        assert drawn.shape[1] >= 640
        shutil.rmtree("drawn")
        refused(corridor("measure", twin, "--overlay", twin.parent), "among the pictures")
        refused(corridor("measure", twin, "--overlay", pictures[0]), "is a file, not a folder")
        refused(corridor("measure", twin, "--overlay", "drawn.png"), "is the name of a picture")

    def test_the_table_never_replaces_a_picture_or_a_folder(
        self, corridor: Corridor, pictures: list[Path], tmp_path: Path
    ) -> None:
        refused(corridor("measure", pictures[0], "-o", pictures[1]), "-o names a picture")
        refused(corridor("measure", pictures[0], "-o", tmp_path), "-o names a folder")

    def test_the_articles_method_needs_no_camera(self, corridor: Corridor, pictures: list[Path]) -> None:
        run = corridor("measure", pictures[0], "--method", "paper")
        assert run.code == 0
        assert 0 <= float(rows_of(run.out)[0]["paper_yaw_rad"]) < np.pi / 2

    def test_an_interrupt_leaves_no_table(
        self, corridor: Corridor, pictures: list[Path], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(path: Path) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(measure_images, "read_image", interrupt)
        assert corridor("measure", pictures[0], "-o", "frames.csv").code == 130
        assert os.listdir() == []


class TestSimulate:
    SMALL = ("--duration", "1", "--size", "160x120")

    def test_a_simulated_flight_can_be_fused(self, corridor: Corridor) -> None:
        run = corridor("simulate", "flight", *self.SMALL, "--seed", "3", "--width", "2.4")
        assert run.code == 0, run.err
        assert "corridor fuse flight" in run.out
        assert {"mav0", "corridor_truth.csv"} <= set(os.listdir("flight"))
        truth = rows_of(Path("flight/corridor_truth.csv").read_text())
        assert {float(row["corridor_width_m"]) for row in truth} == {2.4}
        pictures = sorted(Path("flight/mav0/cam0/data").iterdir())
        assert 19 <= len(pictures) <= 21
        assert read_colour(pictures[0]).shape[:2] == (120, 160)
        assert corridor("fuse", "flight").code == 0

    def test_the_options_go_on_top_of_the_file(self, tmp_path: Path) -> None:
        file = tmp_path / "s.toml"
        file.write_text("seed = 5\n[scene]\nwidth_m = 3.0\n[motion]\nspeed_m_s = 2.0\n")
        config = simulation_config(file, width_m=2.5, duration_s=60.0, turn_deg=-65.0)
        assert (config.seed, config.scene.width_m, config.motion.speed_m_s) == (5, 2.5, 2.0)
        assert config.scene.length_m > 120  # room for a minute at 2 m/s
        assert config.motion.route == (2,)
        assert config.scene.junctions[0].angle_rad == pytest.approx(np.radians(-65))

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--size", "big"], ["--size", "big", "640x480"]),
            (["--turn", "10"], ["--turn 10", "30 to 150 degrees"]),
            (["--duration", "-1"], ["duration_s", "-1"]),
            (["--config", "none.toml"], ["none.toml"]),
            (["--camera", "none.yaml"], ["none.yaml"]),
        ],
    )
    def test_a_wrong_option_is_one_line(
        self, corridor: Corridor, arguments: list[str], words: list[str]
    ) -> None:
        refused(corridor("simulate", "flight", *arguments), *words)

    def test_an_unknown_setting_is_named(self, corridor: Corridor, tmp_path: Path) -> None:
        (tmp_path / "s.toml").write_text("[camera]\nrate = 30\n")
        refused(corridor("simulate", "flight", "--config", tmp_path / "s.toml"), "s.toml", "camera.rate")

    def test_an_existing_folder_is_left_alone(self, corridor: Corridor, tmp_path: Path) -> None:
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "notes.txt").write_text("keep")
        refused(corridor("simulate", tmp_path / "mine", *self.SMALL), "mine")
        assert os.listdir(tmp_path / "mine") == ["notes.txt"]


class TestHelp:
    def test_the_first_page_names_every_command(self, corridor: Corridor) -> None:
        run = corridor("--help")
        assert run.code == 0
        for word in ("fuse", "measure", "simulate", "report.html", "--version"):
            assert word in run.out

    @pytest.mark.parametrize("command", ["fuse", "measure", "simulate", "batch", "live"])
    def test_each_command_shows_examples_and_the_next_step(self, corridor: Corridor, command: str) -> None:
        run = corridor(command, "--help")
        assert run.code == 0
        assert "Examples:" in run.out
        assert "Next:" in run.out
        assert f"  corridor {command} " in run.out
        assert (
            run.out.index("Examples:") < run.out.index("Options:") < 2500
        )  # the manual is in the documentation

    def test_the_shell_completes_commands_and_options(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for typed, expected in (("corridor ba", "batch"), ("corridor batch --ti", "--timeout")):
            monkeypatch.setenv("_CORRIDOR_COMPLETE", "complete_bash")
            monkeypatch.setenv("COMP_WORDS", typed)
            monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
            run = subprocess.run([sys.executable, "-m", "fusion"], capture_output=True, text=True)
            assert run.stdout.split() == [expected]

    def test_no_arguments_show_the_help(self, corridor: Corridor) -> None:
        run = corridor()
        assert "Usage: corridor" in run.out + run.err

    @pytest.mark.parametrize(
        "arguments",
        [
            ["fly"],
            ["fuse"],
            ["fuse", "a", "--altitude", "3"],
            ["fuse", "a", "--method", "magic"],
            ["inspect"],
            ["simulate", "x", "--seed", "a"],
            ["simulate", "x", "--turn", "20"],
        ],
    )
    def test_usage_errors_end_with_2(self, corridor: Corridor, arguments: list[str]) -> None:
        run = corridor(*arguments)
        assert run.code == 2
        assert re.fullmatch(r"corridor: error: .+ \(.+\)\n", run.err)
