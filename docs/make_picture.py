"""Make ``docs/office.png`` for the README: what one frame shows, and the heading that comes of all of them.

Run it in the repository's folder: ``.venv/bin/python docs/make_picture.py``.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np

mpl.use("agg")
import matplotlib.pyplot as plt

from fusion import FusionConfig, FusionResult, fuse_flight, load_flight
from fusion.flight import Flight
from vision import Attitude, measure_frame
from vision.overlay import draw_overlay

FRAME = 120
ROOT = Path(__file__).resolve().parent.parent


def overlay(flight: Flight, frame: int) -> np.ndarray:
    """Draw one frame (RGB), measured with the attitude of its time."""
    image, t_ns = flight.frames.read(frame), flight.frames.t_ns[frame]
    attitude = None
    if flight.attitude is not None:
        nearest = np.abs(flight.attitude.t_ns - t_ns).argmin()
        attitude = Attitude.from_quaternion(flight.attitude.q_world_body[nearest])
    drawn = draw_overlay(image, flight.camera, measure_frame(image, flight.camera, attitude))
    return cv2.cvtColor(drawn, cv2.COLOR_BGR2RGB)


def main() -> None:
    """Fuse the sample flight and draw it."""
    flight = load_flight(ROOT / "data" / "office")
    result: FusionResult = fuse_flight(flight, FusionConfig(corridor_width_m=2.2))
    start = flight.frames.t_ns[0]

    def seconds(t_ns: np.ndarray) -> np.ndarray:
        return np.asarray((t_ns - start) / 1e9)

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), width_ratios=(1, 1.6), layout="constrained")
    left.imshow(overlay(flight, FRAME))
    left.set_axis_off()

    estimates, frames = result.estimates[result.estimates["status"] != "initialising"], result.frames
    t, heading = seconds(estimates["timestamp_ns"]), np.degrees(estimates["heading_rad"])
    band = 2 * np.degrees(estimates["heading_std_rad"])
    used = frames[frames["accepted"]]
    right.plot(
        seconds(used["timestamp_ns"]), np.degrees(used["heading_rad"]), ".", color="#56b4e9", label="frames"
    )
    right.fill_between(
        t, heading - band, heading + band, color="#d55e00", alpha=0.25, label="filter, 2 sigma"
    )
    right.plot(t, heading, color="#d55e00", label="filter")
    if flight.truth is not None:
        truth = flight.truth
        right.plot(seconds(truth.t_ns), np.degrees(truth.heading_rad), "k--", linewidth=0.8, label="truth")
    right.axvline(seconds(flight.frames.t_ns[FRAME]), color="0.7", linewidth=0.8, zorder=0)
    right.set(xlabel="time, s", ylabel="heading, degrees right")
    right.legend(frameon=False)
    right.spines[["top", "right"]].set_visible(False)
    figure.savefig(ROOT / "docs" / "office.png", dpi=110, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
