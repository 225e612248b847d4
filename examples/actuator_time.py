"""Control by the estimate for the time at which the actuators act, through a seed, a new width, a jump and a reset.

``python examples/actuator_time.py``

Needs no camera: the frames are synthetic. The vehicle weaves in a corridor that is 2 m wide, later 3 m.
"""

from __future__ import annotations

from math import cos, degrees, pi, sin

from fusion import CorridorEstimator, Estimate, FusionConfig
from vision import FrameMeasurement, Reason

MS = 1_000_000
ACTUATORS_NS = 40 * MS  # from the command until the vehicle feels it
WEAVE_RAD, PERIOD_S = 0.15, 4.0


def heading(t_ns: int) -> float:
    """Return the true heading."""
    return WEAVE_RAD * sin(2 * pi * t_ns * 1e-9 / PERIOD_S)


def fly(estimator: CorridorEstimator, start_ms: int, end_ms: int) -> list[float]:
    """Give the samples; return how far off the heading was, predicted to the actuators' time."""
    errors = []
    for ms in range(start_ms, end_ms, 5):
        t_ns = ms * MS
        rate = WEAVE_RAD * 2 * pi / PERIOD_S * cos(2 * pi * t_ns * 1e-9 / PERIOD_S)
        estimator.add_imu(t_ns, (0.0, 0.0, rate), (0.0, 0.0, -9.80665))
        if ms % 50 == 0:
            seen = FrameMeasurement(
                accepted=True,
                reason=Reason.OK,
                n_lines=40,
                n_inliers=20,
                heading_rad=heading(t_ns),
                heading_std_rad=0.005,
                lateral_offset_norm=0.2,
                lateral_offset_norm_std=0.02,
            )
            estimator.add_measurement(t_ns, seen)
        ahead = estimator.estimate(at_ns=t_ns + ACTUATORS_NS)
        errors.append(abs(ahead.heading_rad - heading(t_ns + ACTUATORS_NS)))
    return errors


class Setpoint:
    """A heading to hold that moves along with the estimate's steps, so that the controller feels none."""

    def __init__(self, heading_rad: float, e: Estimate) -> None:
        self.heading_rad, self._total_rad = heading_rad, e.reset_heading_total_rad

    def follow(self, e: Estimate) -> None:
        """Take up what steps there were since."""
        self.heading_rad += e.reset_heading_total_rad - self._total_rad
        self._total_rad = e.reset_heading_total_rad


def main() -> None:
    """Fly, and print."""
    estimator = CorridorEstimator(FusionConfig(corridor_width_m=2.0))
    estimator.seed(0, heading(0), 0.05)  # before the first frame: the vehicle was put down along the corridor
    errors = fly(estimator, 0, 4000)
    print(f"40 ms ahead, the heading is off by {degrees(max(errors)):.2f} degrees at most")

    estimator.set_corridor_width(4000 * MS, 3.0)
    fly(estimator, 4000, 5000)
    e = estimator.estimate()
    print(f"offset {e.lateral_offset_norm:.2f} half widths, {e.lateral_offset_m:.2f} m in the wider corridor")

    P = estimator.covariance()
    print("sigmas:", ", ".join(f"{name} {P.variance(name) ** 0.5:.2g}" for name in P.names))
    last = estimator.innovations().heading
    print(f"last innovation {degrees(last.value):.3f} degrees, test ratio {last.test_ratio:.3f}")

    setpoint = Setpoint(0.1, e)
    estimator.seed(4995 * MS, e.heading_rad + 0.3, 0.05)  # a step, as another corridor would make
    e = estimator.estimate()
    setpoint.follow(e)
    print(f"after {e.reset_count} step the setpoint is {setpoint.heading_rad:.2f} rad; faults {e.faults!r}")

    estimator.reset()
    e = estimator.estimate()
    print(f"after a reset: {e.status}, {e.reset_count} steps, {e.faults!r}")


if __name__ == "__main__":
    main()
