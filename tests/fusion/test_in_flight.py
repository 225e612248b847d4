"""What must not happen in flight: compiling, and objects that only the garbage collector ends."""

from __future__ import annotations

import subprocess
import sys

FLY = """
import gc
import numpy as np
from numba.core.registry import CPUDispatcher
from fusion import CorridorEstimator, FusionConfig, load_flight
from tests.files import OFFICE
from vision import extract_lines, warm_up

def compiled():
    functions = [f for f in gc.get_objects() if isinstance(f, CPUDispatcher)]
    return {(f.py_func.__qualname__, str(types)) for f in functions for types in f.signatures}

flight = load_flight(OFFICE)
estimator = CorridorEstimator(FusionConfig(camera_delay_std_s=0.02, fixed_lag_s=0.5), flight.camera)
warm_up(flight.camera)
lines = [extract_lines(flight.frames.read(k), flight.camera) for k in range(40)]
calls = [(t, estimator.add_imu, (t, *v)) for t, *v in zip(
    flight.imu.t_ns.tolist(), flight.imu.gyro_rad_s, flight.imu.accel_m_s2)]
calls += [(t + 10_000_000, estimator.add_attitude, (t, q)) for t, q in zip(
    flight.attitude.t_ns.tolist(), flight.attitude.q_world_body)]
calls += [(t, estimator.add_velocity, (t, np.array([1.0, 0.0, 0.0]))) for t in flight.imu.t_ns[::10].tolist()]
calls += [(t, estimator.add_range, (t, 1.2)) for t in flight.imu.t_ns[::20].tolist()]
calls += [(t + 200_000_000, estimator.add_lines, (t, seen)) for t, seen in zip(flight.frames.t_ns.tolist(), lines)]
calls = sorted((call for call in calls if call[0] < flight.frames.t_ns[40]), key=lambda call: call[0])

before = compiled()
gc.collect()
gc.disable()
for _, call, arguments in calls:
    call(*arguments)
    estimator.estimate()
estimator.estimate(at_ns=calls[-1][0] + 100_000_000)
estimator.smoothed()
left = gc.collect()
assert estimator.counters["frame_ok"] > 30, estimator.counters
assert compiled() == before, compiled() - before
assert left == 0, left
"""


def test_nothing_is_compiled_in_flight_and_nothing_left_for_the_garbage_collector() -> None:
    """In a process of its own: in this one all may have been compiled long ago."""
    subprocess.run([sys.executable, "-c", FLY], check=True)
