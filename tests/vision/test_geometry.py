"""Axis, level and lateral offset from exact lines: signs, invariances, what uncertainty does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import degrees, isnan, pi, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.vision.corridor_lines import lines_between
from vision import Attitude, Camera, InputError, Position, Prior, Reason, measure_lines
from vision.axis.level import level_from_verticals
from vision.axis.vanishing_point import axis_direction, fit_axis
from vision.lines.line_set import LineSet
from vision.rotations import rotation_from_angles, wrap_axis

CAMERA = Camera(640, 480, 466.0, 466.0, 319.5, 239.5)
PER_LINE = [
    "ends_px",
    "length_px",
    "rms_px",
    "n_pixels",
    "contrast",
    "centre",
    "direction",
    "normal",
    "sigma_rad",
    "arc_rad",
]
QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
angle = st.floats(radians(-25), radians(25))
tilt = st.floats(radians(-12), radians(12))


@QUICK
@given(heading=angle, offset=st.floats(-0.7, 0.7), roll=tilt, pitch=tilt)
def test_exact_lines_give_the_exact_answer(
    corridor: Any, seen: Any, heading: float, offset: float, roll: float, pitch: float
) -> None:
    truth = corridor(heading_rad=heading, offset_norm=offset, roll_rad=roll, pitch_rad=pitch)
    m = measure_lines(seen(truth, CAMERA), CAMERA, Attitude(roll, pitch))
    assert m.reason is Reason.OK
    assert degrees(m.heading_rad) == pytest.approx(degrees(heading), abs=0.01)
    assert degrees(m.elevation_rad) == pytest.approx(0.0, abs=0.01)
    if np.isfinite(m.lateral_offset_norm):
        assert m.lateral_offset_norm == pytest.approx(offset, abs=0.01)
        assert m.width_per_height == pytest.approx(2.2 / 1.4, rel=0.02)


def test_the_offset_is_found_when_both_walls_are_in_view(corridor: Any, seen: Any) -> None:
    found = [
        measure_lines(seen(corridor(offset_norm=o, heading_rad=h), CAMERA), CAMERA, Attitude(0, 0))
        for o in np.linspace(-0.6, 0.6, 7)
        for h in (-0.15, 0.0, 0.15)
    ]
    assert sum(np.isfinite(m.lateral_offset_norm) for m in found) >= 19
    assert found[0].position is Position.LEFT
    assert found[10].position is Position.CENTRE
    assert found[-1].position is Position.RIGHT


def test_turned_right_the_vanishing_point_is_left(corridor: Any, seen: Any) -> None:
    m = measure_lines(seen(corridor(heading_rad=radians(10)), CAMERA), CAMERA, Attitude(0, 0))
    assert m.heading_rad > 0
    assert m.vp_px[0] == pytest.approx(319.5 - 466 * np.tan(radians(10)), abs=0.2)
    assert m.vp_px[1] == pytest.approx(239.5, abs=0.2)


@QUICK
@given(heading=angle, offset=st.floats(-0.6, 0.6), seed=st.integers(0, 1000))
def test_a_mirrored_world_gives_the_mirrored_answer(
    corridor: Any, seen: Any, heading: float, offset: float, seed: int
) -> None:
    truth = corridor(heading_rad=heading, offset_norm=offset, noise_px=0.1, n_random=10, seed=seed)
    lines = seen(truth, CAMERA)
    flip = np.array([-1.0, 1.0, 1.0])
    mirrored = replace(
        lines,
        ends_px=np.column_stack(
            [639 - lines.ends_px[:, 2], lines.ends_px[:, 3], 639 - lines.ends_px[:, 0], lines.ends_px[:, 1]]
        ),
        centre=lines.centre * flip,
        direction=-lines.direction * flip,
        normal=lines.normal * flip,
    )
    here = measure_lines(lines, CAMERA, Attitude(0, 0))
    there = measure_lines(mirrored, CAMERA, Attitude(0, 0))
    assert there.heading_rad == pytest.approx(-here.heading_rad, abs=1e-6)
    assert there.heading_std_rad == pytest.approx(here.heading_std_rad, rel=1e-3)
    if np.isfinite(here.lateral_offset_norm):
        assert there.lateral_offset_norm == pytest.approx(-here.lateral_offset_norm, abs=1e-3)


@settings(QUICK, derandomize=True)
@given(
    heading=st.floats(-0.2, 0.2),
    tilt=st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15)),
    mount=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.15, 0.15), st.floats(-0.15, 0.15)),
    seed=st.integers(0, 1000),
)
def test_a_turned_mount_is_like_a_turned_body(
    corridor: Any,
    seen: Any,
    heading: float,
    tilt: tuple[float, float],
    mount: tuple[float, float, float],
    seed: int,
) -> None:
    """A camera turned on its body sees what a body turned as much shows a camera that looks straight ahead."""
    pitch, roll = tilt
    body = Rotation.from_euler("ZYX", [heading, pitch, roll])
    turn = Rotation.from_euler("ZYX", mount)
    yaw, view_pitch, view_roll = (body * turn).as_euler("ZYX").tolist()
    truth = corridor(
        heading_rad=yaw,
        pitch_rad=view_pitch,
        roll_rad=view_roll,
        offset_norm=0.2,
        noise_px=0.1,
        n_random=10,
        seed=seed,
    )
    lines = seen(truth, CAMERA)
    turned = replace(CAMERA, R_body_camera=turn.as_matrix() @ CAMERA.R_body_camera)
    # The mount is known: an error of its pitch would be about the body's axis, which differs.
    known = Prior(heading_std_rad=0.1, elevation_std_rad=1e-3)
    by_mount = measure_lines(lines, turned, Attitude(roll, pitch), replace(known, heading_rad=heading))
    by_body = measure_lines(lines, CAMERA, Attitude(view_roll, view_pitch), replace(known, heading_rad=yaw))
    # The vote's bins lie elsewhere among the lines; the fit that starts from them ends at the same axis. The level's
    # correction, noise here, keeps the x axis of the body, which is pitched in one of the two only.
    assert by_mount.accepted == by_body.accepted
    std = by_body.heading_std_rad
    corrected_rad = np.nanmax(np.abs([0.0, by_mount.roll_correction_rad, by_body.roll_correction_rad]))
    limit_rad = 0.02 * std + 0.3 * corrected_rad  # pitched by up to 0.3 rad
    assert by_mount.heading_rad - heading == pytest.approx(by_body.heading_rad - yaw, abs=limit_rad)
    # Where the vote's edge falls on a line's cut-off, what it has beside its peak changes: in one of a hundred such
    # corridors the sigma does by more than a fifth.
    assert 0.5 < by_mount.heading_std_rad / std < 2.0
    # The level frame is corrected about the body's own axes: what is roll to one body is pitch in part to the other.
    turned_rad = abs(yaw - heading)
    corrections = (by_body.elevation_rad, by_body.roll_correction_rad, by_mount.roll_correction_rad)
    other_axis_rad = turned_rad * float(np.abs(corrections).max())
    elevation_bound = 0.02 * by_body.elevation_std_rad + other_axis_rad
    assert by_mount.elevation_rad == pytest.approx(by_body.elevation_rad, abs=elevation_bound)
    offset_std = by_body.lateral_offset_norm_std
    assert by_mount.lateral_offset_norm == pytest.approx(by_body.lateral_offset_norm, abs=0.3 * offset_std)


@QUICK
@given(
    heading=st.floats(-0.3, 0.3),
    slope=st.floats(radians(-4.5), radians(4.5)),
    offset=st.floats(-0.6, 0.6),
    seed=st.integers(0, 1000),
)
def test_a_slope_is_measured_and_does_no_harm(
    corridor: Any, seen: Any, heading: float, slope: float, offset: float, seed: int
) -> None:
    """A ramp's left and right lines meet above the horizon; forced onto it they would be two headings."""
    look = corridor(
        heading_rad=heading, slope_rad=slope, offset_norm=offset, noise_px=0.1, n_random=10, seed=seed
    )
    m = measure_lines(seen(look, CAMERA), CAMERA, Attitude(0.0, 0.0))
    assert m.accepted
    assert degrees(m.heading_rad - heading) == pytest.approx(0.0, abs=0.3)
    assert degrees(m.elevation_rad - slope) == pytest.approx(0.0, abs=0.3)


def test_a_tilt_error_leaves_no_two_headings(corridor: Any, seen: Any) -> None:
    """Three quarters of a degree, believed to be half a degree at most and seen by no vertical line."""
    look = corridor(heading_rad=radians(-2), posts=False, noise_px=0.1)
    m = measure_lines(
        seen(look, CAMERA), CAMERA, Attitude(0.0, radians(0.75)), Prior(elevation_std_rad=radians(0.1))
    )
    assert m.accepted
    assert degrees(m.heading_rad) == pytest.approx(-2.0, abs=0.1)
    assert degrees(m.heading_std_rad) < 0.2


def test_a_mount_that_is_off_is_found_and_does_no_harm(corridor: Any, seen: Any) -> None:
    lines = seen(corridor(heading_rad=0.1, pitch_rad=radians(-5)), CAMERA)  # the camera looks 5 degrees down
    level = Attitude(0.0, 0.0)
    m = measure_lines(lines, CAMERA, level, Prior(elevation_std_rad=radians(4)))
    assert degrees(m.heading_rad - 0.1) == pytest.approx(0.0, abs=0.02)
    assert degrees(m.elevation_rad) == pytest.approx(
        5.0, abs=0.05
    )  # the axis is seen above the given horizon
    again = measure_lines(lines, CAMERA, level, Prior(elevation_rad=m.elevation_rad, elevation_std_rad=0.005))
    assert again.elevation_rad == pytest.approx(m.elevation_rad, abs=1e-3)
    assert again.heading_rad == pytest.approx(m.heading_rad, abs=1e-3)


@pytest.mark.parametrize("roll", [-15, -5, 8, 15])
@pytest.mark.parametrize("pitch", [-12, 3, 12])
def test_level_is_found_without_any_attitude(corridor: Any, seen: Any, roll: int, pitch: int) -> None:
    truth = corridor(heading_rad=0.15, roll_rad=radians(roll), pitch_rad=radians(pitch))
    m = measure_lines(seen(truth, CAMERA), CAMERA)
    assert degrees(m.heading_rad - 0.15) == pytest.approx(0.0, abs=0.05)
    found = level_from_verticals(
        seen(truth, CAMERA), np.eye(3), CAMERA.R_body_camera, radians(12), radians(12)
    )
    true_level = Attitude(radians(roll), radians(pitch)).R_level_body() @ CAMERA.R_body_camera
    assert (found.R_level_camera @ true_level.T)[2, 2] > np.cos(radians(0.1))


@pytest.mark.parametrize("roll_error_deg", [-7.0, -4.0, -3.0, 2.0, 5.0])
@pytest.mark.parametrize("elevation_std_deg", [0.2, 1.0, 3.0])
def test_door_posts_correct_a_roll_that_is_off_by_more_than_it_says(
    corridor: Any, seen: Any, roll_error_deg: float, elevation_std_deg: float
) -> None:
    """However well the camera's elevation is known: that says nothing of the roll."""
    lines = seen(corridor(heading_rad=0.1, offset_norm=0.3, noise_px=0.2), CAMERA)
    prior = Prior(elevation_rad=0.0, elevation_std_rad=radians(elevation_std_deg))
    m = measure_lines(lines, CAMERA, Attitude(radians(roll_error_deg), 0.0), prior)
    assert m.accepted
    assert degrees(m.heading_rad - 0.1) == pytest.approx(0.0, abs=0.1)
    assert degrees(m.roll_correction_rad) == pytest.approx(-roll_error_deg, abs=0.3)
    assert m.lateral_offset_norm == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("pitch_deg", [-15.0, -6.0, 0.0, 9.0])
@pytest.mark.parametrize("roll_error_deg", [-6.0, -3.0, 4.0])
def test_a_roll_error_of_a_pitched_body_does_not_turn_the_heading(
    corridor: Any, seen: Any, pitch_deg: float, roll_error_deg: float
) -> None:
    pitch_rad, roll_rad = radians(pitch_deg), radians(3.0)
    lines = seen(corridor(heading_rad=0.1, roll_rad=roll_rad, pitch_rad=pitch_rad), CAMERA)
    attitude = Attitude(roll_rad + radians(roll_error_deg), pitch_rad, radians(1.5))
    m = measure_lines(lines, CAMERA, attitude)
    assert m.accepted
    assert degrees(m.heading_rad - 0.1) == pytest.approx(0.0, abs=0.06)


@pytest.mark.parametrize("slope_deg", [-4.0, 3.0])
@pytest.mark.parametrize("roll_deg", [-12.0, 6.0])
def test_a_slope_that_is_expected_does_not_turn_the_heading_of_a_body_that_rolls(
    corridor: Any, seen: Any, slope_deg: float, roll_deg: float
) -> None:
    """The expected elevation is taken for a mounting pitch; door posts show that it is none."""
    truth = corridor(heading_rad=0.1, roll_rad=radians(roll_deg), slope_rad=radians(slope_deg))
    prior = Prior(elevation_rad=radians(slope_deg), elevation_std_rad=radians(0.2))
    m = measure_lines(seen(truth, CAMERA), CAMERA, Attitude(radians(roll_deg), 0.0), prior)
    assert m.accepted
    error_of_a_mount_rad = radians(slope_deg) * np.sin(radians(roll_deg))
    assert abs(m.heading_rad - 0.1) < 0.2 * abs(error_of_a_mount_rad) + radians(0.03)


@pytest.mark.parametrize("slope_deg", [-4.0, 3.0])
@pytest.mark.parametrize("roll_deg", [-12.0, -2.0, 6.0])
def test_where_no_post_tells_a_slope_from_a_mounting_pitch_the_sigma_contains_it(
    corridor: Any, seen: Any, slope_deg: float, roll_deg: float
) -> None:
    truth = corridor(heading_rad=0.1, roll_rad=radians(roll_deg), slope_rad=radians(slope_deg), posts=False)
    prior = Prior(elevation_rad=radians(slope_deg), elevation_std_rad=radians(0.2))
    m = measure_lines(seen(truth, CAMERA), CAMERA, Attitude(radians(roll_deg), 0.0), prior)
    error_of_a_mount_rad = abs(radians(slope_deg) * np.sin(radians(roll_deg)))
    assert abs(m.heading_rad - 0.1) == pytest.approx(error_of_a_mount_rad, rel=0.3)
    assert 0.4 * error_of_a_mount_rad < m.heading_lasting_std_rad < m.heading_std_rad
    assert m.heading_std_rad < error_of_a_mount_rad + radians(0.1)


@pytest.mark.parametrize("mount_deg", [-8.0, -3.0, 5.0])
@pytest.mark.parametrize("roll_deg", [-12.0, 6.0])
@pytest.mark.parametrize("is_learned", [False, True])
def test_a_mounting_pitch_does_not_turn_the_heading_of_a_body_that_rolls(
    corridor: Any, seen: Any, mount_deg: float, roll_deg: float, is_learned: bool
) -> None:
    mounted = replace(
        CAMERA, R_body_camera=rotation_from_angles(0.0, radians(mount_deg), 0.0) @ CAMERA.R_body_camera
    )
    lines = seen(corridor(heading_rad=0.1, roll_rad=radians(roll_deg)), mounted)
    prior = Prior(elevation_std_rad=radians(5.0))
    if is_learned:
        prior = Prior(elevation_rad=radians(-mount_deg), elevation_std_rad=radians(0.2))
    m = measure_lines(lines, CAMERA, Attitude(radians(roll_deg), 0.0), prior)
    assert m.accepted
    assert degrees(m.elevation_rad) == pytest.approx(-mount_deg, abs=0.3)
    assert degrees(m.heading_rad - 0.1) == pytest.approx(0.0, abs=0.06)


@QUICK
@given(seed=st.integers(0, 10_000), heading=angle)
def test_random_lines_do_not_move_the_answer(corridor: Any, seen: Any, seed: int, heading: float) -> None:
    truth = corridor(heading_rad=heading, noise_px=0.2, n_random=40, seed=seed)
    m = measure_lines(seen(truth, CAMERA), CAMERA, Attitude(0, 0))
    if m.accepted:
        assert abs(degrees(m.heading_rad - heading)) < 3.0


def test_sigma_is_honest(corridor: Any, seen: Any) -> None:
    ratios, n_accepted = [], 0
    rng = np.random.default_rng(3)
    for seed in range(200):
        heading = rng.uniform(-0.3, 0.3)
        lines = seen(corridor(heading_rad=heading, noise_px=0.3, n_random=15, seed=seed), CAMERA)
        m = measure_lines(lines, CAMERA, Attitude(*rng.normal(0, radians(0.5), 2)))
        n_accepted += m.accepted  # rarely, random lines agree on a second direction near the axis
        ratios.append(abs(m.heading_rad - heading) / m.heading_std_rad)
    assert n_accepted >= 199
    assert 0.4 < np.percentile(ratios, 90) < 2.0


def test_nothing_along_the_corridor_is_no_answer(corridor: Any, seen: Any) -> None:
    posts_only = measure_lines(seen(corridor(along=False), CAMERA), CAMERA, Attitude(0, 0))
    assert not posts_only.accepted
    assert posts_only.reason is Reason.TOO_FEW_LINES
    lines = seen(corridor(), CAMERA)
    few = replace(lines, **{n: getattr(lines, n)[:3] for n in PER_LINE})
    assert measure_lines(few, CAMERA, Attitude(0, 0)).reason is Reason.TOO_FEW_LINES


def test_a_prior_chooses_between_two_corridors(corridor: Any, seen: Any) -> None:
    one = seen(corridor(heading_rad=radians(30)), CAMERA)
    other = seen(corridor(heading_rad=radians(-30)), CAMERA)
    both = replace(one, **{n: np.concatenate([getattr(one, n), getattr(other, n)]) for n in PER_LINE})
    assert measure_lines(both, CAMERA, Attitude(0, 0)).reason is Reason.AMBIGUOUS
    for side in (30, -30):
        prior = Prior(heading_rad=radians(side - 3), heading_std_rad=radians(2))
        m = measure_lines(both, CAMERA, Attitude(0, 0), prior)
        assert degrees(m.heading_rad) == pytest.approx(side, abs=0.5)


@pytest.mark.parametrize("std_deg", [0.3, 1.0, 3.0, 30.0, 90.0, float("nan")])
def test_a_prediction_elsewhere_opens_no_direction_across_the_view(std_deg: float) -> None:
    """Lines 65 degrees off the view run across the corridor, unless the vehicle is known to be turned that far."""
    ahead, right = np.cos(radians(65)), np.sin(radians(65))
    lines = of_world(
        [
            (4.0 + a * ahead, a * right, z, 4.0 + b * ahead, b * right, z)
            for a, b in ((-1.8, -0.9), (-0.7, 0.6), (0.8, 1.9))
            for z in (-1.0, -0.7, -0.3, 0.4, 0.8, 1.1)
        ]
    )
    assert not measure_lines(lines, CAMERA, Attitude(0, 0)).accepted
    for heading_deg in (25.0, 5.0):
        prior = Prior(heading_rad=radians(heading_deg), heading_std_rad=radians(std_deg))
        assert not measure_lines(lines, CAMERA, Attitude(0, 0), prior).accepted
    turned = measure_lines(lines, CAMERA, Attitude(0, 0), Prior(radians(-63), radians(2)))
    assert turned.accepted
    assert degrees(turned.heading_rad) == pytest.approx(-65.0, abs=0.1)


def test_blur_is_refused_when_the_exposure_is_known(corridor: Any, seen: Any) -> None:
    camera = replace(CAMERA, exposure_s=0.03)
    lines = seen(corridor(), camera)
    assert measure_lines(lines, camera, Attitude(0, 0), Prior(body_rate_rad_s=2.0)).reason is Reason.BLUR
    assert measure_lines(lines, camera, Attitude(0, 0), Prior(body_rate_rad_s=0.2)).accepted


def test_a_tilted_mount_changes_nothing(corridor: Any, seen: Any) -> None:
    turn = Attitude(radians(4), radians(-8)).R_level_body()
    camera = replace(CAMERA, R_body_camera=turn @ CAMERA.R_body_camera)
    m = measure_lines(seen(corridor(heading_rad=0.1, offset_norm=0.3), camera), camera, Attitude(0, 0))
    assert degrees(m.heading_rad - 0.1) == pytest.approx(0.0, abs=0.02)
    assert m.lateral_offset_norm == pytest.approx(0.3, abs=0.02)


def test_the_axis_of_the_fit_is_what_the_heading_says() -> None:
    np.testing.assert_allclose(
        axis_direction(radians(90), 0.0), [0, -1, 0], atol=1e-12
    )  # turned right: axis left
    np.testing.assert_allclose(axis_direction(0.0, radians(90)), [0, 0, -1], atol=1e-12)  # z points down


def test_no_lines_no_axis(corridor: Any, seen: Any) -> None:
    lines = seen(corridor(), CAMERA)
    empty = replace(lines, **{n: getattr(lines, n)[:0] for n in PER_LINE})
    assert fit_axis(empty, CAMERA.R_body_camera) is None
    m = measure_lines(empty, CAMERA)
    assert m.reason is Reason.TOO_FEW_LINES
    assert np.isnan(m.heading_rad)


def test_a_quaternion_serves_as_attitude_and_a_bad_one_is_refused(corridor: Any, seen: Any) -> None:
    lines = seen(corridor(heading_rad=0.1, roll_rad=0.1), CAMERA)
    q = [np.cos(0.05), np.sin(0.05), 0.0, 0.0]
    as_quaternion = measure_lines(lines, CAMERA, q)
    assert as_quaternion.heading_rad == measure_lines(lines, CAMERA, Attitude(0.1, 0.0)).heading_rad
    with pytest.raises(InputError, match="unit quaternion"):
        measure_lines(lines, CAMERA, [0.0, 0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="unit quaternion"):
        measure_lines(lines, CAMERA, [np.nan, 0.0, 0.0, 1.0])


def test_heading_stays_in_its_range(corridor: Any, seen: Any) -> None:
    for heading in np.linspace(-pi, pi, 25):
        m = measure_lines(seen(corridor(heading_rad=heading), CAMERA), CAMERA, Attitude(0, 0))
        if m.accepted:
            assert abs(m.heading_rad) <= pi / 2


def of_world(segments: Sequence[tuple[float, ...]]) -> LineSet:
    """Lines that a level camera sees of segments ahead of it, two points each: x forward, y right, z down."""
    ends = np.array(segments).reshape(-1, 3)
    return lines_between((466.0 * ends[:, 1:] / ends[:, :1] + (319.5, 239.5)).reshape(-1, 4), CAMERA)


def test_before_a_side_wall_two_directions_are_as_good() -> None:
    """What sticks out of the wall looks like a corridor, and what runs along it like lines across."""
    sticking_out = [(1.8, y, z, 1.3, y, z) for y in (-0.9, -0.5, 0.5, 0.8) for z in (-0.6, -0.3, 0.4)]
    along_the_wall = [
        (1.8, a, z, 1.8, b, z) for a, b in ((-1.2, -0.6), (0.6, 1.2)) for z in np.linspace(-0.8, 0.8, 14)
    ]
    alone = measure_lines(of_world(sticking_out), CAMERA, Attitude(0, 0))
    assert alone.accepted
    lines = of_world(sticking_out + along_the_wall)
    m = measure_lines(lines, CAMERA, Attitude(0, 0))
    assert m.reason is Reason.AMBIGUOUS
    assert m.second_score == 1.0
    assert abs(wrap_axis(m.second_heading_rad - m.heading_rad)) == pytest.approx(np.pi / 2)
    # A filter that knows its heading is told, and chooses.
    assert measure_lines(
        lines, CAMERA, Attitude(0, 0), Prior(heading_rad=0.02, heading_std_rad=0.05)
    ).accepted
    # Ahead, between the walls, lines across are those of the corridor's end.
    ahead = [(6.0, -0.9, z, 6.0, 0.9, z) for z in np.linspace(-1.0, 1.0, 14)]
    assert measure_lines(of_world(sticking_out + ahead), CAMERA, Attitude(0, 0)).accepted


def test_at_the_corner_of_a_building_either_facade_may_be_chosen() -> None:
    """Seen from outside, both run away from the corner, and one picture cannot tell which is meant."""
    facades = [
        (4.0 + a * 0.7, side * a * 0.7, z, 4.0 + b * 0.7, side * b * 0.7, z)
        for side in (-1, 1)
        for a, b in ((0.2, 1.4), (1.6, 2.8), (3.0, 4.2))
        for z in (-1.5, -1.1, -0.4, 0.3, 0.8)
    ]
    lines = of_world(facades)
    m = measure_lines(lines, CAMERA, Attitude(0, 0))
    assert m.reason is Reason.AMBIGUOUS
    assert sorted(degrees(h) for h in (m.heading_rad, m.second_heading_rad)) == pytest.approx(
        [-45, 45], abs=1.0
    )
    assert m.second_score > 0.9
    for heading_rad in (m.heading_rad, m.second_heading_rad):
        prior = Prior(heading_rad=heading_rad, heading_std_rad=radians(3.0))
        chosen = measure_lines(lines, CAMERA, Attitude(0, 0), prior)
        assert chosen.heading_rad == pytest.approx(heading_rad, abs=radians(1.0))
        assert chosen.heading_std_rad < radians(1.0)
        assert chosen.accepted
        # Near neither of them, or with no idea of the heading, there is nothing to choose by.
        for unsure in (Prior(0.0, radians(3.0)), Prior(heading_rad, radians(40.0))):
            assert not measure_lines(lines, CAMERA, Attitude(0, 0), unsure).accepted


@pytest.mark.parametrize("n_across", [0, 6, 12, 24])
def test_a_prediction_that_is_a_right_angle_off_does_not_overrule_the_picture(n_across: int) -> None:
    """A filter that follows the axis across must not be confirmed by pictures that show the corridor as well."""
    heading_rad = radians(35.0)
    forward, right = (
        np.array([np.cos(heading_rad), -np.sin(heading_rad)]),
        np.array([np.sin(heading_rad), np.cos(heading_rad)]),
    )

    def between(a: Any, b: Any, z: float) -> tuple[float, ...]:
        (ax, ay), (bx, by) = (p[0] * forward + p[1] * right for p in (a, b))
        return (ax, ay, z, bx, by, z)

    along = [
        between((x, side), (x + 1.5, side), z)
        for side in (-0.9, 1.1)
        for x in (2.0, 4.0, 6.5)
        for z in (-1.2, -0.7, 0.4, 1.2)
    ]
    across = [between((8.0, -0.9), (8.0, 1.1), z) for z in np.linspace(-1.1, 1.1, n_across)]
    lines = of_world(along + across)
    wrong = Prior(heading_rad - pi / 2, radians(2.0))
    m = measure_lines(lines, CAMERA, Attitude(0, 0), wrong)
    assert not m.accepted or abs(wrap_axis(m.heading_rad - heading_rad)) < radians(1.0)


EDGES = [(1.5, y, z, x, y, z) for x in (4.0, 9.0) for y in (-1.1, 1.1) for z in (1.4, -1.2)]
ON_FLOOR = [edge for edge in EDGES if edge[2] > 0.0]


def joints(angle_rad: float, spacing_m: float = 0.15) -> list[tuple[float, ...]]:
    """Joints of planks on a floor, between the walls and from 1.5 to 9 m ahead, at an angle to the corridor."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    found: list[tuple[float, ...]] = []
    for across in np.arange(-10.0, 10.0, spacing_m):
        on_line = np.linspace(-12.0, 12.0, 4801)
        x, y = c * on_line - s * across, s * on_line + c * across
        inside = (x > 1.5) & (x < 9.0) & (np.abs(y) < 1.1)
        if inside.sum() > 50:
            first, last = np.flatnonzero(inside)[[0, -1]]
            found.append((x[first], y[first], 1.4, x[last], y[last], 1.4))
    return found


@pytest.mark.parametrize("angle_deg", [-65, -40, -20, 12, 30, 45, 70])
@pytest.mark.parametrize("tiles", [False, True])
def test_joints_of_a_floor_laid_at_an_angle_are_no_corridor(angle_deg: float, tiles: bool) -> None:
    floor = joints(radians(angle_deg)) + (joints(radians(angle_deg) + pi / 2) if tiles else [])
    assert len(floor) > 2 * len(EDGES)
    m = measure_lines(of_world(EDGES + floor), CAMERA, Attitude(0, 0))
    assert degrees(m.heading_rad) == pytest.approx(0.0, abs=1.0)
    # Where nothing is seen above the horizon either direction may be the corridor's.
    for prior in (None, Prior(0.0, radians(2.0))):
        m = measure_lines(of_world(ON_FLOOR + floor), CAMERA, Attitude(0, 0), prior)
        assert not m.accepted or degrees(m.heading_rad) == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize("aside_m", [-0.2, 0.1, 0.15, 0.25])
@pytest.mark.parametrize("roll_error_rad", [0.0, radians(0.4)])
def test_a_dashed_line_below_the_camera_is_not_upright(aside_m: float, roll_error_rad: float) -> None:
    """Seen from above it looks as a door post does to a camera that is rolled."""
    dashes = [
        (x, aside_m + w, 1.4, x + 0.5, aside_m + w, 1.4) for x in np.arange(2.5, 9.0) for w in (0.0, 0.05)
    ]
    m = measure_lines(of_world(EDGES + dashes), CAMERA, Attitude(roll_error_rad, 0.0))
    assert abs(roll_error_rad - m.roll_correction_rad) < 3.0 * m.roll_correction_std_rad or isnan(
        m.roll_correction_rad
    )
    assert m.accepted
    assert isnan(m.lateral_offset_norm) or abs(m.lateral_offset_norm) < 3.0 * m.lateral_offset_norm_std


def test_joints_along_a_corridor_are_no_objection() -> None:
    for seen in (ON_FLOOR, ON_FLOOR + joints(0.0), EDGES + joints(0.0) + joints(pi / 2)):
        m = measure_lines(of_world(seen), CAMERA, Attitude(0, 0))
        assert m.accepted
        assert degrees(m.heading_rad) == pytest.approx(0.0, abs=0.3)
