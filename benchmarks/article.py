"""The article against its own figures, and its method against flights whose heading is known.

``python benchmarks/article.py`` recomputes the article's figures from ``data/article``.
``python benchmarks/article.py --flights [FLIGHT ...]`` measures the article's method on flights instead: its
signed heading against the truth, beside always answering 0. Nothing here is tuned.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.estimator.tables import Table
from fusion.evaluation.errors import mae, rmse
from fusion.flight import FrameStream
from vision import Attitude, Camera
from vision.images import GreyImage
from vision.paper.measure import equation_8, measure_paper
from vision.rotations import yaw_of

FloatArray = npt.NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]
ARTICLE = ROOT / "data" / "article"
TABLE_2_PRINTED = {"grid": "RMSE 1.208891, MAE 0.521667", "kmeans": "RMSE 0.072572, MAE 0.066667"}
PRINT_TOLERANCE_DEG = 0.06  # the printed coordinates and yaws carry two decimals
SIZES_PX = ((640, 480), (320, 240), (256, 256))
# The vehicle's own yaw is the reference where a flight has no truth, less one constant per stretch of frames:
# its zero is not the corridor's axis. Beyond frame 41 the vehicle turns into another corridor.
STRETCHES = {"mononav_hallway": slice(0, 42)}


def load_rows(name: str) -> Table:
    """Read one of the CSV files of ``data/article`` as a structured array."""
    return np.genfromtxt(ARTICLE / name, delimiter=",", names=True, dtype=None, encoding="utf-8")


def computed_yaw_deg(rows: Table) -> FloatArray:
    """Equation (8) at the rows' printed vanishing points, degrees."""
    yaw_rad = equation_8(rows["vp_x_px"], rows["vp_y_px"], rows["width_px"], rows["height_px"])
    return np.degrees(yaw_rad)


def misprinted(rows: Table) -> npt.NDArray[np.bool_]:
    """Table whose printed yaw does not follow from their printed vanishing point."""
    off = np.abs(computed_yaw_deg(rows) - rows["paper_yaw_deg"])
    return np.asarray(off > PRINT_TOLERANCE_DEG, dtype=np.bool_)


def truncate(value: float) -> float:
    """Cut to two decimals, as the article prints (the guard keeps 0.29 from becoming 0.28)."""
    return math.floor(value * 100 + 1e-9) / 100


def figure_errors(rows: Table, figure: int) -> tuple[float, float]:
    """RMSE and MAE of one figure's printed yaws against its actual ones, equations (9) and (10), degrees."""
    mine = rows[rows["figure"] == figure]
    printed, actual = mine["paper_yaw_deg"], mine["actual_yaw_deg"]
    return rmse(printed, actual), mae(printed, actual)


def overall_errors(tables: Table, column: str) -> tuple[float, float, float]:
    """Mean of the printed figures towards the left, towards the right, and of these two, as the article."""
    left, right = (float(np.mean(tables[column][tables["toward"] == side])) for side in ("left", "right"))
    return left, right, (left + right) / 2


def print_article() -> None:
    """Print how the printed yaws compare with equation 8."""
    rows, tables = load_rows("frames.csv"), load_rows("tables.csv")
    computed, wrong = computed_yaw_deg(rows), misprinted(rows)
    print(f"Equation 8 at the {len(rows)} printed vanishing points")
    print(
        f"  within {PRINT_TOLERANCE_DEG} degrees of the printed yaw: {np.sum(~wrong)}"
        f" (worst of these {np.abs(computed - rows['paper_yaw_deg'])[~wrong].max():.3f})"
    )
    print(f"  errors in print: {np.sum(wrong)}")
    print("    figure  row  printed  computed  actual (degrees)")
    for row, yaw in zip(rows[wrong], computed[wrong], strict=True):
        actual, printed = row["actual_yaw_deg"], row["paper_yaw_deg"]
        print(f"    {row['figure']:>6}  {row['frame']:>3}  {printed:>7.2f}  {yaw:>8.2f}  {actual:>6.2f}")
    side = np.where(rows["vp_x_px"] < rows["width_px"] / 2, "right", "left")
    agree = np.sum(side == rows["toward"])
    print(f"  rows whose vanishing point lies on the side that 'toward' needs (right: left half): {agree}")

    print("\nPrinted yaw against actual yaw, degrees")
    print("  figure  image      toward  frames    RMSE  cut  printed     MAE  cut  printed")
    for line in tables:
        e_rms, e_abs = figure_errors(rows, int(line["figure"]))
        size = f"{line['width_px']}x{line['height_px']}"
        print(
            f"  {line['figure']:>6}  {size:<9}  {line['toward']:<6}  {line['frames']:>6}"
            f"  {e_rms:.4f} {truncate(e_rms):.2f}     {line['rmse_deg']:.2f}"
            f"  {e_abs:.4f} {truncate(e_abs):.2f}     {line['mae_deg']:.2f}"
        )
    for name, column, printed_as in (("RMSE", "rmse_deg", "0.29"), ("MAE", "mae_deg", "0.24")):
        left, right, both = overall_errors(tables, column)
        means = f"left {left:.3f}, right {right:.3f}, both {both:.3f}"
        print(f"  overall {name}, mean of means: {means} (printed {printed_as})")
    printed, actual = rows["paper_yaw_deg"], rows["actual_yaw_deg"]
    print(f"  all rows at once: RMSE {rmse(printed, actual):.4f}, MAE {mae(printed, actual):.4f}")
    print_table_2()


def print_table_2() -> None:
    """Print table 2 beside what is computed anew."""
    table = load_rows("table_2.csv")
    print("\nTable 2, degrees")
    for method, printed in TABLE_2_PRINTED.items():
        mine = table[table["method"] == method]
        computed, actual = mine["computed_yaw_deg"], mine["actual_yaw_deg"]
        print(
            f"  {method:<6}  RMSE {rmse(computed, actual):.6f}, MAE {mae(computed, actual):.6f}"
            f", mean of signed errors {np.mean(computed - actual):.6f}  (printed: {printed})"
        )
    print(
        "  The MAE printed for the grid method is its mean of signed errors; the mean absolute one is larger."
    )


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Frames of a flight whose heading is known.

    Parameters
    ----------
    frames
        Pictures (n,).
    heading_rad
        Known heading (n,).
    less_constant
        Whether the heading is known up to one constant only, which is then taken out of the errors.
    camera
        The flight's camera; for the geometric method only.
    attitudes
        The vehicle's roll and pitch (n,), where it knows them; likewise.
    """

    frames: FrameStream
    heading_rad: FloatArray
    less_constant: bool
    camera: Camera
    attitudes: tuple[Attitude | None, ...]

    def errors_rad(self, heading_rad: FloatArray) -> FloatArray:
        """Errors (n,) of measured headings, NaN where there is none."""
        error = heading_rad - self.heading_rad
        return error - np.nanmean(error) if self.less_constant else error


def reference_of(folder: Path) -> Reference | None:
    """Load a flight's known headings; None where it has none."""
    from fusion.evaluation.errors import interpolate_truth
    from fusion.logs import load_flight

    flight = load_flight(folder)
    t_ns, stream = flight.frames.t_ns, flight.attitude
    if flight.truth is not None:
        at = interpolate_truth(flight.truth, t_ns)
        frames = np.flatnonzero(at.known & ~at.in_junction)
        heading_rad = at.heading_rad[frames]
    elif folder.name in STRETCHES and stream is not None:
        frames = np.arange(len(t_ns))[STRETCHES[folder.name]]
        heading_rad = np.interp(t_ns[frames], stream.t_ns, np.unwrap(yaw_of(stream.q_world_body)))
    else:
        return None
    attitudes: tuple[Attitude | None, ...] = (None,) * len(frames)
    if stream is not None:
        nearest = [int(np.abs(stream.t_ns - t).argmin()) for t in t_ns[frames]]
        attitudes = tuple(Attitude.from_quaternion(stream.q_world_body[i]) for i in nearest)
    return Reference(
        flight.frames.chosen(frames), heading_rad, flight.truth is None, flight.camera, attitudes
    )


def pictures(reference: Reference, size_px: tuple[int, int]) -> Iterator[GreyImage]:
    """Read the frames at one size."""
    import cv2

    for index in range(len(reference.frames.t_ns)):
        image = reference.frames.read(index)
        if image.shape[::-1] != size_px:
            image = np.asarray(cv2.resize(image, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        yield image


def measure_all(
    reference: Reference, size_px: tuple[int, int], *, seed: int = 0, kernel_feeds_canny: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Signed headings (n,) of the article's method, NaN without a vanishing point, and milliseconds (n,)."""
    found = [
        measure_paper(image, seed=seed, kernel_feeds_canny=kernel_feeds_canny)
        for image in pictures(reference, size_px)
    ]
    return np.array([m.heading_rad for m in found]), np.array([m.vision_ms for m in found])


def measure_geometric(reference: Reference, size_px: tuple[int, int]) -> FloatArray:
    """Headings (n,) of the default method, each frame on its own; NaN where it rejects a frame."""
    from vision import measure_frame

    camera = reference.camera.resized(*size_px)
    found = [
        measure_frame(image, camera, attitude)
        for image, attitude in zip(pictures(reference, size_px), reference.attitudes, strict=True)
    ]
    return np.array([m.heading_rad if m.accepted else np.nan for m in found])


def slope(measured: FloatArray, known: FloatArray) -> float:
    """How far the measured heading moves for each degree that the true one moves, by least squares."""
    both = np.isfinite(measured)
    centred = known[both] - known[both].mean()
    return float(centred @ measured[both] / (centred @ centred))


def print_flights(folders: Sequence[Path]) -> None:
    """Print the article's method on flights."""
    print("The article's method on flights: signed heading against the truth, degrees.")
    print("  slope: degrees it moves per true degree    seeds: RMS change from one k-means seed to another")
    print("  no kernel: RMSE of the article read the other way, Canny seeing the contrast-enhanced picture")
    print(
        "  geometric: RMSE of the default method on the same frames, each on its own, and how many it rejects"
    )
    for folder in folders:
        reference = reference_of(folder)
        if reference is None:
            print(f"\n{folder}: no heading to compare with")
        else:
            print_flight(f"{folder.parent.name}/{folder.name}", reference)


def print_flight(name: str, reference: Reference) -> None:
    """Print one flight's row."""

    def rms_deg(x: FloatArray) -> float:
        return math.degrees(math.sqrt(np.nanmean(x**2)))

    against = "the vehicle's own yaw less one constant" if reference.less_constant else "corridor_truth"
    zero = reference.errors_rad(np.zeros(len(reference.heading_rad)))
    print(f"\n{name}: {len(reference.heading_rad)} frames against {against}")
    print(f"  always 0: RMSE {rms_deg(zero):.2f}, median {math.degrees(np.median(np.abs(zero))):.2f}")
    print("  image    no vp   RMSE  median  worst  slope  seeds  no kernel  ms (median)  geometric  rejected")
    for size_px in SIZES_PX:
        heading, ms = measure_all(reference, size_px)
        other_start, _ = measure_all(reference, size_px, seed=1)
        no_kernel, _ = measure_all(reference, size_px, kernel_feeds_canny=False)
        geometric = measure_geometric(reference, size_px)
        error = reference.errors_rad(heading)
        # A heading that hardly changes has no slope to speak of.
        moves = "-" if reference.less_constant else f"{slope(heading, reference.heading_rad):.2f}"
        size = f"{size_px[0]}x{size_px[1]}"
        print(
            f"  {size:<7}  {np.isnan(heading).sum():>5}  {rms_deg(error):>5.2f}"
            f"  {math.degrees(np.nanmedian(np.abs(error))):>6.2f}"
            f"  {math.degrees(np.nanmax(np.abs(error))):>5.1f}"
            f"  {moves:>5}  {rms_deg(heading - other_start):>5.2f}"
            f"  {rms_deg(reference.errors_rad(no_kernel)):>9.2f}  {np.median(ms):>11.1f}"
            f"  {rms_deg(reference.errors_rad(geometric)):>9.2f}  {np.isnan(geometric).sum():>8}"
        )


def default_flights() -> list[Path]:
    """``data/office`` and the other flights shared beside the repository, as far as they are there."""
    shared = ROOT.parent / "shared" / "flights"
    beside = sorted(shared.iterdir()) if shared.is_dir() else []
    found = {"office": ROOT / "data" / "office"}
    for folder in beside:
        found.setdefault(folder.name, folder)
    return [folder for folder in found.values() if (folder / "mav0").is_dir()]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the article's figures, or its method on flights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", nargs="*", type=Path, metavar="FLIGHT", help="measure on flight folders")
    options = parser.parse_args(arguments)
    if options.flights is None:
        print_article()
    else:
        print_flights(options.flights or default_flights())
    return 0


if __name__ == "__main__":
    sys.exit(main())
