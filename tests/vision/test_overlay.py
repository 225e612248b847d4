from __future__ import annotations

from collections.abc import Sequence
from math import nan, radians
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from vision.cameras.camera import Camera
from vision.errors import InputError
from vision.measurement import FrameMeasurement, LineClass, Position, Reason
from vision.overlay import CLASS_COLOUR, NO, VANISHING_POINT, WALL, YES, draw_overlay, overlay_scale
from vision.types import FloatArray

CAMERA = Camera.from_fov(640, 480, radians(70))
GREY = np.full((480, 640), 90, dtype=np.uint8)


def measured(**changes: Any) -> FrameMeasurement:
    values: dict[str, Any] = {
        "accepted": True,
        "reason": Reason.OK,
        "n_lines": 5,
        "n_inliers": 4,
        "vp_px": (200.0, 150.0),
        "vp_cov_px2": ((25.0, 0.0), (0.0, 4.0)),
        "heading_rad": radians(10.0),
        "heading_std_rad": radians(0.2),
        "lateral_offset_norm": 0.5,
        "lateral_offset_norm_std": 0.02,
        "position": Position.RIGHT,
    }
    return FrameMeasurement(**(values | changes))


def where(picture: npt.NDArray[np.uint8], colour: Sequence[int], tolerance: int = 12) -> npt.NDArray[np.intp]:
    """Rows and columns of the pixels painted in a colour."""
    near = np.abs(picture.astype(int) - np.array(colour)).max(axis=2) <= tolerance
    return np.argwhere(near)


def test_the_vanishing_point_is_painted_at_its_pixel_and_its_ellipse_at_two_sigma() -> None:
    picture = draw_overlay(GREY, CAMERA, measured(vp_cov_px2=((900.0, 0.0), (0.0, 400.0))))[:480]
    white = where(picture, VANISHING_POINT, 25)
    assert white.mean(axis=0) == pytest.approx([150.0, 200.0], abs=1.0)
    assert np.abs(white[:, 1] - 200).max() == pytest.approx(60.0, abs=1.5)
    assert np.abs(white[:, 0] - 150).max() == pytest.approx(40.0, abs=1.5)
    assert np.array_equal(picture[150, 200], VANISHING_POINT)


def test_a_tilted_covariance_tilts_the_ellipse() -> None:
    falling = ((500.0, 450.0), (450.0, 500.0))  # x and y (down) grow together: from top left to bottom right
    white = where(draw_overlay(GREY, CAMERA, measured(vp_cov_px2=falling))[:480], VANISHING_POINT, 25)
    far = white[np.abs(white - [150, 200]).sum(axis=1) > 50] - [150, 200]
    assert len(far) > 10
    assert np.all(far[:, 0] * far[:, 1] > 0)


@pytest.mark.parametrize(
    ("vp_px", "heading_rad", "side"),
    [
        ((-300.0, 240.0), 0.9, "left"),
        ((1000.0, 240.0), -0.9, "right"),
        ((320.0, -900.0), 0.0, "top"),
        ((nan, nan), 1.2, "left"),
        ((nan, nan), -1.2, "right"),
    ],
)
def test_a_vanishing_point_outside_is_an_arrow_at_that_border(
    vp_px: tuple[float, float], heading_rad: float, side: str
) -> None:
    picture = draw_overlay(GREY, CAMERA, measured(vp_px=vp_px, heading_rad=heading_rad))[:480]
    white = where(picture, VANISHING_POINT, 25)
    rows, columns = white.min(axis=0), white.max(axis=0)
    reach = {"left": rows[1], "right": 639 - columns[1], "top": rows[0]}
    assert reach[side] <= 6
    assert min(reach, key=reach.__getitem__) == side


def test_nothing_is_invented_for_an_unknown_vanishing_point() -> None:
    blind = measured(accepted=False, reason=Reason.TOO_FEW_LINES, vp_px=(nan, nan), heading_rad=nan)
    assert len(where(draw_overlay(GREY, CAMERA, blind)[:480], VANISHING_POINT, 25)) == 0


@pytest.mark.parametrize("kind", list(LineClass))
def test_lines_are_painted_in_the_colour_of_their_class(kind: LineClass) -> None:
    line = np.array([[100.0, 300.0, 500.0, 300.0]], dtype=np.float32)
    picture = draw_overlay(
        GREY, CAMERA, measured(lines_px=line, line_class=np.array([kind], dtype=np.int8)), footer=False
    )
    painted = where(picture[280:320], CLASS_COLOUR[kind])  # clear of the vanishing point's marks
    assert set(painted[:, 0]) <= {19, 20, 21}
    assert painted[:, 1].min() == pytest.approx(100, abs=2)
    assert painted[:, 1].max() == pytest.approx(500, abs=2)


def test_the_classes_have_colours_that_differ_without_hue() -> None:
    """A reader who sees no hue can still tell the walls and the corridor's lines from the rejected ones."""
    luma = {kind: np.dot(colour, (0.114, 0.587, 0.299)) for kind, colour in CLASS_COLOUR.items()}
    wall = np.dot(WALL, (0.114, 0.587, 0.299))
    assert wall - max(luma.values()) > 25
    assert len({round(value) for value in luma.values()}) == len(luma)


def test_wall_lines_lie_over_everything_and_are_the_thickest() -> None:
    across = np.array([[300.0, 250.0, 300.0, 350.0]], dtype=np.float32)
    wall = np.array([[100.0, 300.0, 500.0, 300.0]], dtype=np.float32)
    picture = draw_overlay(
        GREY,
        CAMERA,
        measured(
            lines_px=across, line_class=np.array([LineClass.VERTICAL], dtype=np.int8), wall_lines_px=wall
        ),
    )
    assert np.array_equal(picture[300, 300], WALL)
    assert np.count_nonzero(np.all(picture[:480, 200] == WALL, axis=1)) >= 3


@pytest.mark.parametrize(
    ("width", "height", "scale"), [(80, 60, 8), (256, 256, 2), (640, 480, 1), (1280, 960, 1)]
)
def test_small_pictures_are_enlarged_and_marks_keep_their_place(width: int, height: int, scale: int) -> None:
    assert overlay_scale(width) == scale
    grey = np.full((height, width), 90, dtype=np.uint8)
    camera = Camera.from_fov(width, height, radians(70))
    vp = (0.25 * width, 0.25 * height)
    picture = draw_overlay(grey, camera, measured(vp_px=vp, vp_cov_px2=((nan, nan), (nan, nan))))
    assert picture.shape[1] == width * scale
    assert picture.shape[0] > height * scale
    white = where(picture[: height * scale], VANISHING_POINT, 25)
    expected = [(vp[1] + 0.5) * scale - 0.5, (vp[0] + 0.5) * scale - 0.5]
    assert white.mean(axis=0) == pytest.approx(expected, abs=1.0)


def test_a_picture_of_another_size_than_the_camera_is_drawn_to_scale() -> None:
    half = np.full((960, 1280), 90, dtype=np.uint8)
    white = where(
        draw_overlay(half, CAMERA, measured(vp_cov_px2=((nan, nan), (nan, nan))))[:960], VANISHING_POINT, 25
    )
    assert white.mean(axis=0) == pytest.approx([300.5, 400.5], abs=1.0)


def triangle(heading_rad: float, offset_norm: float) -> tuple[FloatArray, FloatArray]:
    """Centre of the filled vehicle in the footer, and that of its front half (rows down, columns right)."""
    seen = measured(heading_rad=heading_rad, lateral_offset_norm=offset_norm)
    corner = draw_overlay(GREY, CAMERA, seen)[480:, :112]
    body = where(corner, (238, 238, 238), 4)
    front = body[np.argsort(body[:, 0])[: len(body) // 6]]  # the narrow tip, ahead is up
    return body.mean(axis=0), front.mean(axis=0)


def test_the_corridor_from_above_turns_and_shifts_the_vehicle_as_signed() -> None:
    right_body, _ = triangle(0.0, 0.6)
    left_body, _ = triangle(0.0, -0.6)
    middle_body, ahead = triangle(0.0, 0.0)
    assert left_body[1] < middle_body[1] - 10
    assert right_body[1] > middle_body[1] + 10
    assert ahead[1] == pytest.approx(middle_body[1], abs=1.0)
    body, nose = triangle(radians(25.0), 0.0)
    assert nose[1] > body[1] + 3
    body, nose = triangle(radians(-25.0), 0.0)
    assert nose[1] < body[1] - 3


def test_the_verdict_is_coloured_and_differs_by_reason() -> None:
    used = draw_overlay(GREY, CAMERA, measured())[480:, 112:]
    gate = draw_overlay(GREY, CAMERA, measured(accepted=False, reason=Reason.GATE))[480:, 112:]
    blur = draw_overlay(GREY, CAMERA, measured(accepted=False, reason=Reason.BLUR))[480:, 112:]
    assert len(where(used, YES, 40)) > 50
    assert len(where(used, NO, 40)) == 0
    assert len(where(gate, NO, 40)) > 50
    assert not np.array_equal(gate, blur)


def test_colour_depths_and_channels_all_become_bgr_and_the_input_is_untouched() -> None:
    colour = np.dstack([GREY, GREY // 2, GREY // 3])
    before = colour.copy()
    picture = draw_overlay(colour, CAMERA, measured(), footer=False)
    assert np.array_equal(colour, before)
    assert np.array_equal(picture[10, 10], colour[10, 10])
    with_alpha = np.dstack([colour, GREY])
    assert np.array_equal(draw_overlay(with_alpha, CAMERA, measured(), footer=False), picture)
    ten_bits = (GREY.astype(np.uint16)) * 4
    ten_bits[0, 0] = 1023
    assert draw_overlay(ten_bits, CAMERA, measured(), footer=False)[10, 10] == pytest.approx([89] * 3, abs=1)


@pytest.mark.parametrize(
    "image", [np.zeros((0, 4), np.uint8), np.zeros((4, 4)), np.zeros((4, 4, 2), np.uint8)]
)
def test_what_is_not_a_picture_is_refused(image: npt.NDArray[Any]) -> None:
    with pytest.raises(InputError, match=r"picture"):
        draw_overlay(image, CAMERA, measured())


def test_far_and_degenerate_geometry_does_not_overflow() -> None:
    wild = measured(
        vp_px=(3e9, -2e9),
        vp_cov_px2=((1e18, 0.0), (0.0, 1e-9)),
        lines_px=np.array([[nan, 0, 1, 1], [-1e7, 10, 1e7, 10]], dtype=np.float32),
        line_class=np.array([1, 1], dtype=np.int8),
    )
    picture = draw_overlay(GREY, CAMERA, wild, footer=False)
    white = where(picture, VANISHING_POINT, 25)
    assert white[:, 1].max() >= 600  # the arrow, at the right
