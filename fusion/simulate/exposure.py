"""Frames along a flight: exposure, rolling shutter, motion blur, and the camera's own picture chain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fusion.simulate.config import SimulationConfig
from fusion.simulate.imu import sample_times
from fusion.simulate.motion import Trajectory, Truth, plan_flight
from fusion.simulate.render.view import Image, View, exposure_moments, render_linear
from fusion.simulate.scene.build import Scene, build_scene
from fusion.simulate.scene.plan import floor_plan
from fusion.simulate.sensor import Picture, Sensor, mean_radiance, through_jpeg
from vision import Camera

FloatArray = npt.NDArray[np.float64]

NEAR_M = 1.0  # distance of objects for motion blur by speed
METERED_FRAMES = 6


class SimulatedFrame(NamedTuple):
    """A frame: time stamp as in a log, the grey picture (h, w), and the exact state at mid-exposure."""

    t_ns: int
    image: Picture
    truth: Truth


@dataclass(frozen=True, slots=True, eq=False)
class FlyingCamera:
    """A flight through a scene with a camera; renders the picture of any moment."""

    config: SimulationConfig
    camera: Camera
    scene: Scene
    trajectory: Trajectory
    view: View
    sensor: Sensor

    @classmethod
    def prepare(cls, config: SimulationConfig, camera: Camera | None = None) -> FlyingCamera:
        """Plan the flight, build the scene with a free path, and set the exposure from a few small pictures.

        Parameters
        ----------
        camera
            Replaces the lens and mount in ``config.camera``.
        """
        camera = camera or config.camera.camera()
        rooms, meetings = floor_plan(config.scene)
        trajectory = plan_flight(config.motion, rooms, meetings, config.seed)
        path = trajectory.position(np.arange(0.0, trajectory.duration_s + 0.1, 0.1))
        path[:, 2] += np.tan(config.scene.slope_rad) * path[:, 0]  # relative to a level floor
        scene = build_scene(config.scene, config.seed, config.light_cell_m, path)
        view = View.of(camera)
        global_shutter = replace(camera, line_delay_s=0.0)
        small = View.of(global_shutter.resized(max(16, camera.width_px // 4), max(16, camera.height_px // 4)))
        times = np.linspace(0.0, trajectory.duration_s, METERED_FRAMES)
        level = np.mean(
            [
                mean_radiance(_exposed(scene, small, trajectory, times[k : k + 1], 1))
                for k in range(METERED_FRAMES)
            ]
        )
        return cls(
            config,
            camera,
            scene,
            trajectory,
            view,
            Sensor.of(config.imaging, view, float(level), config.seed),
        )

    def frame_times(self) -> FloatArray:
        """Mid-exposure times of the frames, seconds from the flight's start; lost frames are left out."""
        config = self.config.camera
        times = sample_times(self.trajectory.duration_s, config.rate_hz)
        rng = np.random.default_rng((self.config.seed, 8))
        kept = rng.random(len(times)) >= config.lost_frames_share
        return times[kept]

    def radiance(self, t_s: float) -> Image:
        """Light on the sensor during the exposure about ``t_s``."""
        exposure_s = 0.0 if np.isnan(self.camera.exposure_s) else self.camera.exposure_s
        truth = self.trajectory.truth(t_s + np.array([-0.5, 0.0, 0.5]) * exposure_s)
        rate = float(np.linalg.norm(truth.rate_rad_s, axis=1).max())
        speed = float(np.linalg.norm(truth.v_world_m_s[1]))
        moved_rad = (rate + 0.5 * speed / NEAR_M) * exposure_s
        moments, grid = exposure_moments(self.view, exposure_s, moved_rad, self.config.edge_samples)
        return _exposed(self.scene, self.view, self.trajectory, t_s + moments, grid)

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
    moments_s: FloatArray,
    grid: int,
) -> Image:
    """Mean light of the moments of an exposure; with a rolling shutter, those of the middle row."""
    height, line_delay_s = view.camera.height_px, view.camera.line_delay_s
    rows = (np.arange(height) - (height - 1) / 2) * line_delay_s
    origins, rotations = [], []
    for moment in moments_s.tolist():
        R = trajectory.rotations(moment + rows if line_delay_s != 0.0 else moment)
        p = trajectory.position(moment + rows if line_delay_s != 0.0 else np.array([moment]))
        p = p + R @ view.camera.p_body_camera_m
        origins.append(p if line_delay_s != 0.0 else p[0])
        rotations.append(R if line_delay_s != 0.0 else R[0])
    return render_linear(scene.mesh, view, origins, rotations, grid)


def simulate_frames(config: SimulationConfig, camera: Camera | None = None) -> Iterator[SimulatedFrame]:
    """Yield a flight's frames in memory, after JPEG compression if configured.

    Parameters
    ----------
    camera
        Replaces the lens and mount in ``config.camera``.
    """
    flying = FlyingCamera.prepare(config, camera)
    for number, t in enumerate(flying.frame_times().tolist()):
        image = through_jpeg(flying.picture(t, number), config.imaging.jpeg_quality)
        yield SimulatedFrame(flying.stamp_ns(t), image, flying.trajectory.truth(t))
