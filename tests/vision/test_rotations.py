"""Wrapping and rotations: known answers, and agreement with scipy."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vision.rotations import (
    down_of_quaternion,
    rotation_from_angles,
    wrap,
    wrap_axis,
    yaw_of,
    yaw_of_quaternion,
)

ANGLES = st.floats(-1e3, 1e3)


@given(ANGLES)
def test_wrapping_keeps_the_direction(angle: float) -> None:
    wrapped = wrap(angle)
    assert -pi <= wrapped < pi
    assert cos(wrapped) == pytest.approx(cos(angle), abs=1e-9)
    assert sin(wrapped) == pytest.approx(sin(angle), abs=1e-9)
    assert wrap(np.array([angle])).tolist() == [wrapped]


@given(ANGLES)
def test_an_axis_is_the_same_from_both_ends(angle: float) -> None:
    wrapped = wrap_axis(angle)
    assert -pi / 2 <= wrapped < pi / 2
    assert sin(wrapped - angle) == pytest.approx(0.0, abs=1e-9)
    assert wrap_axis(np.array([angle])).tolist() == [wrapped]


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_angles_and_quaternion_agree_with_scipy(yaw: float, pitch: float, roll: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    np.testing.assert_allclose(rotation_from_angles(yaw, pitch, roll), expected.as_matrix(), atol=1e-12)
    q = np.roll(expected.as_quat(), 1)
    assert float(yaw_of(q)) == pytest.approx(yaw, abs=1e-9)
    assert yaw_of(np.stack([q, -q])).shape == (2,)
    np.testing.assert_allclose(yaw_of(np.stack([q, -q])), yaw, atol=1e-9)


def test_yaw_is_positive_to_the_right_where_z_points_down() -> None:
    half = pi / 12
    turned_right = np.array([[cos(half), 0.0, 0.0, sin(half)]])
    assert yaw_of(turned_right) == pytest.approx([pi / 6])
    np.testing.assert_allclose(rotation_from_angles(pi / 6, 0.0, 0.0)[:2, 0], [cos(pi / 6), 0.5])


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_one_quaternion_agrees_with_arrays_of_them(yaw: float, pitch: float, roll: float) -> None:
    w, x, y, z = np.roll(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat(), 1).tolist()
    assert yaw_of_quaternion((w, x, y, z)) == pytest.approx(float(yaw_of([w, x, y, z])), abs=1e-12)
    expected = rotation_from_angles(yaw, pitch, roll)[2]
    np.testing.assert_allclose(down_of_quaternion((w, x, y, z)), expected, atol=1e-12)
