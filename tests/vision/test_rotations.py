from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vision.rotations import down_of_quaternion, euler_of_quaternions, rotation_of_euler, yaw_of_quaternion

angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    x, y, z, w = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat().tolist()
    return w, x, y, z


@given(angles)
def test_angles_of_a_quaternion_and_back(euler: tuple[float, float, float]) -> None:
    q = quaternion(*euler)
    found = euler_of_quaternions(np.array([q, q]))
    for values, expected in zip(found, euler, strict=True):
        assert values.tolist() == pytest.approx([expected] * 2, abs=1e-6)
    assert yaw_of_quaternion(q) == pytest.approx(euler[2], abs=1e-6)


@given(angles)
def test_matrices_are_scipys(euler: tuple[float, float, float]) -> None:
    roll, pitch, yaw = euler
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    R = rotation_of_euler(roll, pitch, yaw)
    np.testing.assert_allclose(R, expected, atol=1e-12)
    np.testing.assert_allclose(down_of_quaternion(quaternion(*euler)), R[2], atol=1e-12)
