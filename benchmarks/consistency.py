"""How good the estimator is against an oracle and against other filters, and whether its sigmas are honest.

    python benchmarks/consistency.py [--runs 150] [--seconds 120]

Simulated flights: 80 ms of delay, gyroscope 0.0075 rad/s/sqrt(Hz) with a walking bias, 30 frames a second of 0.3 to
1 degree whose errors correlate from frame to frame, 5 % of them gross, drop-outs to 5 s, an IMU yaw that steel turns
by 10 to 20 degrees, tilt to 15 degrees. The oracle is a Kalman filter written apart from the product: it is told the
true noise of every sensor, the correlation of the frames' errors and which of them are gross. It sees no IMU yaw; a
filter that does may be better. All see the same samples, when they arrive; errors count from 2 s on, every 50 ms.
Nothing is asserted: what is asked stands beside what is measured.

The camera's delay is estimated in flights that turn more, whose frames are stamped 80 ms late, with 60 +- 30 told.

A fifth of the runs is used there and where two settings are compared, a tenth with the filters of `ahrs`, which take
seconds for each. `imufusion` and `ahrs` are used where they are installed (pip install corridor-fusion[bench]).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from support.flown import (
    EVERY_S,
    SETTLED_S,
    Flown,
    fly,
    recovery_s,
    scene_of,
    settings,
    simulate,
    stamped_late,
)
from support.heading_peers import PEERS, SLOW_PEERS, heading_error, installed
from support.oracle import oracle
from support.scores import table
from tests.fusion.simulated import weaving

FloatArray = npt.NDArray[np.float64]

BAND = 0.99
RECOVERIES = 100
TURNS_RAD, TURNS_S = np.radians(30), 5.0  # the delay shows in turns; these reach 15 to 40 deg/s
STAMPED_LATE_S, TOLD_LATE_S, TOLD_LATE_STD_S = 0.08, 0.06, 0.03


def rms(parts: Sequence[FloatArray]) -> float:
    """Root mean square of all numbers that are there."""
    joined = np.concatenate(parts)
    return float(np.sqrt(np.nanmean(joined**2)))


def worst(parts: Sequence[FloatArray]) -> float:
    """Greatest absolute value."""
    return float(max(np.nanmax(np.abs(part)) for part in parts))


def in_band(nees: FloatArray) -> float:
    """Share of the times at which the mean over all runs, nees (runs, times), lies in the chi-square band."""
    nees = nees[:, np.isfinite(nees).any(axis=0)]
    n = np.isfinite(nees).sum(axis=0)  # of runs in which there is an estimate
    low, high = (chi2.ppf(share, n) / n for share in ((1 - BAND) / 2, (1 + BAND) / 2))
    mean = np.nanmean(nees, axis=0)
    return float(((mean >= low) & (mean <= high)).mean())


def nees(errors: Sequence[FloatArray], stds: Sequence[FloatArray]) -> FloatArray:
    """Squared error over variance, (runs, times)."""
    n = min(len(e) for e in errors)
    return np.array([(e[:n] / s[:n]) ** 2 for e, s in zip(errors, stds, strict=True)])


class Runs:
    """The main setting: errors of the estimator, the oracle and the peers, run by run."""

    def __init__(self, count: int, slow: int, seconds: float) -> None:
        self.flown: list[Flown] = []
        self.others: dict[str, list[FloatArray]] = {}
        for seed in range(count):
            simulated = simulate(scene_of(seed, seconds))
            flown = fly(simulated, settings(simulated.scene))
            self.flown.append(flown)
            peers = {"oracle": oracle} | PEERS
            for name, (package, peer) in SLOW_PEERS.items():
                if installed(package) and (seed < slow or package == "imufusion"):
                    peers[name] = peer
            for name, peer in peers.items():
                error = heading_error(simulated, flown.t_s, peer(simulated, flown.t_s))
                self.others.setdefault(name, []).append(error)

    def print_peers(self) -> None:
        """Everything that gives a heading, on the same data."""
        ours = {"corridor-fusion, smoother": [f.smoothed for f in self.flown]}
        ours["corridor-fusion, filter"] = [f.heading for f in self.flown]
        rows = []
        for name, errors in (ours | self.others).items():
            same = ours["corridor-fusion, filter"][: len(errors)]
            ratio = rms(errors) / rms(same)
            numbers = (f"{np.degrees(rms(errors)):.3f}", f"{np.degrees(worst(errors)):.2f}", f"{ratio:.2f}")
            rows.append((name, str(len(errors)), *numbers))
        rows += [
            (name, "-", "-", "-", f"skipped: {package} is not installed")
            for name, (package, _) in SLOW_PEERS.items()
            if name not in self.others
        ]
        print("\nHeading, degrees; over the filter's RMSE in the same runs")
        print(table(("", "runs", "RMSE", "worst", "over filter"), rows))

    def rows(self) -> list[tuple[str, str, str]]:
        """Set what is asked of one setting beside what is measured."""
        heading, std = [f.heading for f in self.flown], [f.heading_std for f in self.flown]
        lateral, lateral_std = [f.lateral for f in self.flown], [f.lateral_std for f in self.flown]
        smoothed, smoothed_std = [f.smoothed for f in self.flown], [f.smoothed_std for f in self.flown]
        h, y = nees(heading, std), nees(lateral, lateral_std)
        s = nees(smoothed, smoothed_std)
        over_lateral = rms([f.lateral_smoothed for f in self.flown]) / rms(lateral)
        return [
            ("filter RMSE over oracle's", "<= 1.05", f"{rms(heading) / rms(self.others['oracle']):.3f}"),
            ("smoother RMSE over filter's, heading", "<= 0.60", f"{rms(smoothed) / rms(heading):.3f}"),
            ("the same, lateral offset", "", f"{over_lateral:.3f}"),
            ("mean NEES, heading", "0.92 to 1.08", f"{h.mean():.3f}"),
            ("mean NEES, lateral offset", "0.92 to 1.08", f"{np.nanmean(y):.3f}"),
            ("mean NEES, smoothed heading", "", f"{s.mean():.3f}"),
            ("heading within the 99 % band, % of time", ">= 95", f"{100 * in_band(h):.1f}"),
            ("lateral within the 99 % band, % of time", ">= 95", f"{100 * in_band(y):.1f}"),
            ("lateral offset known, % of time", "", f"{100 * np.isfinite(y).mean():.1f}"),
            ("worst heading error, degrees", "< 3", f"{np.degrees(worst(heading)):.2f}"),
            ("the oracle's, degrees", "", f"{np.degrees(worst(self.others['oracle'])):.2f}"),
        ]


def filter_rms(count: int, seconds: float, config: dict[str, Any] | None = None, **scene: Any) -> float:
    """Heading RMSE of the filter in a setting, radians."""
    errors = []
    for seed in range(count):
        simulated = simulate(scene_of(seed, seconds, **scene))
        errors.append(fly(simulated, settings(simulated.scene, **(config or {})), smooth=False).heading)
    return rms(errors)


def oracle_rms(count: int, seconds: float, **scene: Any) -> float:
    """Heading RMSE of the oracle in a setting, radians."""
    errors = []
    for seed in range(count):
        simulated = simulate(scene_of(seed, seconds, **scene))
        t_s = np.arange(SETTLED_S, seconds, EVERY_S)
        errors.append(heading_error(simulated, t_s, oracle(simulated, t_s)))
    return rms(errors)


def comparisons(count: int, seconds: float, as_it_is: float, by_oracle: float) -> list[tuple[str, str, str]]:
    """Ratios of two settings; ``as_it_is`` and ``by_oracle`` are the RMSE of filter and oracle in these runs."""
    gross, gross_oracle = filter_rms(count, seconds, gross=0.5), oracle_rms(count, seconds, gross=0.5)
    never = filter_rms(count, seconds, {"imu_yaw_use": "never"})
    shared = filter_rms(count, seconds, yaw_shares_gyro=True)
    default = filter_rms(count, seconds, {"heading_correlation_s": 0.03})
    return [
        ("filter without IMU yaw over oracle", "<= 1.05", f"{never / by_oracle:.3f}"),
        ("RMSE with 50 % gross over that with 5 %", "<= 1.10", f"{gross / as_it_is:.3f}"),
        ("the oracle's own ratio there", "", f"{gross_oracle / by_oracle:.3f}"),
        ("shared-gyro AHRS over leaving it out", "<= 1.05", f"{shared / never:.3f}"),
        ("independent IMU yaw over leaving it out", "", f"{as_it_is / never:.3f}"),
        ("correlation as by default over told", "", f"{default / as_it_is:.3f}"),
    ]


def delays(count: int, seconds: float) -> list[tuple[str, str, str]]:
    """Estimate the delay of frames that are stamped later than the filter is told."""
    flown = []
    for seed in range(count):
        scene = scene_of(seed, seconds, heading=weaving(seed, TURNS_RAD, TURNS_S))
        simulated = stamped_late(simulate(scene), STAMPED_LATE_S)
        config = settings(simulated.scene, camera_delay_s=TOLD_LATE_S, camera_delay_std_s=TOLD_LATE_STD_S)
        flown.append(fly(simulated, config, smooth=False))
    found, std = np.array([f.camera_delay_s for f in flown]).T
    ratio = float(np.mean(((found - STAMPED_LATE_S) / std) ** 2))
    heading = nees([f.heading for f in flown], [f.heading_std for f in flown])
    told = f"{1e3 * TOLD_LATE_S:.0f} +- {1e3 * TOLD_LATE_STD_S:.0f}"
    error = rms([found - STAMPED_LATE_S])
    return [
        (
            f"camera's delay told as {told} ms, found, ms",
            f"{1e3 * STAMPED_LATE_S:.0f}",
            f"{1e3 * found.mean():.1f}",
        ),
        ("the same, RMSE and mean sigma, ms", "", f"{1e3 * error:.1f}, {1e3 * std.mean():.1f}"),
        ("the same, mean NEES", "0.5 to 1.5", f"{ratio:.2f}"),
        ("mean NEES, heading, while the delay is found", "0.92 to 1.08", f"{heading.mean():.3f}"),
    ]


def recoveries(count: int) -> list[tuple[str, str, str]]:
    """Seconds of good frames until an injected error is gone."""
    rows = []
    for name, by_gyro in (("error of 30 to 90 deg in the state", False), ("the same by the gyroscope", True)):
        times = np.array([recovery_s(seed, by_gyro) for seed in range(count)])
        found = f"median {np.median(times):.2f}, worst {times.max():.2f}, later {int((times > 0.5).sum())} of {count}"
        rows.append((f"{name}, s", "<= 0.5", found))
    return rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=150, help="of the main setting (default: 150)")
    parser.add_argument("--seconds", type=float, default=120.0, help="length of a run (default: 120)")
    options = parser.parse_args()
    started = perf_counter()
    n, seconds = max(options.runs, 1), max(options.seconds, SETTLED_S + 20.0)
    fewer, few = max(n // 5, 1), max(n // 10, 1)
    runs = Runs(n, few, seconds)
    print(f"{n} runs of {seconds:g} s; comparisons of settings over the first {fewer}")
    as_it_is = rms([f.heading for f in runs.flown[:fewer]])
    by_oracle = rms(runs.others["oracle"][:fewer])
    compared = comparisons(fewer, seconds, as_it_is, by_oracle)
    rows = [*runs.rows(), *compared, *delays(fewer, seconds), *recoveries(min(RECOVERIES, n))]
    print(table(("", "asked", "measured"), rows))
    runs.print_peers()
    print(f"\ntook {perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
