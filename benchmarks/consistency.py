"""How good the estimator is against an oracle, and whether its sigmas are honest: simulated flights.

The oracle is a Kalman filter written here, apart from the product: it is told the true noise of every sensor, the
correlation of the frames' errors and which of them are gross, and sees no steps of the IMU's yaw. Both must wait for
delayed frames alike. Ratios and NEES are printed; nothing is asserted.

    python benchmarks/consistency.py [--runs 12] [--seconds 60]
"""

from __future__ import annotations

import argparse
import sys
from math import degrees, radians
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from fusion.models import PSI
from fusion.smoother import Steps, rts
from tests.fusion.simulated import (
    Scene,
    Simulated,
    config_for,
    drifting,
    give,
    plus,
    simulate,
    turning,
    weaving,
    wrap,
)

EVERY_S = 0.05


def scene_of(seed: int, seconds: float, **changes: Any) -> Scene:
    """Make a flight: 80 ms delay, 30 frames a second of 0.3 to 1 degree, 5 % gross, drop-outs to 5 s, tilt to 15."""
    rng = np.random.default_rng(seed)
    starts = np.arange(8.0, seconds - 8.0, 15.0)
    dropouts = [(float(s), float(s + rng.uniform(1.0, 5.0))) for s in starts]
    values: dict[str, Any] = {
        "duration_s": seconds,
        "seed": seed,
        "heading": weaving(seed, radians(rng.uniform(5, 25)), rng.uniform(4, 10)),
        "tilt_rad": radians(15),
        "gyro_bias": float(rng.normal(0, 0.01)),
        "gross": 0.05,
        "delay_s": 0.08,
        "dropouts": dropouts,
        "attitude_hz": 50.0,
        "lateral": drifting(seed, 0.3 / 1.1, 1.0, seconds),
    }
    return Scene(**(values | changes))


def oracle(simulated: Simulated, times_s: np.ndarray) -> np.ndarray:
    """Heading at the given times by a Kalman filter that knows the truth about its sensors; state psi, b, error."""
    scene = simulated.scene
    dt = 1 / scene.gyro_hz
    turned = np.concatenate(
        [[0.0], np.cumsum(0.5 * (simulated.level_rate[1:] + simulated.level_rate[:-1]) * dt)]
    )

    def turned_at(t: float) -> float:
        return float(np.interp(t, simulated.t_s, turned))

    frames = simulated.frames[simulated.frames[:, 3] == 0]
    x, P, now, k = np.zeros(3), np.diag([1.0, 0.02**2, 1.0]), 0.0, 0

    def step(x: np.ndarray, P: np.ndarray, t0: float, t1: float) -> tuple[np.ndarray, np.ndarray]:
        h = t1 - t0
        rho = scene.frame_correlation ** (h * scene.frame_hz) if scene.frame_correlation else 0.0
        F = np.array([[1, -h, 0], [0, 1, 0], [0, 0, rho]])
        n2, b2 = scene.gyro_noise**2, scene.gyro_bias_walk**2
        Q = np.array(
            [[n2 * h + b2 * h**3 / 3, -b2 * h * h / 2, 0], [-b2 * h * h / 2, b2 * h, 0], [0, 0, 1 - rho**2]]
        )
        x = F @ x + np.array([turned_at(t1) - turned_at(t0), 0, 0])
        return x, F @ P @ F.T + Q

    found = np.empty(len(times_s))
    for i, t in enumerate(times_s):
        while k < len(frames) and frames[k, 0] <= t - scene.delay_s:
            when, seen, sigma, _ = frames[k]
            if when > now:
                x, P = step(x, P, now, when)
                now = when
            H = np.array([1.0, 0.0, sigma])
            S = H @ P @ H + 1e-12
            K = P @ H / S
            x, P = x + K * ((seen - H @ x + np.pi / 2) % np.pi - np.pi / 2), P - np.outer(K, K) * S
            k += 1
        found[i] = step(x, P, now, t)[0][0]
    return found


def fly(simulated: Simulated, config: Any) -> dict[str, np.ndarray]:
    """Run the estimator in order of arrival; causal and smoothed heading errors with their sigmas."""
    from fusion.estimator import CorridorEstimator

    steps, stamps = Steps(), []

    def keep(entry: Any) -> None:
        steps.add(entry.nodes)
        stamps.extend([entry.t_ns] * len(entry.nodes))

    estimator = CorridorEstimator(config, on_final=keep)
    rows, next_s = [], EVERY_S
    for sample in simulated.samples:
        give(estimator, sample)
        if sample.kind == "imu" and sample.t_ns * 1e-9 >= next_s:
            next_s += EVERY_S
            e = estimator.estimate()
            rows.append((e.timestamp_ns * 1e-9, e.heading_rad, e.heading_std_rad, e.lateral_offset_norm,
                         e.lateral_offset_norm_std))  # fmt: skip
    estimator.finish()
    t, heading, std, lateral, lateral_std = np.array(rows).T
    _, *arrays = steps.arrays()
    x, P = rts(*arrays)
    at = np.searchsorted(np.array(stamps) * 1e-9, t, side="right") - 1
    truth = np.interp(t, simulated.t_s, simulated.heading)
    offset = np.interp(t, simulated.t_s, simulated.lateral)
    return {
        "t": t,
        "error": wrap(heading - truth),
        "std": std,
        "smoothed": wrap(x[at, PSI] - truth),
        "smoothed_std": np.sqrt(P[at, PSI, PSI]),
        "oracle": wrap(oracle(simulated, t) - truth),
        "lateral": lateral - offset,
        "lateral_std": lateral_std,
    }


def rms(*parts: np.ndarray) -> float:
    joined = np.concatenate(parts)
    return float(np.sqrt(np.nanmean(joined**2)))


def report(
    name: str, runs: int, seconds: float, config: dict[str, Any] | None = None, **changes: Any
) -> float:
    """Print a line for a setting; returns the filter's RMSE."""
    results = []
    for seed in range(runs):
        scene = scene_of(seed, seconds, **changes)
        simulated = simulate(scene)
        results.append(
            fly(simulated, config_for(scene, **({"imu_yaw_std_rad": radians(0.3)} | (config or {}))))
        )
    rows = [r["t"] > 2.0 for r in results]
    error = [r["error"][k] for r, k in zip(results, rows, strict=True)]
    best = [r["oracle"][k] for r, k in zip(results, rows, strict=True)]
    smoothed = [r["smoothed"][k] for r, k in zip(results, rows, strict=True)]
    nees = np.concatenate([(r["error"] / r["std"])[k] ** 2 for r, k in zip(results, rows, strict=True)])
    nees_s = np.concatenate(
        [(r["smoothed"] / r["smoothed_std"])[k] ** 2 for r, k in zip(results, rows, strict=True)]
    )
    lateral = np.concatenate(
        [(r["lateral"] / r["lateral_std"])[k] ** 2 for r, k in zip(results, rows, strict=True)]
    )
    print(
        f"{name:34s} filter {degrees(rms(*error)):.3f}  oracle {degrees(rms(*best)):.3f}  "
        f"ratio {rms(*error) / rms(*best):.3f}  smoother/filter {rms(*smoothed) / rms(*error):.3f}  "
        f"NEES {nees.mean():.2f} smoothed {nees_s.mean():.2f} lateral {np.nanmean(lateral):.2f}  "
        f"worst {degrees(max(np.abs(e).max() for e in error)):.2f}"
    )
    return rms(*error)


def junctions(count: int) -> None:
    """Count turns of 30 to 150 degrees, fast and slow, some with a blind stretch, that end in a wrong corridor."""
    from tests.fusion.simulated import run

    wrong, rng = 0, np.random.default_rng(1)
    for seed in range(count):
        angle = radians(rng.uniform(30, 150)) * rng.choice([-1, 1])
        length, gap = rng.uniform(1.0, 4.0), rng.choice([0.0, rng.uniform(0.2, 2.5)])
        middle = 5 + length / 2
        scene = Scene(
            seed=seed,
            duration_s=10 + length,
            heading=plus(turning((5, length, angle)), weaving(seed, radians(6))),
            axis=lambda t, m=middle, a=angle: np.where(np.asarray(t) < m, 0.0, a),
            dropouts=[(middle - gap / 2, middle + gap / 2)],
            gross=0.05,
            delay_s=0.08,
            gyro_hz=100,
        )
        simulated = simulate(scene)
        result = run(simulated, every=50)
        good = result.corridor[-1] == 1 and abs(degrees(wrap(result.turn[-1] - angle))) < 5
        wrong += not good
    print(f"junctions                          {count} simulated, {wrong} in the wrong corridor")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--junctions", type=int, default=100)
    options = parser.parse_args()
    started = perf_counter()
    n, s = options.runs, options.seconds
    steps = lambda t: 0.7 + radians(15) * (np.sin(np.asarray(t) / 3.0) > 0.6)  # noqa: E731
    print(f"{n} runs of {s:g} s per line; degrees")
    report("white errors", n, s, yaw_offset=steps)
    report(
        "correlated, told",
        n,
        s,
        {"heading_correlation_s": 0.048, "lateral_correlation_s": 0.048},
        yaw_offset=steps,
        frame_correlation=0.5,
    )
    report("correlated, default settings", n, s, {"heading_correlation_s": 0.03}, yaw_offset=steps,
           frame_correlation=0.5)  # fmt: skip
    report("50 % gross errors", n, s, yaw_offset=steps, gross=0.5)
    alone = report("no attitude stream, level", n, s, attitude_hz=0.0, tilt_rad=0.0)
    never = report("IMU yaw never used", n, s, {"imu_yaw_use": "never"})
    for name, shared in (("of its own", False), ("of the same gyroscope", True)):
        for use in ("auto", "always"):
            rmse = report(f"IMU yaw {name}, {use}", n, s, {"imu_yaw_use": use}, yaw_shares_gyro=shared)
            print(f"{'':34s} over never {rmse / never:.3f}")
    print(f"{'':34s} never over no attitude {never / alone:.3f}")
    junctions(options.junctions)
    print(f"took {perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
