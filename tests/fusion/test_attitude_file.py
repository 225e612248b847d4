"""Attitudes for single pictures: axes, matching and what is dropped."""

from __future__ import annotations

from math import cos, radians, sin
from pathlib import Path

import pytest

from fusion.pictures.attitude_file import AttitudeFile
from vision import InputError


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Rolled 10 degrees about x at one time, turned 20 degrees about y a second later; no body.yaml."""
    path = tmp_path / "mav0" / "attitude0" / "data.csv"
    path.parent.mkdir(parents=True)
    a, b = radians(10) / 2, radians(20) / 2
    path.write_text(
        "#timestamp [ns],qw,qx,qy,qz\n"
        f"1000000000,{cos(a)},{sin(a)},0,0\n"
        "1500000000,0,0,0,0\n"
        f"2000000000,{cos(b)},0,{sin(b)},0\n"
    )
    return path


@pytest.mark.parametrize(("body", "pitch_deg"), [(None, -20), ("flu", -20), ("frd", 20)])
def test_axes_are_those_of_the_log(table: Path, body: str | None, pitch_deg: float) -> None:
    # A positive turn about y takes x towards -z: nose down where z points up, nose up where z points down.
    if body is not None:
        (table.parent.parent / "body.yaml").write_text(f"body_frame: {body}\n")
    attitudes = AttitudeFile.read(table)
    rolled = attitudes.of(Path("a.png"), 1_000_000_000)
    turned = attitudes.of(Path("b.png"), 2_000_000_000)
    assert rolled is not None
    assert turned is not None
    assert (rolled.roll_rad, rolled.pitch_rad) == pytest.approx((radians(10), 0.0))
    assert (turned.roll_rad, turned.pitch_rad) == pytest.approx((0.0, radians(pitch_deg)))


@pytest.mark.parametrize(
    ("t_ns", "found"),
    [
        (1_099_999_999, True),
        (1_100_000_001, False),
        (900_000_000, True),
        (899_999_999, False),
        (2_050_000_000, True),
        (5_000_000_000, False),
        (1_500_000_000, False),  # the row there is a zero quaternion
        (None, False),
    ],
)
def test_the_nearest_row_counts_up_to_a_tenth_of_a_second(table: Path, t_ns: int | None, found: bool) -> None:
    attitudes = AttitudeFile.read(table)
    assert (attitudes.of(Path("a.png"), t_ns) is not None) == found
    assert any("1500000000" in problem for problem in attitudes.problems)


def test_names_match_without_their_folder(tmp_path: Path) -> None:
    path = tmp_path / "tilt.csv"
    path.write_text("image,roll_rad,pitch_rad\nsome/where/a.jpg,0.1,-0.2\n\nb.jpg, 0 ,0\n")
    attitudes = AttitudeFile.read(path)
    found = attitudes.of(Path("else/a.jpg"), None)
    assert found is not None
    assert (found.roll_rad, found.pitch_rad) == (0.1, -0.2)
    assert attitudes.of(Path("c.jpg"), 7) is None


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: cannot be read: No such file"):
        AttitudeFile.read(tmp_path / "none.csv")
