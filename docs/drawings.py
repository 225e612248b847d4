"""Draw the figures of README and documentation into ``docs/img``.

Run it in the repository's folder: ``.venv/bin/python docs/drawings.py``. The same drawings come out every time.
"""

from __future__ import annotations

from math import cos, radians, sin
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("svg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, FancyBboxPatch, Polygon

from fusion import FusionConfig, fuse_flight, load_flight
from fusion.flight import Flight
from vision import LineClass, measure_frame

ROOT = Path(__file__).resolve().parent.parent
IMG = ROOT / "docs" / "img"
BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8a929a"
mpl.rcParams.update(
    {"svg.fonttype": "none", "svg.hashsalt": "corridor", "font.size": 11, "font.family": "sans-serif"}
)


def save(figure: Figure, name: str) -> None:
    """Write a figure; no date, so that the file changes only with the drawing."""
    figure.savefig(IMG / name, facecolor="white", metadata={"Date": None})
    plt.close(figure)


def arrow(
    ax: Axes, start: tuple[float, float], end: tuple[float, float], colour: str, style: str = "-|>"
) -> None:
    """Draw an arrow between two points."""
    ax.annotate(
        "", end, start, arrowprops={"arrowstyle": style, "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 0}
    )


def vehicle(ax: Axes, x: float, y: float, heading_rad: float, size: float) -> None:
    """Draw a vehicle seen from above: up is along the corridor, right is right."""
    outline = size * np.array([[0.0, 1.0], [0.62, -0.8], [0.0, -0.45], [-0.62, -0.8]])
    c, s = cos(heading_rad), sin(heading_rad)
    ax.add_patch(Polygon(outline @ np.array([[c, -s], [s, c]]) + [x, y], closed=True, color=BLUE))


def signs() -> None:
    """Heading and offset from above, and what the camera sees."""
    figure, (top, view) = plt.subplots(1, 2, figsize=(9.6, 4.6), layout="constrained")
    turned, offset = radians(20), 0.45
    for wall in (-1.1, 1.1):
        top.plot([wall, wall], [-1.6, 3.4], color="black", lw=3)
    top.plot([0, 0], [-1.6, 3.4], color=GREY, ls=(0, (6, 4)), lw=1.2)
    top.text(-0.06, 3.2, "centre line", color=GREY, ha="right", fontsize=9)
    vehicle(top, offset, 0.0, turned, 0.3)
    arrow(top, (offset, 0), (offset, 2.0), GREY)
    arrow(top, (offset, 0), (offset + 2.0 * sin(turned), 2.0 * cos(turned)), BLUE)
    top.add_patch(Arc((offset, 0), 3.0, 3.0, theta1=90 - 20, theta2=90, color=ORANGE, lw=2))
    top.text(1.25, 1.45, "heading,\npositive turned right", color=ORANGE, va="center")
    arrow(top, (0, -0.6), (offset, -0.6), GREEN)
    top.text(1.25, -0.6, "lateral offset,\npositive right", color=GREEN, va="center")
    arrow(top, (-1.1, -1.35), (1.1, -1.35), GREY, "<|-|>")
    top.text(-0.55, -1.3, "width W", color=GREY, ha="center", va="bottom", fontsize=9)
    top.set_title("From above", loc="left", fontweight="bold")
    top.set(xlim=(-1.3, 3.4), ylim=(-1.7, 3.5), aspect="equal")

    vp = np.array([-0.42, 0.04])
    view.add_patch(Polygon([[-1, -0.75], [1, -0.75], [1, 0.75], [-1, 0.75]], fill=False, lw=2))
    corners = {
        "left": (-1.45, -0.75),
        "right": (0.1, -0.75),
        "up left": (-1.5, 0.75),
        "up right": (0.2, 0.75),
    }
    for end in corners.values():
        at = vp + 0.12 * (np.array(end) - vp)
        view.plot([at[0], end[0]], [at[1], end[1]], color=BLUE, lw=2)
    view.plot(*vp, "o", color=ORANGE, ms=9)
    view.annotate(
        "vanishing point", vp, (-0.9, 0.42), color=ORANGE, arrowprops={"arrowstyle": "-", "color": ORANGE}
    )
    view.plot(0, 0, "+", color="black", ms=14, mew=2)
    view.text(0.06, -0.1, "principal point")
    arrow(view, (0, 0.04), (vp[0] + 0.05, 0.04), GREY)
    view.text(0.0, -0.9, "Turned right: the vanishing point lies left.", ha="center")
    view.set_title("What the camera sees", loc="left", fontweight="bold")
    view.set(xlim=(-1.02, 1.02), ylim=(-1.0, 0.8), aspect="equal")
    for ax in (top, view):
        ax.axis("off")
    save(figure, "signs.svg")


def axes() -> None:
    """Body axes and what the accelerometer reads."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.4), layout="constrained")
    for ax, title, ups in (
        (left, "FRD, used here: x ahead, y right, z down", -1),
        (right, "FLU, as ROS has it: x ahead, y left, z up", 1),
    ):
        ax.add_patch(Polygon([[-0.5, -0.12], [0.4, -0.05], [0.5, 0.12], [-0.4, 0.05]], color="#cfd6dc"))
        arrow(ax, (0, 0), (1.25, 0.28), BLUE)
        ax.text(1.3, 0.25, "x ahead", color=BLUE)
        side = (0.6, -0.45) if ups < 0 else (-0.6, 0.45)
        arrow(ax, (0, 0), side, GREEN)
        ax.text(side[0] + (0.08 if ups < 0 else -0.08), side[1], "y right" if ups < 0 else "y left",
                color=GREEN, ha="left" if ups < 0 else "right")  # fmt: skip
        arrow(ax, (0, 0), (0, 0.95 * ups), ORANGE)
        ax.text(0.08, 0.85 * ups, "z down" if ups < 0 else "z up", color=ORANGE)
        reads = "(0, 0, -9.8)" if ups < 0 else "(0, 0, +9.8)"
        ax.text(
            -1.25,
            -0.75 * ups,
            f"level and at rest\nthe accelerometer reads\n{reads} m/s²",
            va="center",
            fontsize=10,
        )
        ax.set_title(title, loc="left", fontweight="bold", fontsize=11)
        ax.set(xlim=(-1.3, 1.9), ylim=(-1.15, 1.15), aspect="equal")
        ax.axis("off")
    save(figure, "axes.svg")


def box(
    ax: Axes, x: float, y: float, text: str, colour: str, width: float = 1.5, height: float = 0.62
) -> None:
    """Draw a box with text about a point."""
    corner = (x - width / 2, y - height / 2)
    ax.add_patch(
        FancyBboxPatch(
            corner, width, height, boxstyle="round,pad=0.02,rounding_size=0.08", fc="white", ec=colour, lw=2
        )
    )
    ax.text(x, y, text, ha="center", va="center", fontsize=10)


def status() -> None:
    """Draw the four words of the status, and what leads from one to another."""
    figure, ax = plt.subplots(figsize=(9.6, 2.7), layout="constrained")
    places = {"initialising": 0.0, "tracking": 2.9, "coasting": 5.8, "lost": 8.7}
    colours = {"initialising": GREY, "tracking": BLUE, "coasting": "#e69f00", "lost": ORANGE}
    for word, x in places.items():
        box(ax, x, 0.0, word, colours[word])
    moves = (
        ("initialising", "tracking", 0.12, "frames agree"),
        ("tracking", "coasting", 0.12, "no frame used"),
        ("coasting", "lost", 0.12, "for 10 s, or\nsigma > 10°"),
        ("coasting", "tracking", -0.12, "a frame is used"),
    )
    for a, b, lift, words in moves:
        way = 0.78 if places[b] > places[a] else -0.78
        arrow(ax, (places[a] + way, lift), (places[b] - way, lift), "black")
        middle = (places[a] + places[b]) / 2
        ax.text(middle, lift + (0.08 if lift > 0 else -0.08), words, ha="center",
                va="bottom" if lift > 0 else "top", fontsize=9)  # fmt: skip
    ax.plot([8.7, 8.7, 2.9, 2.9], [-0.33, -0.85, -0.85, -0.42], color="black", lw=2)
    arrow(ax, (2.9, -0.5), (2.9, -0.33), "black")
    ax.text(5.8, -0.8, "frames agree again", ha="center", va="bottom", fontsize=9)
    ax.set(xlim=(-0.9, 9.6), ylim=(-1.0, 0.75))
    ax.axis("off")
    save(figure, "status.svg")


def hypotheses() -> None:
    """One picture leaves places open; motion and time settle them."""
    figure, panels = plt.subplots(1, 3, figsize=(9.6, 2.8), sharey=True, layout="constrained")
    y = np.linspace(-1, 1, 161)

    def bump(at: float, std: float, weight: float) -> np.ndarray:
        return np.asarray(weight * np.exp(-0.5 * ((y - at) / std) ** 2) / std)

    stories = (
        ("One picture: skirting or wall?", bump(0.2, 0.05, 0.45) + bump(-0.15, 0.05, 0.4), "unknown"),
        ("Some pictures later", bump(0.22, 0.05, 0.7) + bump(-0.05, 0.09, 0.25), "unknown"),
        ("Settled", bump(0.25, 0.04, 0.97), "known"),
    )
    for ax, (title, density, word) in zip(panels, stories, strict=True):
        ax.fill_between(y, density, color=PURPLE, alpha=0.35, lw=0)
        ax.plot(y, density, color=PURPLE)
        ax.set_title(title, loc="left", fontweight="bold", fontsize=10)
        ax.text(-0.95, 21, f"lateral_status: {word}", fontsize=9)
        ax.set(xlabel="offset, half widths right", ylim=(0, 25), yticks=[])
        ax.spines[["top", "right", "left"]].set_visible(False)
    save(figure, "hypotheses.svg")


def flow() -> None:
    """From picture and IMU sample to an estimate."""
    figure, ax = plt.subplots(figsize=(10.4, 4.4), layout="constrained")
    steps = {
        "picture": (0, 2.6, "picture", GREY),
        "lines": (2.1, 2.6, "lines.segments\nsub-pixel segments", BLUE),
        "axis": (4.5, 2.6, "axis: level, vote,\nvanishing point", BLUE),
        "lateral": (6.9, 2.6, "lateral: corners,\nregions", BLUE),
        "imu": (0, 0.9, "gyroscope,\naccelerometer,\nattitude", GREY),
        "timeline": (2.1, 0.9, "timeline\norder, replay", GREEN),
        "engine": (4.5, 0.9, "engine\nwhich part acts", GREEN),
        "parts": (6.9, 0.9, "EKF, junctions,\noffset hypotheses", GREEN),
        "estimate": (9.3, 0.9, "Estimate\nheading, offset,\nsigma, status", ORANGE),
        "smoother": (9.3, -0.7, "smoother, report,\ntables", ORANGE),
        "log": (0, -0.7, "log files", GREY),
        "readers": (2.1, -0.7, "fusion.logs\none reader a format", PURPLE),
    }
    for x, y, text, colour in steps.values():
        box(ax, x, y, text, colour, width=1.85, height=0.95)
    for a, b in (("picture", "lines"), ("lines", "axis"), ("axis", "lateral"), ("imu", "timeline"),
                 ("timeline", "engine"), ("engine", "parts"), ("parts", "estimate"), ("log", "readers")):  # fmt: skip
        arrow(ax, (steps[a][0] + 0.97, steps[a][1]), (steps[b][0] - 0.97, steps[b][1]), "black")
    arrow(ax, (9.3, 0.4), (9.3, -0.2), "black")
    arrow(ax, (2.1, -0.2), (2.1, 0.4), "black")
    ax.plot([6.9, 6.9, 2.6], [2.1, 1.75, 1.75], color="black", lw=2)
    arrow(ax, (2.6, 1.76), (2.6, 1.4), "black")
    ax.text(4.75, 1.79, "FrameMeasurement", ha="center", va="bottom", fontsize=9)
    ax.text(-0.95, 3.25, "vision: one picture", color=BLUE, fontweight="bold")
    ax.text(3.0, 0.12, "fusion.estimator: every sample", color=GREEN, fontweight="bold")
    ax.set(xlim=(-1.1, 10.4), ylim=(-1.3, 3.5))
    ax.axis("off")
    save(figure, "flow.svg")


def office() -> None:
    """Draw what one frame of the sample flight shows, and what comes of all of them."""
    flight = load_flight(ROOT / "data" / "office")
    result = fuse_flight(flight, FusionConfig(corridor_width_m=2.2))
    if flight.truth is None or flight.imu is None:
        raise RuntimeError("the sample flight has a truth and an IMU")
    figure = plt.figure(figsize=(11, 4.2), layout="constrained")
    halves = figure.add_gridspec(1, 2, width_ratios=(1, 1.15))
    picture = figure.add_subplot(halves[0])
    curves = halves[1].subgridspec(2, 1)
    top, bottom = figure.add_subplot(curves[0]), figure.add_subplot(curves[1])
    _draw_frame(picture, flight, 120)

    estimates, truth = result.estimates[result.estimates["status"] != "initialising"], flight.truth
    t = (estimates["timestamp_ns"] - result.origin_ns) / 1e9
    true_heading = np.interp(estimates["timestamp_ns"], truth.t_ns, truth.heading_rad)
    top.plot(t, np.degrees(estimates["heading_rad"]), color=BLUE, lw=3, label="filter")
    top.plot(t, np.degrees(true_heading), color="black", lw=1, ls="--", label="truth")
    top.set(ylabel="heading,\ndegrees right", ylim=(-30, 42))
    top.legend(frameon=False, ncols=2, loc="upper left")
    imu = flight.imu
    turned = np.concatenate([[0.0], np.cumsum(imu.gyro_rad_s[:-1, 2] * np.diff(imu.t_ns) / 1e9)])
    gyro = turned - np.interp(imu.t_ns, truth.t_ns, truth.heading_rad - truth.heading_rad[0])
    bottom.plot((imu.t_ns - result.origin_ns) / 1e9, np.degrees(gyro), color=ORANGE, label="gyroscope alone")
    error = np.degrees(estimates["heading_rad"] - true_heading)
    bottom.plot(t, error, color=BLUE, lw=2, label="filter")
    bottom.set(xlabel="time, s", ylabel="heading error,\ndegrees", ylim=(-16, 4))
    bottom.legend(frameon=False, loc="lower left")
    for ax in (top, bottom):
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(IMG / "office.png", dpi=100, pil_kwargs={"optimize": True})
    plt.close(figure)


def _draw_frame(ax: Axes, flight: Flight, k: int) -> None:
    """Draw a frame with its lines along the corridor and the vanishing point."""
    image = flight.frames.read(k)
    found = measure_frame(image, flight.camera)
    ax.imshow(image, cmap="gray", alpha=0.75)
    if found.lines_px is not None:
        for x0, y0, x1, y1 in found.lines_px[found.line_class == LineClass.CORRIDOR]:
            ax.plot([x0, x1], [y0, y1], color="#56b4e9", lw=2)
    for line in () if found.wall_lines_px is None else found.wall_lines_px:
        ax.plot(line[[0, 2]], line[[1, 3]], color="#f0e442", lw=3)
    ax.plot(*found.vp_px, "o", mec=ORANGE, mfc="none", mew=3, ms=14)
    side = "right" if found.heading_rad > 0 else "left"
    ax.set_title(f"turned {side} by {abs(np.degrees(found.heading_rad)):.1f} degrees", loc="left")
    ax.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0))
    ax.axis("off")


def main() -> None:
    """Draw everything."""
    IMG.mkdir(exist_ok=True)
    for draw in (signs, axes, status, hypotheses, flow, office):
        draw()


if __name__ == "__main__":
    main()
