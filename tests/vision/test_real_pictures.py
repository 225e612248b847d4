"""Real corridor pictures with known answers, where they lie beside the repository: what a person sees is measured."""

from __future__ import annotations

import csv
from math import degrees, radians

import pytest

from tests.files import SHARED
from tests.pictures import read_grey
from vision import Attitude, Camera, FrameMeasurement, measure_frame

PICTURES = SHARED / "cases" / "pictures"
HANDHELD_FOV_RAD = radians(46.0)

pytestmark = pytest.mark.skipif(not PICTURES.is_dir(), reason="the pictures are not part of the repository")


def calibrated(name: str) -> FrameMeasurement:
    """Measure a picture of the calibrated camera with the roll and pitch that belong to it."""
    with (PICTURES / "tilt.csv").open(encoding="utf-8") as file:
        tilt = {row["image"]: row for row in csv.DictReader(file)}[name]
    attitude = Attitude(float(tilt["roll_rad"]), float(tilt["pitch_rad"]))
    return measure_frame(read_grey(PICTURES / name), Camera.from_yaml(PICTURES / "indoor.yaml"), attitude)


def handheld(name: str) -> FrameMeasurement:
    image = read_grey(PICTURES / name)
    return measure_frame(image, Camera.from_fov(image.shape[1], image.shape[0], HANDHELD_FOV_RAD))


@pytest.mark.parametrize(
    ("name", "heading_deg", "offset_norm", "within"),
    [
        ("corridor_0120.jpg", -1.88, 0.007, 0.05),
        ("corridor_0135.jpg", -1.53, 0.004, 0.05),
        ("corridor_0148.jpg", None, -0.011, 0.05),
        ("corridor_0224.jpg", None, -0.019, 0.12),  # a bench hides the right corner
    ],
)
def test_depth_camera_agrees(name: str, heading_deg: float | None, offset_norm: float, within: float) -> None:
    found = calibrated(name)
    assert found.accepted
    if heading_deg is not None:
        assert degrees(found.heading_rad) == pytest.approx(heading_deg, abs=0.2)
        assert degrees(found.heading_std_rad) < 0.2
    error = abs(found.lateral_offset_norm - offset_norm)
    assert error < within
    assert error < 1.5 * found.lateral_offset_norm_std


@pytest.mark.parametrize(("name", "offset_norm"), [("handheld_33.jpg", -0.03), ("handheld_73.jpg", -0.06)])
def test_skirting_boards_read_by_hand_agree(name: str, offset_norm: float) -> None:
    found = handheld(name)
    assert found.accepted
    assert found.lateral_offset_norm == pytest.approx(offset_norm, abs=0.10)  # read to +- 0.05
    assert found.lateral_offset_norm_std < 0.1
