"""The mounting yaw by drift and velocity, in flights made up from the definition of the lateral offset."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.alignment.clock import ClockFit, find_clock
from fusion.alignment.track import fit_track
from fusion.alignment.turning import Turning
from fusion.alignment.views import Sightings
from fusion.flight import AttitudeStream, Flight, FrameStream, VectorStream
from vision import Camera
from vision.images import GreyImage

DURATION_S, HALF_WIDTH_M, START_NS = 18.0, 1.3, 5_000_000_000


class NoPictures:
    def read(self, index: int) -> GreyImage:
        raise AssertionError("no picture is needed")


class Drive:
    """A vehicle that follows its nose at 0.8 m/s, and slips sideways where asked to."""

    def __init__(self, seed: int, mount_deg: float, slip_m_s: float = 0.0, clock_s: float = 0.25) -> None:
        rng = np.random.default_rng(seed)
        fine = np.arange(-1.0, DURATION_S + 1.0, 0.005)
        psi = radians(9) * np.sin(1.1 * fine + rng.uniform(0, 2 * pi)) + radians(3) * np.sin(2.7 * fine)
        ahead, aside = np.full(len(fine), 0.8), slip_m_s * np.sin(0.8 * fine)
        lateral = np.cumsum(ahead * np.sin(psi) + aside * np.cos(psi)) * 0.005
        along = np.cumsum(ahead * np.cos(psi) - aside * np.sin(psi)) * 0.005
        down = np.tile([0.0, 0.0, 1.0], (len(fine), 1))
        self.turning = Turning(fine, psi, down, np.full(len(fine), 0.01), 0.1, True, 0.0)
        stamp = np.arange(0.0, DURATION_S - 0.5, 0.05)
        at = stamp + clock_s
        heading = np.interp(at, fine, psi) + radians(mount_deg) + rng.normal(0, radians(0.1), len(at))
        offset = (np.interp(at, fine, lateral) - lateral[200]) / HALF_WIDTH_M + rng.normal(0, 0.01, len(at))
        headings = Sightings.of_headings(stamp, heading, np.full(len(at), radians(0.1)))
        self.sightings = replace(headings, offset_norm=offset, offset_std=np.full(len(at), 0.01))
        t_ns = START_NS + np.round(fine[::10] * 1e9).astype(np.int64)
        velocity = np.stack([ahead, aside, np.zeros(len(fine))], axis=1)[::10]
        self.flight = Flight(
            "drive",
            Camera.from_fov(64, 48, 1.0),
            FrameStream(START_NS + np.round(stamp * 1e9).astype(np.int64), NoPictures()),
            velocity=VectorStream(t_ns, velocity),
        )
        world = Rotation.from_euler("z", 0.7)  # the log's world is turned against the corridor
        places = world.apply(np.stack([along, lateral, np.zeros(len(fine))], axis=1))[::10]
        q = np.roll((world * Rotation.from_rotvec(np.outer(psi[::10], [0, 0, 1]))).as_quat(), 1, axis=1)
        self.by_position = replace(
            self.flight,
            velocity=None,
            position=VectorStream(t_ns, places),
            attitude=AttitudeStream(t_ns, q),
        )

    def clock(self) -> ClockFit:
        fit = find_clock(self.sightings, self.turning, 0.6).fit
        assert fit is not None
        return fit


@pytest.mark.parametrize("mount_deg", [0.0, 3.0, -4.0])
@pytest.mark.parametrize("stream", ["flight", "by_position"])
@pytest.mark.parametrize("slip_m_s", [0.0, 0.3])
def test_the_yaw_is_found(mount_deg: float, stream: str, slip_m_s: float) -> None:
    drive = Drive(1, mount_deg, slip_m_s)
    fit = fit_track(getattr(drive, stream), drive.sightings, drive.turning, drive.clock(), START_NS)
    assert fit is not None
    assert np.degrees(fit.yaw_rad) == pytest.approx(mount_deg, abs=0.4)
    assert radians(1.0) < fit.std_rad < radians(1.3)
    assert fit.distance_m == pytest.approx(0.8 * (DURATION_S - 0.5), rel=0.1)


def test_a_given_width_is_used() -> None:
    drive = Drive(2, 3.0)
    wrong = replace(drive.flight, corridor_width_m=4.0 * HALF_WIDTH_M)
    right = replace(drive.flight, corridor_width_m=2.0 * HALF_WIDTH_M)
    said = [
        fit_track(flight, drive.sightings, drive.turning, drive.clock(), START_NS)
        for flight in (right, wrong)
    ]
    assert said[0] is not None
    assert said[1] is not None
    assert abs(said[0].yaw_rad - radians(3.0)) < radians(0.4)


def test_what_the_camera_was_turned_by_is_added() -> None:
    drive = Drive(3, 1.0)
    fit = fit_track(
        drive.flight, drive.sightings, drive.turning, drive.clock(), START_NS, turned_yaw_rad=radians(5.0)
    )
    assert fit is not None
    assert np.degrees(fit.yaw_rad) == pytest.approx(6.0, abs=0.4)


def test_without_velocity_or_way_it_says_nothing() -> None:
    drive = Drive(4, 2.0)
    clock = drive.clock()
    assert drive.flight.velocity is not None
    still = replace(drive.flight.velocity, xyz=np.zeros_like(drive.flight.velocity.xyz))
    for flight in (replace(drive.flight, velocity=None), replace(drive.flight, velocity=still)):
        assert fit_track(flight, drive.sightings, drive.turning, clock, START_NS) is None
