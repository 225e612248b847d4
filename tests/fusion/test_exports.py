"""Exports read back with each format's own library."""

from __future__ import annotations

import base64
import json
from collections import defaultdict
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fusion.estimator.config import FusionConfig
from fusion.estimator.tables import ESTIMATE_DTYPE, FRAME_DTYPE
from fusion.flight import Flight, FrameStream, VectorStream
from fusion.outputs import exports
from fusion.outputs import foxglove as fox
from fusion.outputs.exports import EXPORT_FILES, Format, check_formats, write_exports
from fusion.outputs.folder import write_outputs
from fusion.result.conventions import COLUMNS, Frame, column_metadata, summary_in_frame, table_in_frame
from fusion.result.result import FusionResult
from fusion.result.summary import (
    CorridorErrors,
    CorridorStretch,
    ErrorStatistics,
    FlightErrors,
    Level,
    Summary,
    TableErrors,
)
from fusion.result.tables_csv import read_table
from vision import Camera, InputError
from vision.measurement import FrameMeasurement, LineClass, Reason

T0_NS = 1_600_000_000_123_456_789
N = 50


class Drawn:
    """A corridor's four edges; the third picture does not decode."""

    def read(self, index: int) -> Any:
        if index == 2:
            raise InputError("does not decode")
        picture = np.full((120, 160), 200, np.uint8)
        for x in (0, 159):
            for y in (0, 119):
                cv2.line(picture, (x, y), (80, 60), 40, 1, cv2.LINE_AA)
        return picture


@pytest.fixture(scope="module")
def flight() -> Flight:
    velocity = np.tile([1.0, 0.2, 0.0], (N, 1))
    return Flight(
        name="two walls",
        camera=Camera.from_fov(160, 120, radians(70)),
        frames=FrameStream(T0_NS + np.arange(5) * 100_000_000, Drawn()),
        velocity=VectorStream(T0_NS + np.arange(N) * 10_000_000, velocity),
    )


@pytest.fixture(scope="module")
def result(flight: Flight) -> FusionResult:
    """Half a second at 100 Hz, turned right by 10 degrees, 0.3 m right; unknown at first, coasting at the end."""
    table = np.zeros(N, ESTIMATE_DTYPE)
    table["timestamp_ns"] = T0_NS + np.arange(N) * 10_000_000
    table["heading_rad"], table["heading_std_rad"] = radians(10), 0.01
    table["lateral_offset_m"], table["lateral_offset_norm"] = 0.3, 0.25
    table["gyro_bias_rad_s"], table["corridor_turn_rad"] = 0.02, 0.5
    table["position"] = "right"
    table["status"] = np.repeat(["initialising", "tracking", "coasting"], [5, 40, 5])
    for name in (
        "heading_rad",
        "lateral_offset_m",
        "lateral_offset_norm",
        "vision_age_s",
        "imu_yaw_offset_rad",
    ):
        table[name][:5] = np.nan
    table["position"][:5] = ""
    frames = np.zeros(5, FRAME_DTYPE)
    frames["timestamp_ns"] = flight.frames.t_ns
    frames["accepted"], frames["reason"] = (
        [True, False, False, True, True],
        ["ok", "gate", "unreadable", "ok", "ok"],
    )
    frames["heading_rad"], frames["innovation_rad"], frames["paper_yaw_rad"] = radians(10), 0.001, 0.2
    frames["vp_x_px"], frames["vp_y_px"] = 80.0, 60.0
    frames["heading_rad"][2] = np.nan
    heading = ErrorStatistics("rad", 5, rmse=0.02, bias=0.01)
    corridor = CorridorErrors(5, None, ErrorStatistics("rad", 0), None, None)
    errors = TableErrors(5, 5, {}, None, heading, None, None, {"1": corridor})
    summary = Summary(
        verdict=Level.PASS,
        flight="two walls",
        corridors=(CorridorStretch(0, 0.5, 0, 1, 5, 3),),
        errors=FlightErrors(errors, errors, errors),
    )
    return FusionResult("two walls", FusionConfig(), table, table.copy(), frames, summary, ("a torn row",))


class TestConventions:
    def test_every_column_of_the_tables_is_described(self) -> None:
        assert set(COLUMNS) == {*(ESTIMATE_DTYPE.names or ()), *(FRAME_DTYPE.names or ())}
        for name in COLUMNS:
            for frame in Frame:
                assert "{" not in column_metadata(name, frame)["description"]
            for suffix, unit in (
                ("_rad", "rad"),
                ("_m", "m"),
                ("_px", "px"),
                ("_ns", "ns"),
                ("_rad_s", "rad/s"),
            ):
                if name.endswith(suffix):
                    assert column_metadata(name, Frame.FRD)["unit"] == unit

    def test_ros_turns_what_has_a_side_and_nothing_else(self, result: FusionResult) -> None:
        for table in (result.estimates, result.frames):
            turned = table_in_frame(table, Frame.ROS)
            for name in table.dtype.names or ():
                sign = -1.0 if name in {
                    "heading_rad",
                    "lateral_offset_m",
                    "lateral_offset_norm",
                    "yaw_rate_rad_s",
                    "gyro_bias_rad_s",
                    "imu_yaw_offset_rad",
                    "corridor_turn_rad",
                    "innovation_rad",
                } else 1.0  # fmt: skip
                expected = table[name] if sign > 0 else sign * table[name] + 0.0
                np.testing.assert_array_equal(turned[name], expected)
                assert table[name].dtype.kind != "f" or not np.signbit(turned[name][turned[name] == 0]).any()
        assert table_in_frame(result.frames, Frame.FRD) is result.frames

    def test_a_summary_names_its_frame_and_turns_its_signs(self, result: FusionResult) -> None:
        ros = summary_in_frame(result.summary, Frame.ROS)
        assert ros["frame"] == "ros"
        assert ros["corridors"][0]["turn_rad"] == -0.5
        heading = ros["errors"]["filter"]["heading"]
        assert (heading["bias_rad"], heading["rmse_rad"]) == (-0.01, 0.02)
        assert ros["errors"]["filter"]["corridors"]["1"]["heading"]["bias_rad"] is None
        assert summary_in_frame(result.summary, Frame.FRD) == result.summary | {"frame": "frd"}


class TestParquet:
    @pytest.fixture(params=list(Frame))
    def folder(self, request: Any, result: FusionResult, flight: Flight, tmp_path: Path) -> Any:
        pytest.importorskip("pyarrow")
        write_exports(result, flight, tmp_path, [Format.PARQUET], request.param)
        return tmp_path, request.param

    def test_values_come_back_with_units_frames_and_meaning(self, folder: Any, result: FusionResult) -> None:
        import pyarrow.parquet as pq

        path, frame = folder
        for name, table in (
            ("estimates", result.estimates),
            ("smoothed", result.smoothed),
            ("frames", result.frames),
        ):
            read = pq.read_table(path / f"{name}.parquet")
            assert read.column_names == list(table.dtype.names or ())
            expected = table_in_frame(table, frame)
            for column in read.column_names:
                values = read[column].to_pylist()
                for got, want in zip(values, expected[column].tolist(), strict=True):
                    assert got == (None if want == "" or want != want else want)
            heading = read.schema.field("heading_rad").metadata
            assert heading[b"unit"] == b"rad"
            assert b"axis" in heading[b"frame"]
            assert (b"positive right" in heading[b"description"]) is (frame is Frame.FRD)
            facts = read.schema.metadata
            assert facts[b"flight"] == b"two walls"
            assert facts[b"frame"] == str(frame).encode()
            assert facts[b"table"] == name.encode()
            assert (b"FLU" in facts[b"conventions"]) is (frame is Frame.ROS)
            assert {b"software", b"software_version", b"method"} <= set(facts)

    def test_pandas_reads_it_with_gaps_as_nan(self, folder: Any) -> None:
        pd = pytest.importorskip("pandas")
        table = pd.read_parquet(folder[0] / "estimates.parquet")
        assert table.heading_rad.isna().sum() == 5
        assert table.timestamp_ns.dtype == np.int64
        assert table.timestamp_ns.iloc[1] == T0_NS + 10_000_000


def read_tum(path: Path) -> tuple[list[str], Any]:
    lines = path.read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    rows = [line.split(" ") for line in lines if not line.startswith("#")]
    assert {len(row) for row in rows} <= {8}
    return comments, np.array(rows, dtype=float).reshape(-1, 8)


class TestTum:
    @pytest.mark.parametrize(("frame", "sign"), [(Frame.FRD, 1.0), (Frame.ROS, -1.0)])
    def test_a_trajectory_as_evo_takes_it(
        self, result: FusionResult, flight: Flight, tmp_path: Path, frame: Frame, sign: float
    ) -> None:
        write_exports(result, flight, tmp_path, [Format.TUM], frame)
        assert {path.name for path in tmp_path.iterdir()} == set(EXPORT_FILES[Format.TUM])
        comments, rows = read_tum(tmp_path / "estimates.tum")
        assert len(rows) == N - 5
        assert np.all(np.diff(rows[:, 0]) > 0)
        np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0, atol=1e-9)
        np.testing.assert_allclose(2 * np.arctan2(rows[:, 6], rows[:, 7]), sign * radians(10), atol=1e-9)
        np.testing.assert_allclose(rows[:, 2], sign * 0.3)
        text = "\n".join(comments)
        assert f"frame: {frame}" in text
        assert "45 of 50 rows" in text
        assert "the log's velocity" in text
        assert "timestamp_s x y z qx qy qz qw" in text

    def test_times_keep_their_nanoseconds(self, result: FusionResult, flight: Flight, tmp_path: Path) -> None:
        write_exports(result, flight, tmp_path, [Format.TUM])
        first = (tmp_path / "smoothed.tum").read_text().splitlines()[-45].split()[0]
        assert first == "1600000000.173456789"

    def test_x_is_the_way_along_the_corridor(
        self, result: FusionResult, flight: Flight, tmp_path: Path
    ) -> None:
        write_exports(result, flight, tmp_path, [Format.TUM])
        _, rows = read_tum(tmp_path / "estimates.tum")
        speed = np.cos(radians(10)) - 0.2 * np.sin(radians(10))
        np.testing.assert_allclose(rows[-1, 1] - rows[0, 1], speed * (rows[-1, 0] - rows[0, 0]), rtol=1e-6)

    def test_without_speed_or_width_it_says_so(
        self, result: FusionResult, flight: Flight, tmp_path: Path
    ) -> None:
        table = result.estimates.copy()
        table["lateral_offset_m"] = np.nan
        bare = Flight(flight.name, flight.camera, flight.frames)
        fused = FusionResult("two walls", result.config, table, table, result.frames, result.overview)
        write_exports(fused, bare, tmp_path, [Format.TUM])
        comments, rows = read_tum(tmp_path / "estimates.tum")
        assert np.all(rows[:, 1] == 0)
        np.testing.assert_allclose(rows[:, 2], 0.25)
        assert "the log has no forward speed" in "\n".join(comments)
        assert "over half the corridor's width" in "\n".join(comments)


def plain_types(schema: dict[str, Any]) -> None:
    """Check a schema by the rules of Foxglove's JSON reader: one plain type per field, or numbered words."""
    assert schema["type"] == "object"
    for field in schema["properties"].values():
        if "oneOf" in field:
            assert all(isinstance(option["const"], int) for option in field["oneOf"])
            continue
        assert field["type"] in ("boolean", "string", "number", "integer", "object", "array")
        inner = field["items"] if field["type"] == "array" else field
        assert inner["type"] in ("boolean", "string", "number", "integer", "object")
        if inner["type"] == "object":
            plain_types(inner)


def conforms(value: Any, schema: dict[str, Any]) -> None:
    """Check a message against its schema; fields may be absent, but none is unknown to it or null."""
    if "oneOf" in schema:
        assert value in [option["const"] for option in schema["oneOf"]]
        return
    kinds: dict[str, Any] = {
        "boolean": bool,
        "string": str,
        "number": (int, float),
        "integer": int,
        "object": dict,
        "array": list,
    }
    assert isinstance(value, kinds[schema["type"]]), (value, schema)
    assert isinstance(value, bool) is (schema["type"] == "boolean")
    if schema["type"] == "object":
        for name, part in value.items():
            conforms(part, schema["properties"][name])
    for part in value if schema["type"] == "array" else ():
        conforms(part, schema["items"])


@pytest.fixture(scope="module")
def read(result: FusionResult, flight: Flight, tmp_path_factory: Any) -> Any:
    pytest.importorskip("mcap")
    from mcap.reader import make_reader

    folder, done = tmp_path_factory.mktemp("mcap"), []
    write_exports(result, flight, folder, [Format.MCAP], Frame.ROS, lambda k, n: done.append((k, n)))
    assert done == [(k + 1, 5) for k in range(5)]
    messages, schemas, times = defaultdict(list), {}, []
    with (folder / "flight.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            messages[channel.topic].append((message.log_time, json.loads(message.data)))
            assert schema is not None
            schemas[channel.topic] = (
                schema.name,
                schema.encoding,
                channel.message_encoding,
                json.loads(schema.data),
            )
            times.append(message.log_time)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {record.name: record.data for record in reader.iter_attachments()}
    assert times == sorted(times)
    return messages, schemas, metadata, attachments


class TestMcap:
    def test_foxglove_knows_the_topics_by_their_schemas(self, read: Any) -> None:
        _, schemas, _, _ = read
        assert {topic: schema[0] for topic, schema in schemas.items()} == {
            "/camera/image": "foxglove.CompressedImage",
            "/camera/overlay": "foxglove.ImageAnnotations",
            "/corridor/frame": "corridor_fusion.Frame",
            "/corridor/estimate": "corridor_fusion.Estimate",
            "/corridor/smoothed": "corridor_fusion.Estimate",
            "/log": "foxglove.Log",
        }
        for _, encoding, message_encoding, schema in schemas.values():
            assert (encoding, message_encoding) == ("jsonschema", "json")
            plain_types(schema)

    def test_every_message_is_as_its_schema_says(self, read: Any) -> None:
        messages, schemas, _, _ = read
        for topic, found in messages.items():
            for t_ns, message in found:
                conforms(message, schemas[topic][3])
                if "timestamp" in message:
                    assert message["timestamp"]["sec"] * 10**9 + message["timestamp"]["nsec"] == t_ns

    def test_estimates_are_all_there_in_ros_signs(self, read: Any) -> None:
        messages, _, metadata, _ = read
        assert len(messages["/corridor/estimate"]) == len(messages["/corridor/smoothed"]) == N
        first, later = messages["/corridor/estimate"][0][1], messages["/corridor/estimate"][20][1]
        assert "heading_rad" not in first
        assert "position" not in first
        assert first["status"] == "initialising"
        assert later["heading_deg"] == pytest.approx(-10.0)
        assert later["lateral_offset_m"] == pytest.approx(-0.3)
        assert later["position"] == "right"
        assert metadata["corridor_fusion"]["frame"] == "ros"

    def test_pictures_decode_and_the_torn_one_is_left_out(self, read: Any) -> None:
        messages, _, _, _ = read
        assert [t for t, _ in messages["/camera/image"]] == [T0_NS + k * 100_000_000 for k in (0, 1, 3, 4)]
        message = messages["/camera/image"][0][1]
        data = np.frombuffer(base64.b64decode(message["data"]), np.uint8)
        picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        assert message["format"] == "jpeg"
        assert picture is not None
        assert np.abs(picture.astype(int) - Drawn().read(0)).mean() < 4
        assert len(messages["/corridor/frame"]) == 5

    def test_overlays_hold_lines_and_verdict(self, read: Any) -> None:
        messages, _, _, _ = read
        overlays = [message for _, message in messages["/camera/overlay"]]
        assert len(overlays) == 4
        assert overlays[1]["texts"][0]["text"] == "rejected: disagrees with the filter"
        ends = [point for a in overlays[0]["points"] for point in a["points"]]
        assert len(ends) > 8

    def test_events_tell_status_and_problems(self, read: Any) -> None:
        messages, _, _, attachments = read
        told = [(m["message"], m["level"]) for _, m in messages["/log"]]
        assert told == [
            ("problem: a torn row", fox.WARNING),
            ("status initialising", fox.INFO),
            ("status tracking", fox.INFO),
            ("status coasting", fox.WARNING),
        ]
        assert json.loads(attachments["summary.json"])["corridors"][0]["turn_rad"] == -0.5

    def test_times_before_zero_are_refused(
        self, result: FusionResult, flight: Flight, tmp_path: Path
    ) -> None:
        pytest.importorskip("mcap")
        table = result.estimates.copy()
        table["timestamp_ns"] -= 2 * T0_NS
        early = FusionResult("two walls", result.config, table, table, result.frames, result.overview)
        with pytest.raises(InputError, match="times begin at zero"):
            write_exports(early, flight, tmp_path, [Format.MCAP])


def test_annotations_use_the_corner_of_the_first_pixel() -> None:
    measurement = FrameMeasurement(
        True,
        Reason.OK,
        vp_px=(80.0, 60.0),
        vp_cov_px2=((4.0, 0.0), (0.0, 1.0)),
        lines_px=np.array([[10, 20, 30, 40], [1, 2, 3, 4]], np.float32),
        line_class=np.array([LineClass.CORRIDOR, LineClass.REJECTED], np.int8),
    )
    message = fox.overlay_message(T0_NS, measurement, 160)
    conforms(message, fox.IMAGE_ANNOTATIONS)
    by_kind = [(a["type"], a["points"]) for a in message["points"]]
    assert (fox.LINE_LIST, [{"x": 10.5, "y": 20.5}, {"x": 30.5, "y": 40.5}]) in by_kind
    ellipse = next(points for kind, points in by_kind if kind == fox.LINE_LOOP)
    assert max(p["x"] for p in ellipse) == pytest.approx(84.5)  # two sigma right of the point
    assert max(p["y"] for p in ellipse) == pytest.approx(62.5)


class TestChoice:
    def test_words_with_commas_and_repeats(self) -> None:
        pytest.importorskip("pyarrow")
        assert check_formats(["tum,parquet", "TUM"]) == (Format.TUM, Format.PARQUET)
        assert check_formats([]) == ()

    def test_an_unknown_word_names_the_known(self) -> None:
        with pytest.raises(
            InputError, match=r"--export csv: no such format \(known are parquet, tum, mcap, video\)"
        ):
            check_formats(["csv"])

    def test_a_missing_library_names_the_extra(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(exports, "find_spec", lambda name: None)
        with pytest.raises(InputError, match=r'library mcap.*pip install "corridor-fusion\[mcap\]"'):
            check_formats(["tum", "mcap"])

    def test_exports_lie_beside_the_tables_and_go_with_them(
        self, result: FusionResult, flight: Flight, tmp_path: Path
    ) -> None:
        out = tmp_path / "out"
        write_outputs(result, flight, out, report=False, exports=[Format.TUM], frame=Frame.ROS)
        tables = {"estimates.csv", "smoothed.csv", "frames.csv", "summary.json"}
        assert {path.name for path in out.iterdir()} == tables | set(EXPORT_FILES[Format.TUM])
        assert json.loads((out / "summary.json").read_text())["frame"] == "ros"
        assert read_table(out / "estimates.csv", ESTIMATE_DTYPE)["heading_rad"][20] == pytest.approx(
            -radians(10)
        )
        write_outputs(result, flight, out, report=False)
        assert {path.name for path in out.iterdir()} == tables
        assert json.loads((out / "summary.json").read_text())["frame"] == "frd"


class TestVideo:
    def test_every_picture_that_decodes_is_there_at_its_time(
        self, result: FusionResult, flight: Flight, tmp_path: Path
    ) -> None:
        av = pytest.importorskip("av")
        done: list[tuple[int, int]] = []
        write_exports(result, flight, tmp_path, [Format.VIDEO], progress=lambda k, n: done.append((k, n)))
        assert done == [(k + 1, 5) for k in range(5)]
        with av.open(str(tmp_path / "flight.mp4")) as video:
            found = [(frame.time, frame.to_ndarray(format="bgr24")) for frame in video.decode(video=0)]
        assert [time for time, _ in found] == pytest.approx([0.0, 0.1, 0.3, 0.4], abs=1e-3)
        heights = {picture.shape for _, picture in found}
        assert heights == {(480 + 112 + 30, 640, 3)}

    def test_the_strip_below_says_what_the_filter_says(self, result: FusionResult) -> None:
        pytest.importorskip("av")
        from fusion.outputs.video import _words

        table = result.estimates.copy()
        table["lateral_offset_std_m"] = 0.02
        assert _words(table[20]) == "10.0 deg right +- 0.6, 0.30 m right +- 0.02"
        assert _words(table[0]) == "no heading yet"
        table["lateral_offset_m"] = np.nan
        table["heading_rad"], table["lateral_offset_norm"], table["lateral_offset_norm_std"] = (
            -0.1,
            -0.25,
            0.1,
        )
        assert _words(table[20]) == "5.7 deg left +- 0.6, 0.25 half widths left +- 0.10"

    def test_a_flight_without_a_picture_is_refused(
        self, result: FusionResult, flight: Flight, tmp_path: Path
    ) -> None:
        pytest.importorskip("av")
        unreadable = replace(result, frames=result.frames[2:3])
        with pytest.raises(InputError, match="no picture of the flight can be read"):
            write_exports(unreadable, flight, tmp_path, [Format.VIDEO])
