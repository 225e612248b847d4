"""Mounting of a robot's sensors, by the static transforms in its bag (``/tf_static``, REP 105).

A transform of ROS maps coordinates of the child to the parent. Axes are those of ROS, body x forward, y left, z up;
only `Mount` is in FRD.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fusion.flight import FloatArray
from vision.cameras.calibration import to_frd

R_FRD_FLU: FloatArray = to_frd("flu")
# For samples in an optical frame (x right, y down, z forward) that were converted as x forward, y left, z up.
OPTICAL_AS_FLU: FloatArray = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]) @ R_FRD_FLU.T
TOPICS = ("/tf_static", "tf_static")
BODIES = ("base_link", "base_footprint", "base", "body")  # last part of the name of a vehicle's own axes
DEEPEST = 50  # a longer chain of transforms is a cycle
MIN_LENGTH = 0.5  # of a valid quaternion


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Pose of a sensor on the body.

    Parameters
    ----------
    R_body_sensor
        Rotation (3, 3) from the sensor's own axes to the body FRD.
    p_body_sensor_m
        Its position (3,) in the body FRD.
    body
        Name of the body's frame in the bag.
    """

    R_body_sensor: FloatArray
    p_body_sensor_m: FloatArray
    body: str

    def of_flu_sensor(self) -> FloatArray:
        """Rotation (3, 3) to the body FRD for samples that were converted as if in the body's axes."""
        return self.R_body_sensor @ R_FRD_FLU.T


@dataclass(slots=True, eq=False)
class StaticFrames:
    """Static transforms: each frame's parent, and its rotation (3, 3) and position (3,) in it."""

    parents: dict[str, tuple[str, FloatArray, FloatArray]] = field(default_factory=dict)

    def add(self, transforms: Iterable[Any]) -> None:
        """Add a message's transforms, without invalid rotations."""
        for stamped in transforms:
            shift, turn = stamped.transform.translation, stamped.transform.rotation
            p = np.array([shift.x, shift.y, shift.z], dtype=float)
            q = np.array([turn.w, turn.x, turn.y, turn.z], dtype=float)
            length = float(np.linalg.norm(q))
            if np.isfinite(p).all() and np.isfinite(length) and length > MIN_LENGTH:
                child, parent = name_of(stamped.child_frame_id), name_of(stamped.header.frame_id)
                self.parents[child] = (parent, _matrix(q / length), p)

    def mount(self, frame_id: str) -> Mount | None:
        """Pose of a frame on the body; None if no chain of transforms connects them."""
        R, p, frame = np.eye(3), np.zeros(3), name_of(frame_id)
        for _ in range(DEEPEST):
            if frame.rsplit("/", 1)[-1] in BODIES:
                return Mount(R_FRD_FLU @ R, R_FRD_FLU @ p, frame)
            if frame not in self.parents:
                return None
            frame, R_parent, p_parent = self.parents[frame]
            R, p = R_parent @ R, R_parent @ p + p_parent
        return None


def is_optical(frame_id: str) -> bool:
    """Whether a frame is optical by its name (REP 103): x right, y down, z forward."""
    return name_of(frame_id).removesuffix("_frame").endswith("_optical")


def name_of(frame_id: str) -> str:
    """Name of a frame without the slash that ROS 1 may put before it."""
    return str(frame_id).lstrip("/")


def _matrix(q: FloatArray) -> FloatArray:
    """Rotation (3, 3) of a unit quaternion (4,), w x y z."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
