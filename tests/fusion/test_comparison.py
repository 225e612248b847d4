"""``corridor evaluate``: truth files as people have them, outputs side by side, and what is refused."""

from __future__ import annotations

import csv
import json
import re
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.cli.evaluate_text import comparison_text
from fusion.estimator.tables import ESTIMATE_DTYPE
from fusion.evaluation.comparison import compare, errors_over_time, read_outputs
from fusion.evaluation.comparison_table import HEAD, write_comparison_table
from fusion.evaluation.truth_file import _times, read_truth
from fusion.outputs.tum import write_tum
from fusion.report.comparison import comparison_figure, write_comparison_figure
from fusion.result.conventions import Frame, file_facts, summary_in_frame, table_in_frame
from fusion.result.summary_json import write_summary
from fusion.result.tables_csv import write_table
from tests.command import Corridor
from vision import InputError

T0_NS = 1_600_000_000_000_000_000
N = 400


def estimates(error_rad: float = radians(1), offset_m: float = 0.22, corridors: int = 1) -> Any:
    """Four seconds at 100 Hz, heading 10 degrees, off by an error; half the time in a second corridor if asked."""
    table = np.zeros(N, ESTIMATE_DTYPE)
    table["timestamp_ns"] = T0_NS + np.arange(N) * 10_000_000
    table["heading_rad"], table["heading_std_rad"] = radians(10) + error_rad, radians(1)
    table["lateral_offset_m"], table["lateral_offset_std_m"] = offset_m, 0.02
    table["lateral_offset_norm"], table["lateral_offset_norm_std"] = offset_m / 1.1, 0.02
    table["status"] = "tracking"
    table["status"][:40] = "initialising"
    if corridors == 2:
        table["corridor_index"][N // 2 :], table["corridor_turn_rad"][N // 2 :] = 1, radians(-90)
    return table


def write_output(folder: Path, table: Any, frame: Frame = Frame.FRD, smoothed: Any = None) -> Path:
    folder.mkdir(parents=True)
    write_table(table_in_frame(table, frame), folder / "estimates.csv")
    write_table(table_in_frame(table if smoothed is None else smoothed, frame), folder / "smoothed.csv")
    write_summary(summary_in_frame({"flight": "f", "method": "geometric"}, frame), folder / "summary.json")
    return folder


def write_csv(path: Path, header: str, row: Any, rows: int = 41, step_ns: int = 100_000_000) -> Path:
    """Write a truth of four seconds at 10 Hz; ``row`` makes a line of a time."""
    lines = [row(T0_NS + k * step_ns) for k in range(rows)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    header = "timestamp_ns,heading_rad,lateral_offset_m,corridor_width_m,corridor_id,in_junction"
    return write_csv(tmp_path / "corridor_truth.csv", header, lambda t: f"{t},{radians(10)},0.2,2.2,1,0")


class TestTruth:
    @pytest.mark.parametrize(
        ("header", "row"),
        [
            ("#timestamp [ns],heading [deg],lateral offset [m]", lambda t: f"{t},10,0.2"),
            ("timestamp,heading_deg,lateral_offset_m", lambda t: f"{t},10,0.2"),
            (
                "time_s,lateral_offset_cm,heading_rad",
                lambda t: f"{t // 10**9}.{t % 10**9:09d},20,{radians(10)}",
            ),
            ("t_us,heading_deg,lateral_offset_m", lambda t: f"{t // 1000},10.0,0.2"),
            ("# made by hand\n# timestamp_ms,heading_deg,lateral_offset_m", lambda t: f"{t // 10**6},10,0.2"),
        ],
    )
    def test_csv_by_the_names_of_its_columns(self, tmp_path: Path, header: str, row: Any) -> None:
        truth = read_truth(write_csv(tmp_path / "t.csv", header, row))
        assert truth.corridor.t_ns.tolist() == [T0_NS + k * 100_000_000 for k in range(41)]
        np.testing.assert_allclose(truth.corridor.heading_rad, radians(10))
        np.testing.assert_allclose(truth.corridor.lateral_offset_m, 0.2)
        assert (truth.fixed_axis, truth.offset, truth.problems) == (False, "m", ())

    def test_a_flight_folder_stands_for_its_truth(self, truth: Path) -> None:
        read = read_truth(truth.parent)
        assert (read.offset, read.corridor.corridor_id[0], read.corridor.corridor_width_m[0]) == (
            "both",
            1,
            2.2,
        )

    def test_ros_signs_are_turned(self, tmp_path: Path) -> None:
        path = write_csv(
            tmp_path / "t.csv", "timestamp_ns,yaw_deg,lateral_offset_norm", lambda t: f"{t},-10,-0.2"
        )
        truth = read_truth(path, Frame.ROS)
        assert truth.corridor.heading_rad[0] == pytest.approx(radians(10))
        assert truth.corridor.lateral_offset_m[0] / (truth.corridor.corridor_width_m[0] / 2) == pytest.approx(
            0.2
        )
        assert (truth.fixed_axis, truth.offset) == (True, "norm")
        with pytest.raises(InputError, match=r"which way its angles count \(add --truth-frame"):
            read_truth(path)

    def test_quaternions_in_any_order_of_columns(self, tmp_path: Path) -> None:
        c, s = np.cos(radians(5)), np.sin(radians(5))
        header = "#timestamp,q_RS_x [],q_RS_y [],q_RS_z [],q_RS_w []"
        path = write_csv(tmp_path / "data.csv", header, lambda t: f"{t},0,0,{s},{c}")
        truth = read_truth(path, Frame.ROS)
        np.testing.assert_allclose(truth.corridor.heading_rad, -radians(10))
        assert truth.offset is None
        assert "no offsets" in truth.source

    def test_a_foreign_trajectory_must_say_which_way_it_counts(self, tmp_path: Path) -> None:
        c, s = np.cos(radians(5)), np.sin(radians(5))
        path = tmp_path / "mocap.txt"
        path.write_text(f"# x y z\n1600000000.0 5 -0.2 1 0 0 {-s} {c}\n1600000000.5 5 -0.2 1 0 0 {-s} {c}\n")
        with pytest.raises(InputError, match="a TUM trajectory does not say which way"):
            read_truth(path)
        truth = read_truth(path, Frame.ROS)
        np.testing.assert_allclose(truth.corridor.heading_rad, radians(10))
        np.testing.assert_allclose(truth.corridor.lateral_offset_m, 0.2)
        assert truth.fixed_axis

    @pytest.mark.parametrize("upright", [True, False])
    @pytest.mark.parametrize("written", ["x, y, z, w", "w, x, y, z"])
    @pytest.mark.parametrize("form", ["tum", "csv"])
    def test_quaternions_in_the_wrong_order_are_named(
        self, tmp_path: Path, form: str, written: str, upright: bool
    ) -> None:
        yaw = np.radians(60 * np.sin(np.arange(41) / 5))
        body = Rotation.from_euler("ZYX", np.column_stack([yaw, 0 * yaw + 0.03, 0 * yaw - 0.05]))
        q = (body if upright else body * Rotation.from_euler("x", np.pi)).as_quat()
        q = q if written == "x, y, z, w" else np.roll(q, 1, axis=1)
        rows = [",".join(f"{x:.6f}" for x in row) for row in q.tolist()]
        if form == "tum":
            path = tmp_path / "mocap.txt"
            lines = [f"{1600000000 + k / 10} 0 0 0 {row.replace(',', ' ')}" for k, row in enumerate(rows)]
            path.write_text("\n".join(lines) + "\n")
            order = "x, y, z, w"
        else:  # the names say which is which, and the logger took w for the first
            path = tmp_path / "mocap.csv"
            lines = [f"{T0_NS + k * 10**8},{row}" for k, row in enumerate(rows)]
            path.write_text("\n".join(["timestamp_ns,qw,qx,qy,qz", *lines]) + "\n")
            order = "w, x, y, z"
        if written == order:
            np.testing.assert_allclose(read_truth(path, Frame.FRD).corridor.heading_rad, yaw, atol=0.02)
            return
        with pytest.raises(
            InputError, match=rf"in the order {written} they are level \(write them in the order {order}"
        ):
            read_truth(path, Frame.FRD)

    def test_quaternions_of_a_cameras_axes_are_named(self, tmp_path: Path) -> None:
        optical = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]).as_quat()
        path = tmp_path / "slam.txt"
        row = " ".join(f"{x:.6f}" for x in optical)
        path.write_text("".join(f"{1600000000 + k / 10} 0 0 0 {row}\n" for k in range(9)))
        with pytest.raises(InputError, match="90 degrees off level: not of the vehicle's body"):
            read_truth(path, Frame.ROS)

    @pytest.mark.parametrize("frame", list(Frame))
    def test_an_output_of_ours_is_a_truth_in_either_form(self, tmp_path: Path, frame: Frame) -> None:
        table = estimates(0.0, 0.2)
        table["heading_rad"][:3] = np.nan
        out = write_output(tmp_path / "out", table, frame)
        facts = file_facts({}, frame)
        write_tum(table, out / "estimates.tum", frame, facts, None)
        for name in ("estimates.csv", "estimates.tum"):
            truth = read_truth(out / name)
            assert truth.corridor.t_ns[0] == T0_NS + 30_000_000
            np.testing.assert_allclose(truth.corridor.heading_rad, radians(10))
            np.testing.assert_allclose(truth.corridor.lateral_offset_m, 0.2)
            assert not truth.fixed_axis

    @pytest.mark.parametrize(
        ("header", "row", "message"),
        [
            (
                "timestamp_ns,offset_m",
                "1,2",
                r"has no heading column among timestamp_ns, offset_m",
            ),
            (
                "timestamp_ns,heading",
                "1,2",
                r"column heading does not say its unit \(name it heading_rad",
            ),
            (
                "when,heading_rad",
                "1,2",
                r"has no time column among when, heading_rad \(name it with its unit",
            ),
            ("time,heading_rad", "1.5,2", "column time does not say its unit"),
            ("timestamp_ns,heading_rad", "1,", "contains no row with a heading"),
            ("timestamp_ns,heading_rad", "1,north", "heading_rad is 'north', no number"),
            ("timestamp_ns,heading_rad", "1,45", r"headings reach 45 rad \(are they degrees"),
            ("timestamp_s,heading_rad", "9e30,1", "times are too large for s"),
            (
                "timestamp_ns,heading_rad",
                "",
                "does not name its columns|has a header but no rows|contains no",
            ),
            ("1,2", "3,4", "does not name its columns in the first line"),
        ],
    )
    def test_what_cannot_be_used_is_one_line(
        self, tmp_path: Path, header: str, row: str, message: str
    ) -> None:
        path = tmp_path / "t.csv"
        path.write_text(f"{header}\n{row}\n{row}\n")
        with pytest.raises(InputError, match=message) as error:
            read_truth(path)
        assert "\n" not in str(error.value)

    def test_missing_empty_and_binary_files(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="No such file"):
            read_truth(tmp_path / "none.csv")
        with pytest.raises(InputError, match=r"contains no corridor_truth\.csv"):
            read_truth(tmp_path)
        (tmp_path / "smoothed.csv").touch()
        with pytest.raises(InputError, match=r"is an output of corridor fuse.*give .*/smoothed\.csv"):
            read_truth(tmp_path)
        (tmp_path / "e.csv").write_text("\n")
        with pytest.raises(InputError, match="contains no rows"):
            read_truth(tmp_path / "e.csv")
        (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x81")
        with pytest.raises(InputError, match="is not a text file"):
            read_truth(tmp_path / "b.csv")

    def test_bad_rows_among_many_are_dropped_and_told(self, truth: Path) -> None:
        lines = truth.read_text().splitlines()
        lines[5] = lines[5].replace("0.17", "torn")
        lines[9], lines[10] = lines[10], lines[9]
        truth.write_text("\n".join([*lines, lines[-1][:12]]))
        read = read_truth(truth)
        assert len(read.corridor.t_ns) == 40
        assert [
            word for p in read.problems for word in ("other length", "not numbers", "backwards") if word in p
        ] == [
            "other length",
            "not numbers",
            "backwards",
        ]

    @given(st.integers(-(10**18), 2 * 10**18))
    def test_decimal_seconds_keep_every_nanosecond(self, t_ns: int) -> None:
        whole, rest = divmod(abs(t_ns), 10**9)
        text = f"{'-' if t_ns < 0 else ''}{whole}.{rest:09d}"
        assert _times(Path("t"), [text], "s").tolist() == [t_ns]


class TestCompare:
    def test_errors_in_every_measure_causal_and_smoothed(self, tmp_path: Path, truth: Path) -> None:
        out = write_output(tmp_path / "out", estimates(), smoothed=estimates(radians(0.5), 0.21))
        found = compare(read_outputs([out]), read_truth(truth))["outputs"][0]
        for word in ("rmse", "mae", "max", "p50", "p90", "p95", "p99", "bias"):
            assert found["causal"]["heading"][f"{word}_rad"] == pytest.approx(radians(1))
            assert found["smoothed"]["heading"][f"{word}_rad"] == pytest.approx(radians(0.5))
            assert found["causal"]["lateral_offset_m"][f"{word}_m"] == pytest.approx(0.02)
            assert found["causal"]["lateral_offset_norm"][f"{word}_norm"] == pytest.approx(0.02 / 1.1)
        assert found["causal"]["heading"]["nees_mean"] == pytest.approx(1.0)
        assert found["causal"]["status_share"] == {"initialising": 0.1, "tracking": 0.9}
        assert found["causal"]["judged"] == 360

    def test_the_frame_of_an_output_changes_nothing(self, tmp_path: Path, truth: Path) -> None:
        outs = [write_output(tmp_path / str(frame), estimates(), frame) for frame in Frame]
        frd, ros = compare(read_outputs(outs), read_truth(truth))["outputs"]
        for name in ("heading", "lateral_offset_m", "lateral_offset_norm"):
            assert frd["causal"][name] == pytest.approx(ros["causal"][name])
        assert ros["causal"]["heading"]["bias_rad"] == pytest.approx(radians(1))

    def test_quantities_that_the_truth_lacks_are_left_out(self, tmp_path: Path) -> None:
        out = read_outputs([write_output(tmp_path / "out", estimates())])
        for header, row, present in (
            ("timestamp_ns,heading_deg", "{},10", set()),
            ("timestamp_ns,heading_deg,lateral_offset_m", "{},10,0.2", {"lateral_offset_m"}),
            ("timestamp_ns,heading_deg,lateral_offset_norm", "{},10,0.2", {"lateral_offset_norm"}),
        ):
            path = write_csv(tmp_path / "t.csv", header, row.format)
            found = compare(out, read_truth(path))["outputs"][0]["causal"]
            assert {name for name in found if name.startswith("lateral")} == present
            assert all(found[name]["count"] for name in present)

    def test_corridors_are_told_apart(self, tmp_path: Path) -> None:
        header = "timestamp_ns,heading_deg,corridor_id"
        path = write_csv(tmp_path / "t.csv", header, lambda t: f"{t},10,{1 if t < T0_NS + 2 * 10**9 else 2}")
        out = write_output(tmp_path / "out", estimates(corridors=2))
        found = compare(read_outputs([out]), read_truth(path))
        corridors = found["outputs"][0]["causal"]["corridors"]
        assert list(corridors) == ["1", "2"]
        assert corridors["2"]["status_share"] == {"tracking": 1.0}
        text = comparison_text(found)
        assert text.count("  corridor 2") == 2  # heading and status
        assert "lateral offset: the truth has none" in text

    def test_yaw_from_a_fixed_axis_goes_through_the_turn(self, tmp_path: Path) -> None:
        header = "timestamp_ns,yaw_deg,lateral_offset_m"
        path = write_csv(
            tmp_path / "t.csv",
            header,
            lambda t: f"{t},{10 if t < T0_NS + 2 * 10**9 else -80},0.2",
            401,
            10_000_000,
        )
        out = write_output(tmp_path / "out", estimates(corridors=2))
        found = compare(read_outputs([out]), read_truth(path, Frame.FRD))["outputs"][0]["causal"]
        assert found["heading"]["max_rad"] == pytest.approx(radians(1))
        assert found["heading"]["count"] == 360
        assert found["lateral_offset_m"]["count"] == 160  # the first corridor's rows alone

    def test_align_takes_a_constant_out_and_tells_it(self, tmp_path: Path) -> None:
        path = write_csv(
            tmp_path / "t.csv", "timestamp_ns,yaw_deg,lateral_offset_m", lambda t: f"{t},-171,1.5"
        )
        out = write_output(tmp_path / "out", estimates())
        found = compare(read_outputs([out]), read_truth(path, Frame.FRD), align=True)
        causal = found["outputs"][0]["causal"]
        assert causal["heading"]["max_rad"] == pytest.approx(0.0, abs=1e-9)
        assert causal["lateral_offset_m"]["max_m"] == pytest.approx(0.0, abs=1e-9)
        assert causal["removed"]["0"]["heading_rad"] == pytest.approx(radians(-178))
        assert causal["removed"]["0"]["lateral_offset_m"] == pytest.approx(0.22 - 1.5)
        assert "removed in corridor 0: -178.00 degrees, -128.0 cm" in comparison_text(found)

    def test_no_common_time_is_refused_with_both_spans(self, tmp_path: Path, truth: Path) -> None:
        table = estimates()
        table["timestamp_ns"] -= T0_NS
        with pytest.raises(InputError, match=r"no time in common: 0\.000 to 3\.990 s and 1600000000\.000 to"):
            compare(read_outputs([write_output(tmp_path / "out", table)]), read_truth(truth))

    def test_a_truth_by_another_clock_is_compared_once_shifted(self, tmp_path: Path, truth: Path) -> None:
        table = estimates()
        here = compare(read_outputs([write_output(tmp_path / "here", table)]), read_truth(truth))
        table["timestamp_ns"] -= T0_NS
        outputs, true = read_outputs([write_output(tmp_path / "out", table)]), read_truth(truth)
        with pytest.raises(InputError) as refused:
            compare(outputs, true)
        told = re.search(r"--truth-shift (-?[0-9.]+)", refused.value.remedy or "")
        assert told is not None
        found = compare(outputs, true.shifted(float(told[1])))
        assert found["outputs"][0]["causal"] == here["outputs"][0]["causal"]
        assert f"{float(told[1]):+.3f}".rstrip("0").rstrip(".") + " s to its times" in comparison_text(found)

    @pytest.mark.parametrize("seconds", [np.nan, np.inf, 1e10, -1e12])
    def test_no_truth_is_shifted_out_of_all_times(self, truth: Path, seconds: float) -> None:
        with pytest.raises(InputError, match="truth-shift"):
            read_truth(truth).shifted(seconds)

    def test_half_an_overlap_is_told(self, tmp_path: Path, truth: Path) -> None:
        table = estimates()
        table["timestamp_ns"] += 2 * 10**9
        text = comparison_text(
            compare(read_outputs([write_output(tmp_path / "out", table)]), read_truth(truth))
        )
        assert "the truth covers 2.0 of its 4.0 s" in text
        assert "outside the truth's time" in text

    def test_outputs_are_named_by_what_tells_them_apart(self, tmp_path: Path) -> None:
        outs = [write_output(tmp_path / name / "out", estimates()) for name in ("a", "b")]
        assert [output.name for output in read_outputs(outs)] == ["a/out", "b/out"]
        assert read_outputs(outs[:1])[0].name == "out"

    def test_what_is_no_output_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no such folder"):
            read_outputs([tmp_path / "none"])
        with pytest.raises(
            InputError, match=r"contains no estimates\.csv \(give a folder that corridor fuse wrote"
        ):
            read_outputs([tmp_path])
        out = write_output(tmp_path / "out", estimates())
        with pytest.raises(InputError, match="is a file, not an output folder"):
            read_outputs([out / "summary.json"])
        (out / "summary.json").write_text("[]")
        with pytest.raises(InputError, match="is not the summary"):
            read_outputs([out])

    def test_the_text_fits_a_hundred_columns(self, tmp_path: Path, truth: Path) -> None:
        names = ("a_rather_long_name_for_an_output_folder", "b")
        outs = [write_output(tmp_path / name, estimates(radians(120), 2.0)) for name in names]
        lines = comparison_text(compare(read_outputs(outs), read_truth(truth))).splitlines()
        table = [line for line in lines if not line.startswith(("truth", "a_rather"))]
        assert max(map(len, table)) <= 100
        head = next(line for line in lines if line.startswith("heading, degrees"))
        assert head.split()[2:] == ["RMSE", "MAE", "max", "p50", "p90", "p95", "p99", "NEES"]
        row = lines[lines.index(head) + 1]
        assert row.split()[1:3] == ["causal", "120.000"]


class TestCommand:
    def test_tables_and_json_say_the_same(self, tmp_path: Path, truth: Path, corridor: Corridor) -> None:
        outs = [
            write_output(tmp_path / "a", estimates()),
            write_output(tmp_path / "b", estimates(radians(2))),
        ]
        code, text, _ = corridor("evaluate", *outs, "--truth", truth)
        assert code == 0
        code, data, _ = corridor("evaluate", *outs, "--truth", truth, "--json")
        assert code == 0
        found = json.loads(data)
        rmse = [output["causal"]["heading"]["rmse_rad"] for output in found["outputs"]]
        assert rmse == pytest.approx([radians(1), radians(2)])
        assert all(f"{np.degrees(value):.3f}" in text for value in rmse)

    def test_refusals_are_one_line_and_exit_code_2(
        self, tmp_path: Path, truth: Path, corridor: Corridor
    ) -> None:
        code, text, err = corridor("evaluate", tmp_path / "none", "--truth", truth)
        assert (code, text) == (2, "")
        assert err.startswith("corridor: error: ")
        assert err.count("\n") == 1
        assert corridor("evaluate", tmp_path)[0] == 2  # no --truth

    @pytest.mark.parametrize("command", ["evaluate", "config"])
    def test_help_shows_examples_and_the_next_step(self, corridor: Corridor, command: str) -> None:
        code, text, _ = corridor(command, "--help")
        assert code == 0
        assert "Examples:" in text
        assert "Next:" in text
        assert f"  corridor {command} " in text

    def test_config_prints_what_can_be_given_back(self, tmp_path: Path, corridor: Corridor) -> None:
        code, text, _ = corridor("config")
        (tmp_path / "my.toml").write_text(text + "corridor_width_m = 2.2\n")
        code, effective, _ = corridor("config", tmp_path / "my.toml")
        assert code == 0
        assert "corridor_width_m = 2.2  # m" in effective
        code, text, err = corridor("config", "--simulate", tmp_path / "my.toml")
        assert (code, text) == (2, "")
        assert "unknown setting" in err


@pytest.mark.parametrize("told", list(Frame))
def test_a_truth_that_turns_the_other_way_is_named(tmp_path: Path, told: Frame) -> None:
    """Yaw positive left: right when told so, and otherwise the remedy says so."""
    table = estimates()
    yaw = 0.3 * np.sin(np.arange(N) * 0.02)
    table["heading_rad"] = yaw
    rows = [
        f"{t},{-angle:.6f}" for t, angle in zip(table["timestamp_ns"].tolist(), yaw.tolist(), strict=True)
    ]
    path = tmp_path / "mocap.csv"
    path.write_text("\n".join(["timestamp_ns,yaw_rad", *rows]) + "\n")
    found = compare(read_outputs([write_output(tmp_path / "out", table)]), read_truth(path, told))
    named = [text for text in found.truth.problems if "--truth-frame ros" in text]
    assert len(named) == (told is Frame.FRD)


# --- as a figure and as a table ---


def two_outputs(tmp_path: Path) -> tuple[Any, Any]:
    write_output(tmp_path / "good & new", estimates(radians(1)))
    write_output(tmp_path / "bad_old", estimates(radians(3), offset_m=0.32))
    truth = write_csv(
        tmp_path / "truth.csv",
        "timestamp_ns,heading_deg,lateral_offset_m",
        lambda t_ns: f"{t_ns},10,0.22",
    )
    return read_outputs([tmp_path / "good & new", tmp_path / "bad_old"]), read_truth(truth)


def test_the_figure_draws_the_errors_that_the_table_states(tmp_path: Path) -> None:
    outputs, truth = two_outputs(tmp_path)
    series = errors_over_time(outputs[1].causal, truth, "m")
    judged = np.isfinite(series.heading_rad)
    assert judged.sum() == 360  # not while it initialises
    assert np.allclose(series.heading_rad[judged], radians(3))
    assert np.allclose(series.lateral_offset[judged], 0.1)
    figure = comparison_figure(outputs, truth)
    heading, shares, offset, _ = figure.axes
    assert [line.get_label() for line in heading.lines[:2]] == ["good & new", "bad_old"]
    assert np.nanmax(np.asarray(heading.lines[1].get_ydata(), dtype=float)) == pytest.approx(3.0)
    assert np.nanmax(np.asarray(offset.lines[1].get_ydata(), dtype=float)) == pytest.approx(10.0)
    assert np.max(np.asarray(shares.lines[0].get_ydata(), dtype=float)) == pytest.approx(100.0)
    assert offset.get_ylabel() == "Offset error, cm"


@pytest.mark.parametrize("ending", [".png", ".svg", ".pdf"])
def test_a_figure_is_written_in_each_format(tmp_path: Path, ending: str) -> None:
    write_comparison_figure(*two_outputs(tmp_path), tmp_path / f"errors{ending}")
    head = (tmp_path / f"errors{ending}").read_bytes()[:100]
    assert {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[ending] in head


def test_a_table_is_written_in_each_format(tmp_path: Path) -> None:
    outputs, truth = two_outputs(tmp_path)
    found = compare(outputs, truth)
    for ending in (".csv", ".md", ".tex"):
        write_comparison_table(found, tmp_path / f"errors{ending}")
    rows = list(csv.DictReader((tmp_path / "errors.csv").open()))
    assert [(row["output"], row["estimate"]) for row in rows] == [
        (name, kind) for name in ("good & new", "bad_old") for kind in ("filter", "smoother")
    ]
    assert rows[2]["heading RMSE, deg"] == "3.000"
    assert rows[2]["offset max, cm"] == "10.00"
    latex = (tmp_path / "errors.tex").read_text()
    assert r"good \& new & filter & 1.000" in latex
    assert r"bad\_old & smoother & 3.000" in latex
    markdown = (tmp_path / "errors.md").read_text().splitlines()
    assert all(line.count("|") == len(HEAD) + 1 for line in markdown)


@pytest.mark.parametrize("option", ["--plot", "--table"])
def test_an_unknown_format_is_refused_in_one_line(tmp_path: Path, corridor: Corridor, option: str) -> None:
    two_outputs(tmp_path)
    done = corridor(
        "evaluate", tmp_path / "bad_old", "--truth", tmp_path / "truth.csv", option, tmp_path / "e.doc"
    )
    assert done.code == 2
    assert re.search(r"e\.doc: is not a (table|figure) format", done.err)
    assert done.err.count("\n") == 1
    assert not (tmp_path / "e.doc").exists()
