"""Logs as people have them: each is right as it is, or is refused in one line whose remedy leads there."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from math import degrees
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion import fuse_flight, write_outputs
from fusion.flight import Flight
from fusion.inspection.advice import Matter
from fusion.inspection.log import Inspection
from fusion.inspection.sources import inspect_path
from fusion.logs import load_flight
from fusion.logs.contents import Kind
from tests.command import Corridor, refused
from tests.files import OFFICE, written
from tests.fusion.log_cases import FLU, SENSOR_YAML, Part, judge, lead
from tests.fusion.log_cases_bags import CASES as BAGS
from tests.fusion.log_cases_files import AUTOPILOTS, DATASETS, TABLES, VIDEOS
from vision import InputError

for module in ("rosbags", "pymavlink", "av"):
    pytest.importorskip(module)

CASES = BAGS | TABLES | AUTOPILOTS | DATASETS | VIDEOS


@pytest.fixture(scope="module")
def parts(office: Flight) -> dict[bool, Part]:
    """The part of the flight, with few frames and with all of them."""
    return {False: Part.of(office, 2), True: Part.of(office, 1)}


def fusable(found: Inspection) -> bool:
    return not [sentence for sentence in found.advice if sentence.matter is Matter.MISSING]


def fused_kinds(found: Inspection) -> set[Kind]:
    """Kinds of the streams that an inspection says are fused, an accelerometer apart."""
    (sentence,) = (sentence.text for sentence in found.advice if sentence.matter is Matter.FUSE)
    words = {Kind.IMU: "gyroscope", Kind.FRAMES: "pictures", Kind.RANGE: "distance"}
    return {kind for kind in Kind if words.get(kind, kind.value) in sentence}


def kinds_of(flight: Flight) -> set[Kind]:
    """Kinds of the streams that a flight has."""
    streams = {
        Kind.FRAMES: flight.frames,
        Kind.IMU: flight.imu,
        Kind.ATTITUDE: flight.attitude,
        Kind.POSITION: flight.position,
        Kind.VELOCITY: flight.velocity,
        Kind.RANGE: flight.range,
    }
    return {kind for kind, stream in streams.items() if stream is not None}


@pytest.mark.parametrize("name", CASES)
def test_a_log_is_right_or_its_remedy_leads_there(name: str, parts: dict[bool, Part], tmp_path: Path) -> None:
    case = CASES[name]
    part = parts[case.dense]
    log = case.build(part, tmp_path)
    found = inspect_path(log)
    assert fusable(found) == (case.refused is None)
    if not case.followed:
        with pytest.raises(InputError, match=case.refused):
            load_flight(log)
        return
    outcome = lead(log, tmp_path, case)
    if not outcome.told:
        assert fused_kinds(found) == kinds_of(outcome.flight)
    for words in (case.refused, case.caused):
        assert words is None or any(words in told for told in outcome.told), outcome.told
    assert bool(outcome.told) == bool(case.refused or case.caused), outcome.told
    judge(part, outcome, case)


SETTINGS = (
    "use = false",
    'topic = "/imu"',
    'topic = "nowhere"',
    'file = "imu.csv"',
    'frame = "flu"',
    "clock_offset_s = 1000.0",
    "clock_rate = 1.01",
    "mount_rad = [3.1416, 0.0, 0.0]",
    'columns = { gyro_unit = "deg/s" }',
    "rescale_calibration = true",
    'calibration = "camera.yaml"',
    "mount_yaw_rad = 0.1",
)
STREAMS = ("camera", "imu", "attitude", "velocity", "position", "range")


@pytest.fixture(scope="module")
def mixed(parts: dict[bool, Part], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a bag, a table, a calibration and a flight folder."""
    folder = tmp_path_factory.mktemp("mixed")
    BAGS["two IMUs"].build(parts[False], folder)
    TABLES["plain"].build(parts[False], folder)
    written(folder / "camera.yaml", SENSOR_YAML.read_text())
    return folder


@given(
    log=st.sampled_from(["drive.bag", "imu.csv", "pictures", OFFICE.as_posix()]),
    told=st.dictionaries(
        st.sampled_from(STREAMS), st.lists(st.sampled_from(SETTINGS), max_size=2, unique=True), max_size=3
    ),
)
@settings(max_examples=40)
def test_inspect_and_fuse_agree(mixed: Path, log: str, told: dict[str, list[str]]) -> None:
    """Whatever a manifest says: both refuse it, or both take the same streams."""
    tables = "".join(
        f"[{stream}]\n" + "".join(f"{line}\n" for line in lines) for stream, lines in told.items()
    )
    path = written(mixed / "flight.toml", f'log = "{log}"\n{tables}')
    try:
        flight = load_flight(path)
    except InputError:
        flight = None
    try:
        found = inspect_path(path)
    except InputError:
        assert flight is None
        return
    assert fusable(found) == (flight is not None)
    if flight is not None:
        assert fused_kinds(found) == kinds_of(flight)


@pytest.mark.parametrize(
    "name", ["degrees per second", "pictures of half the size", "two IMUs", "times of day", "ULog", "KITTI"]
)
def test_a_refusal_is_one_line_and_leaves_nothing(
    name: str, parts: dict[bool, Part], tmp_path: Path, corridor: Corridor
) -> None:
    case = CASES[name]
    log = case.build(parts[False], tmp_path)
    assert case.refused is not None
    refused(corridor("fuse", log), case.refused)


@pytest.mark.parametrize("ending", ["ulg", "bag", "mp4", "tlog", "bin", "mcap", "csv", "db3"])
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 4712345\n", "git lfs pull"),
        ("", "is empty"),
    ],
    ids=["Git LFS", "empty"],
)
def test_a_placeholder_is_named(ending: str, text: str, said: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"log.{ending}", text)
    for read in (inspect_path, load_flight):
        with pytest.raises(InputError) as caught:
            read(path)
        assert said in str(caught.value)


GROUNDTRUTH = OFFICE / "mav0" / "state_groundtruth_estimate0" / "data.csv"


@pytest.mark.parametrize("told", ["", '[velocity]\nframe = "flu"\n', '[velocity]\nframe = "enu"\n'])
def test_a_velocity_of_the_world_is_turned_into_the_body(told: str, tmp_path: Path) -> None:
    """EuRoC's ground truth gives it so; read as the body's, the speed ahead would point elsewhere."""
    table = told or "[velocity]\n"
    text = f'log = "{OFFICE.as_posix()}"\n{table}file = "{GROUNDTRUTH.as_posix()}"\n'
    velocity = load_flight(written(tmp_path / "flight.toml", text)).velocity
    assert velocity is not None
    values = np.genfromtxt(GROUNDTRUTH, delimiter=",", skip_header=1)
    R_world_body = Rotation.from_quat(values[:, [5, 6, 7, 4]])
    true = R_world_body.inv().apply(values[:, 8:11]) * FLU
    np.testing.assert_allclose(velocity.xyz, true, atol=0.01)


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory, office: Flight) -> Path:
    """The sample flight fused."""
    flight = replace(office, truth=None)
    return write_outputs(fuse_flight(flight), flight, tmp_path_factory.mktemp("truth") / "out", report=False)


class TestTruth:
    """Trajectories as truth: the answer is that of the flight's own, once the axes are told."""

    @staticmethod
    def trajectory(path: Path, order: Sequence[int], signs: Sequence[float]) -> Path:
        values = np.genfromtxt(GROUNDTRUTH, delimiter=",", skip_header=1)
        stamps = [line.split(",")[0] for line in GROUNDTRUTH.read_text().splitlines()[1:]]
        q = (values[:, 4:8] * signs)[:, list(order)]
        rows = (
            f"{int(t) // 10**9}.{int(t) % 10**9:09d} 0 0 0 " + " ".join(f"{v:.9f}" for v in row)
            for t, row in zip(stamps, q, strict=True)
        )
        return written(path, "# timestamp tx ty tz qx qy qz qw\n" + "\n".join(rows) + "\n")

    @pytest.mark.parametrize(
        ("order", "signs", "frame"),
        [((1, 2, 3, 0), (1, 1, 1, 1), "ros"), ((1, 2, 3, 0), (1, 1, -1, -1), "frd")],
    )
    def test_a_trajectory_is_asked_for_its_axes(
        self,
        output: Path,
        corridor: Corridor,
        tmp_path: Path,
        order: Sequence[int],
        signs: Sequence[float],
        frame: str,
    ) -> None:
        path = self.trajectory(tmp_path / "truth.tum", order, signs)
        asked = corridor("evaluate", output, "--truth", path)
        assert asked.code == 2
        assert f"--truth-frame {frame}" in asked.err.replace("or frd", "or --truth-frame frd")
        told = corridor("evaluate", output, "--truth", path, "--truth-frame", frame, "--json")
        assert told.code == 0, told.err
        (output_found,) = json.loads(told.out)["outputs"]
        assert degrees(output_found["causal"]["heading"]["rmse_rad"]) < 0.3

    def test_quaternions_in_the_wrong_order_are_named(
        self, output: Path, corridor: Corridor, tmp_path: Path
    ) -> None:
        path = self.trajectory(tmp_path / "truth.tum", (0, 1, 2, 3), (1, 1, 1, 1))
        found = corridor("evaluate", output, "--truth", path, "--truth-frame", "ros")
        assert found.code == 2
        assert found.err.count("\n") == 1
        assert "order" in found.err
