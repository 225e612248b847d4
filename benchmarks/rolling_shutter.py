"""What a rolling shutter costs while the vehicle turns, and what is left once rows are corrected by the gyroscope.

``python benchmarks/rolling_shutter.py`` draws simulated corridors row by row as a camera sees them that is read in 20
and in 33 ms while it yaws, and measures every picture twice: taken for a global shutter's, and with ``line_delay`` in
the camera and the rate of a gyroscope (off by its bias and noise). The truth is that of the middle row.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from math import ceil, degrees, radians
from typing import Annotated

import cv2
import numpy as np
import typer

from fusion.simulate import office_views
from support.cases import SIMULATED_FOV_RAD, Case, Result, Size, case_of_view, score
from support.scores import heading_score, number, offset_score, percent, table
from vision import Camera, Prior, extract_lines, measure_lines

SIZE: Size = (640, 480)
READOUTS_S = (0.020, 0.033)
RATES_DEG_S = (0.0, 15.0, 30.0, 60.0, 120.0)
VIEWS = 60
GYRO_ERROR_RAD_S = radians(1.0)
SEED = 12


def drawn(rate_deg_s: float, readout_s: float, n: int) -> list[Case]:
    """Draw views of one yaw rate, to either side in turn, with the camera that took them."""
    camera = replace(Camera.from_fov(*SIZE, SIMULATED_FOV_RAD), line_delay_s=readout_s / SIZE[1])
    cases: list[Case] = []
    for side, share in ((1.0, ceil(n / 2)), (-1.0, n // 2)):
        rate = side * radians(rate_deg_s)
        for view in office_views(camera, share, SEED, yaw_rate_rad_s=rate, views_per_scene=6):
            cases.append(case_of_view(view, f"{side * rate_deg_s:g}", len(cases), camera))
    return cases


def measured(cases: Sequence[Case], corrected: bool) -> list[Result]:
    """Measure views, their rows corrected by a gyroscope or taken for those of one moment."""
    rng = np.random.default_rng(SEED)
    results = []
    for case in cases:
        p, q, r = rng.normal((0.0, 0.0, radians(float(case.source))), GYRO_ERROR_RAD_S).tolist()
        prior = Prior(body_rates_rad_s=(p, q, r) if corrected else None)
        lines = extract_lines(case.image, case.camera)
        results.append(score(case, measure_lines(lines, case.camera, case.attitude, prior)))
    return results


def main(
    quick: Annotated[bool, typer.Option("--quick", help="A tenth of the views.")] = False,
    every: Annotated[int, typer.Option(min=1, help="Draw so many times fewer views.")] = 1,
) -> None:
    """Print the heading's error against the yaw rate, with and without the correction."""
    cv2.setNumThreads(1)
    rows: list[tuple[str, ...]] = []
    for readout_s in READOUTS_S:
        for rate in RATES_DEG_S:
            if sys.stderr.isatty():
                print(f"\r{1e3 * readout_s:.0f} ms, {rate:g} deg/s\x1b[K", end="", file=sys.stderr)
            cases = drawn(rate, readout_s, max(2, VIEWS // (10 * every if quick else every)))
            cells = [f"{1e3 * readout_s:.0f} ms", f"{rate:g}", number(degrees(radians(rate) * readout_s))]
            for corrected in (False, True):
                results = measured(cases, corrected)
                heading, offset = heading_score(results), offset_score(results)
                cells += [percent(heading.accepted), number(heading.rmse, 3), number(heading.worst)]
                cells += [number(heading.sigma_p90), number(offset.rmse)]
            rows.append(tuple(cells))
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr)
    print(
        "Simulated corridors seen by a rolling shutter while yawing; heading in degrees, offset in % of the width"
    )
    one = ("accepted", "RMSE", "worst", "|e|/s p90", "offset")
    print(
        table(
            (
                "readout",
                "deg/s",
                "turned",
                *(f"as global: {one[0]}", *one[1:]),
                *(f"by gyro: {one[0]}", *one[1:]),
            ),
            rows,
        )
    )


if __name__ == "__main__":
    typer.run(main)
