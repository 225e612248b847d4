"""Frames along a flight: exposure, rolling shutter, motion blur, and the camera's own picture chain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fusion.simulate.config import SimulationConfig
from fusion.simulate.imaging import Picture, Sensor, mean_radiance, through_jpeg
from fusion.simulate.motion import Trajectory, Truth, plan_flight
from fusion.simulate.plan import floor_plan
from fusion.simulate.render import Image, View, render_linear
from fusion.simulate.scene import Scene, build_scene
from fusion.simulate.sensors import sample_times
from vision import Camera

FloatArray = npt.NDArray[np.float64]

MAX_SUB_EXPOSURES = 24
METERED_FRAMES = 6


class SimulatedFrame(NamedTuple):
    """A frame: time stamp as a log would have it, the grey picture (h, w), and the exact state at mid-exposure."""

    t_ns: int
    image: Picture
    truth: Truth


@dataclass(frozen=True, slots=True, eq=False)
class Shoot:
    """A flight through a scene with a camera; makes the picture of any moment."""

    config: SimulationConfig
    camera: Camera
    scene: Scene
    trajectory: Trajectory
    view: View
    sensor: Sensor

    @classmethod
    def prepare(cls, config: SimulationConfig, camera: Camera | None = None) -> Shoot:
        """Plan the flight, build the scene clear of its path, and set the exposure by a few small pictures.

        Parameters
        ----------
        camera
            Takes the place of the lens and mount in ``config.camera``.
        """
        camera = camera or config.camera.camera()
        rooms, meetings = floor_plan(config.scene)
        trajectory = plan_flight(config.motion, rooms, meetings, config.seed)
        path = trajectory.position(np.arange(0.0, trajectory.duration_s + 0.1, 0.1))
        scene = build_scene(config.scene, config.seed, config.light_cell_m, path)
        view = View.of(camera)
        small = View.of(camera.resized(max(16, camera.width_px // 4), max(16, camera.height_px // 4)))
        times = np.linspace(0.0, trajectory.duration_s, METERED_FRAMES)
        level = np.mean([mean_radiance(_exposed(scene, small, trajectory, t, 0.0, 1, 1)) for t in times])
        return cls(config, camera, scene, trajectory, view, Sensor.of(config.imaging, view, float(level)))

    def frame_times(self) -> FloatArray:
        """Mid-exposure times of the frames, seconds from the flight's start; lost frames are left out."""
        config = self.config.camera
        times = sample_times(self.trajectory.duration_s, config.rate_hz)
        rng = np.random.default_rng((self.config.seed, 8))
        kept = rng.random(len(times)) >= config.lost_frames_share
        return times[kept]

    def radiance(self, t_s: float) -> Image:
        """Light that falls on the sensor during the exposure about ``t_s``."""
        exposure_s = 0.0 if np.isnan(self.camera.exposure_s) else self.camera.exposure_s
        truth = self.trajectory.truth(t_s + np.array([-0.5, 0.0, 0.5]) * exposure_s)
        rate = float(np.linalg.norm(truth.rate_rad_s, axis=1).max())
        nearest_m = 1.0
        turned = (rate + float(np.linalg.norm(truth.v_world_m_s[1])) / nearest_m * 0.5) * exposure_s
        count = int(np.clip(np.ceil(turned / float(np.median(self.view.pixel_rad))), 1, MAX_SUB_EXPOSURES))
        grid = max(2, round(self.config.edge_samples / count**0.5)) if count > 1 else self.config.edge_samples
        return _exposed(
            self.scene,
            self.view,
            self.trajectory,
            t_s,
            exposure_s,
            count,
            grid,
            self.config.camera.line_delay_s,
        )

    def picture(self, t_s: float, number: int) -> Picture:
        """Picture of a moment; ``number`` seeds its noise."""
        rng = np.random.default_rng((self.config.seed, 9, number))
        return self.sensor.develop(self.radiance(t_s), rng)

    def stamp_ns(self, t_s: float) -> int:
        """Time stamp of a frame, with the camera clock's error."""
        return self.config.start_ns + round((t_s + self.config.camera.time_offset_s) * 1e9)


def _exposed(
    scene: Scene,
    view: View,
    trajectory: Trajectory,
    t_s: float,
    exposure_s: float,
    count: int,
    grid: int,
    line_delay_s: float = 0.0,
) -> Image:
    """Mean of ``count`` pictures spread over the exposure; rows are exposed one after another."""
    height = view.camera.height_px
    rows = (
        t_s + (np.arange(height) - (height - 1) / 2) * line_delay_s if line_delay_s > 0 else np.array([t_s])
    )
    total: Image | None = None
    for k in range(count):
        t = rows + ((k + 0.5) / count - 0.5) * exposure_s
        R = trajectory.rotations(t)
        origins = trajectory.position(t) + R @ view.camera.p_body_camera_m
        if line_delay_s <= 0:
            R, origins = R[0], origins[0]
        picture = render_linear(scene.mesh, view, origins, R, grid)
        total = picture if total is None else total + picture
    assert total is not None
    return np.asarray(total / np.float32(count), np.float32)


def simulate_frames(config: SimulationConfig, camera: Camera | None = None) -> Iterator[SimulatedFrame]:
    """Yield a flight's frames in memory, as they come back from JPEG where that is configured.

    Parameters
    ----------
    camera
        Takes the place of the lens and mount in ``config.camera``.
    """
    shoot = Shoot.prepare(config, camera)
    for number, t in enumerate(shoot.frame_times().tolist()):
        image = through_jpeg(shoot.picture(t, number), config.imaging.jpeg_quality)
        yield SimulatedFrame(shoot.stamp_ns(t), image, shoot.trajectory.truth(t))
