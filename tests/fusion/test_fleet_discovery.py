"""Which flights are found: below folders, by patterns, in lists; their names, vehicles and dates."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from fusion.fleet.discovery import FoundFlight, date_in, find_flights
from fusion.fleet.fingerprint import (
    content_of,
    flight_files,
    hashes_of,
    program_version,
    settings_hash,
    stamp_of,
)
from tests.files import written
from vision import InputError

PICTURE = b"\x89PNG\r\n\x1a\n"
ULOG = b"ULog\x01\x12\x35\x01" + bytes(8)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Flights of several kinds, and what is none: outputs, settings, tables, hidden folders, stray pictures."""
    root = tmp_path / "logs"
    (root / "mav1" / "2026-03-01_hall" / "mav0" / "cam0").mkdir(parents=True)
    written(root / "mav1" / "20260302" / "flight.toml", 'log = "x.ulg"\nvehicle = "falcon"\n')
    written(root / "mav1" / "20260302" / "x.ulg", "")
    written(root / "flat" / "one.toml", 'log = "one.ulg"\n[camera]\nfile = "one.mp4"\n')
    for name in ("one.ulg", "two.ulg"):
        (root / "flat" / name).write_bytes(ULOG)
    (root / "flat" / "one.mp4").write_bytes(b"\0\0\0\x18ftypmp42")
    written(root / "flat" / "imu.csv", "t,gx,gy,gz\n")
    written(root / "hall.toml", "corridor_width_m = 2.2\n")
    (root / "stray.png").write_bytes(PICTURE)
    (root / "pictures").mkdir()
    (root / "pictures" / "0001.png").write_bytes(PICTURE)
    for output in (root / "hall_fused", root / "fleet" / "flights" / "hall"):
        written(output / "summary.json", "{}")
        written(output / "estimates.csv", "")
        written(output / "flight.toml", 'log = "../mav1"\n')
    written(root / "fleet" / "fleet.jsonl", "")
    (root / ".trash" / "mav0").mkdir(parents=True)
    return root


def names(*sources: str | Path) -> list[str]:
    return [flight.name for flight in find_flights(sources)]


def test_a_folder_is_searched(tree: Path) -> None:
    (tree / "mav1" / "round").symlink_to(tree)
    assert names(tree) == ["flat/one", "flat/two.ulg", "mav1/2026-03-01_hall", "mav1/20260302", "pictures"]
    found = {flight.name: flight for flight in find_flights([tree])}
    hall = tree.resolve() / "mav1" / "2026-03-01_hall"
    assert found["mav1/2026-03-01_hall"] == FoundFlight("mav1/2026-03-01_hall", hall, "mav1", "2026-03-01")
    assert (found["mav1/20260302"].vehicle, found["mav1/20260302"].date) == ("falcon", "2026-03-02")


def test_a_flight_a_pattern_and_a_folder_name_it_once(tree: Path) -> None:
    hall = tree / "mav1" / "2026-03-01_hall"
    assert names(hall) == ["2026-03-01_hall"]
    assert names(hall, tree / "mav1", str(tree / "mav1" / "*hall")) == ["2026-03-01_hall", "20260302"]
    assert names(str(tree / "**" / "*.ulg")) == ["one.ulg", "two.ulg", "x.ulg"]
    assert names(str(tree / "*.bag")) == []


def test_a_vehicle_called_mav0_is_no_flight(tmp_path: Path) -> None:
    (tmp_path / "mav0" / "hall" / "mav0" / "cam0").mkdir(parents=True)
    (tmp_path / "mav1" / "without_camera" / "mav0" / "imu0").mkdir(parents=True)
    assert names(tmp_path) == ["mav0/hall", "mav1/without_camera"]


def test_names_that_are_alike_get_what_tells_them_apart(tmp_path: Path) -> None:
    for day in ("monday", "tuesday"):
        (tmp_path / day / "hall" / "mav0" / "cam0").mkdir(parents=True)
    assert names(tmp_path / "monday", tmp_path / "tuesday" / "hall") == ["monday/hall", "tuesday/hall"]


def test_a_list_says_what_the_paths_do_not(tree: Path) -> None:
    written(tree / "mav1.toml", "")
    text = (
        '[[flight]]\npath = "mav1/2026-03-01_hall"\nname = "there"\nvehicle = "owl"\nconfig = "mav1.toml"\n'
        'date = "2026-01-31"\n[[flight]]\npath = "mav1/2026*2"\n[[flight]]\npath = "gone"\n'
    )
    there, *others = find_flights([written(tree / "list.toml", text)])[::-1]
    path = tree.resolve() / "mav1" / "2026-03-01_hall"
    assert there == FoundFlight("there", path, "owl", "2026-01-31", tree.resolve() / "mav1.toml")
    assert [flight.name for flight in others] == ["gone", "20260302"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[flight]]\npath = "mav1"\nname = "all"\n', "name = 'all' names 2 flights"),
        ('[[flight]]\npath = "mav1"\nname = "../up"\n', "names a place elsewhere"),
        ('[[flight]]\npath = "mav1"\ndate = "March"\n', "date"),
        ('[[flight]]\nvehicle = "owl"\n', "path"),
        ('[[flight]]\npath = "mav1"\nvehicel = "owl"\n', "vehicel"),
        ("flight = []\n", "flight"),
    ],
)
def test_a_list_that_cannot_be_used_is_refused(tree: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        find_flights([written(tree / "list.toml", text)])
    assert caught.value.file == tree / "list.toml"


@pytest.mark.parametrize(
    ("path", "day"),
    [
        ("logs/2026-03-01/12_33_44.ulg", "2026-03-01"),
        ("2025/20260301T1200.bag", "2026-03-01"),
        ("2026_03_01-hall", "2026-03-01"),
        ("flight-2026-13-45", ""),
        ("take1234567890", ""),
        ("2026-03-01/again_2026-03-02", "2026-03-02"),
    ],
)
def test_dates_in_paths(path: str, day: str) -> None:
    assert date_in(Path(path)) == day


def test_what_a_flight_consists_of(tree: Path) -> None:
    flat = tree / "flat"
    assert [file.name for file in flight_files(flat / "one.toml")] == ["one.mp4", "one.toml", "one.ulg"]
    assert flight_files(flat / "two.ulg") == [flat / "two.ulg"]
    assert flight_files(tree / "gone") == []


def log_hash(path: Path) -> str:
    return content_of(path, hashes_of(path))


def test_hashes_follow_names_and_content_wherever_the_flight_lies(tmp_path: Path) -> None:
    one = written(tmp_path / "one" / "imu.csv", "1,2,3\n").parent
    two = tmp_path / "deep" / "two"
    shutil.copytree(one, two)
    assert log_hash(one) == log_hash(two)
    os.mkfifo(two / "pipe")
    assert log_hash(one) == log_hash(two)
    stamp, size = stamp_of(one)
    assert size == 6
    written(one / "imu.csv", "1,2,4\n")
    assert log_hash(one) != log_hash(two)
    assert stamp_of(one)[0] != stamp
    (two / "imu.csv").rename(two / "gyro.csv")
    written(one / "imu.csv", "1,2,3\n")
    assert log_hash(one) != log_hash(two)


def test_settings_and_version_have_hashes(tmp_path: Path) -> None:
    camera = written(tmp_path / "cam.yaml", "a")
    hashes = {settings_hash({"a": 1.0}), settings_hash({"a": 2.0}), settings_hash({"a": 1.0}, camera)}
    written(camera, "b")
    assert len(hashes | {settings_hash({"a": 1.0}, camera)}) == 4
    assert settings_hash({"a": 1, "b": None}) == settings_hash({"b": None, "a": 1})
    assert program_version().partition("+")[0] == "0.1.0"
