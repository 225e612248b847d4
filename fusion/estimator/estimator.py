"""The estimator that a vehicle's program calls once per sample; the offline path drives the same one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fusion.estimator.config import FusionConfig
from fusion.estimator.fixed_lag import FixedLag
from fusion.estimator.frame_update import Engine, FrameResult, Measure
from fusion.estimator.range_width import MAX_DISTANCE_M
from fusion.estimator.state import Estimate, Status, describe
from fusion.estimator.tilt import Vector
from fusion.estimator.timeline import Entry, Kind, Timeline
from vision.errors import InputError
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason

if TYPE_CHECKING:
    from vision import Camera
    from vision.lines.segments import LineSet

CLOCK_RESET_SAMPLES = 50
_NAMES = tuple(kind.name.lower() for kind in Kind)

__all__ = ["CorridorEstimator", "Estimate", "FrameResult", "Status"]


class _Machine(Engine):
    """The engine, fed from the timeline."""

    def process(self, entry: Entry) -> None:
        """Take the entry's sample and fill in what came of it."""
        kind, payload = entry.kind, entry.payload
        if kind is Kind.IMU:
            self.imu(entry.t_ns, *payload)
        elif kind is Kind.ATTITUDE:
            self.attitude(entry.t_ns, payload)
        elif kind is Kind.VELOCITY:
            self.velocity(entry.t_ns, payload)
        elif kind is Kind.RANGE:
            self.range(entry.t_ns, payload)
        else:
            entry.frame = self.frame(entry.t_ns, *payload)
        entry.nodes = tuple(self.nodes)


class CorridorEstimator:
    """Heading and lateral offset from gyroscope, attitude and camera, sample by sample.

    Samples may come late and out of order by up to ``config.buffer_s`` behind the newest one; the result is bit for
    bit that of samples in order. What comes later than that, twice, or is no number is counted in `counters` and
    otherwise ignored. Not thread-safe: measure frames elsewhere if you like (`vision.extract_lines`), but call the
    estimator from one thread.

    Parameters
    ----------
    config
        Settings; None for the defaults.
    camera
        Needed for `add_frame` and `add_lines`, not for `add_measurement`.
    method
        ``geometric``, or ``paper`` for the article's measurement.
    on_final
        Called with each `fusion.estimator.timeline.Entry` that nothing can change any more, in order of time.
    """

    def __init__(
        self,
        config: FusionConfig | None = None,
        camera: Camera | None = None,
        method: str = "geometric",
        *,
        on_final: Callable[[Entry], None] | None = None,
    ) -> None:
        if method not in ("geometric", "paper"):
            raise InputError(f"method {method!r} is unknown", remedy="use geometric or paper")
        self.config = config or FusionConfig()
        self.camera = camera
        self.method = method
        self.counters: Counter[str] = Counter()
        self.last_frame: FrameResult | None = None
        self._machine = _Machine(self.config)
        if camera is not None:
            ahead_m, right_m, _ = camera.p_body_camera_m.tolist()
            self._machine.camera_arm_m = (ahead_m, right_m)
        lag_s = self.config.fixed_lag_s
        self._lag = None if lag_s is None else FixedLag(round(lag_s * 1e9), self.config)
        self._on_final = on_final
        self._timeline = Timeline(
            self._machine,
            round(self.config.buffer_s * 1e9),
            on_final if self._lag is None else self._finalise,
        )
        self._delay_ns = round(self.config.camera_delay_s * 1e9)
        self._late_in_a_row = 0

    def add_imu(self, t_ns: int, gyro: npt.ArrayLike, accel: npt.ArrayLike | None = None) -> None:
        """Add a gyroscope sample (3,) rad/s and, where there is one, accelerometer (3,) m/s^2, body FRD."""
        rate = _vector(gyro)
        if rate is None:
            self.counters["imu_not_finite"] += 1
            return
        self._add(t_ns, Kind.IMU, (rate, None if accel is None else _vector(accel)))

    def add_attitude(self, t_ns: int, q_world_body: npt.ArrayLike) -> None:
        """Add an attitude (4,), unit quaternion w, x, y, z, body FRD to a world whose z points down."""
        w, x, y, z = (float(v) for v in np.asarray(q_world_body, dtype=float).reshape(4))
        norm = (w * w + x * x + y * y + z * z) ** 0.5
        if not 0.9 < norm < 1.1:  # NaN fails too
            self.counters["attitude_not_unit"] += 1
            return
        self._add(t_ns, Kind.ATTITUDE, (w / norm, x / norm, y / norm, z / norm))

    def add_velocity(self, t_ns: int, v_body: npt.ArrayLike) -> None:
        """Add a velocity (3,) m/s in body FRD, for instance from optical flow or wheels."""
        velocity = _vector(v_body)
        if velocity is None:
            self.counters["velocity_not_finite"] += 1
            return
        self._add(t_ns, Kind.VELOCITY, velocity)

    def add_range(self, t_ns: int, distance_m: float) -> None:
        """Add a distance to the floor, metres along the body's z, as seen from the camera's place.

        With the width per height that frames see it gives the corridor's width, and so offsets in metres, where the
        configuration tells neither the width nor the camera's height.
        """
        distance_m = float(distance_m)
        if not 0.0 < distance_m <= MAX_DISTANCE_M:  # NaN fails too
            self.counters["range_not_positive"] += 1
            return
        self._add(t_ns, Kind.RANGE, distance_m)

    def add_frame(self, t_ns: int, image: npt.NDArray[Any]) -> FrameResult:
        """Add a picture: grey (h, w), BGR or BGRA, uint8 or uint16. A picture of no use is counted as unreadable.

        Returns
        -------
        FrameResult
            What became of it for now; a sample that comes late may still change it.

        Raises
        ------
        InputError
            Where the estimator has no camera.
        """
        from vision import extract_lines, measure_frame
        from vision.images import to_grey

        camera = self._camera()
        try:
            if self.method == "paper":
                return self.add_measurement(t_ns, measure_frame(image, camera, method="paper"))
            lines = extract_lines(to_grey(image), camera)
        except InputError:
            return self.add_unreadable_frame(t_ns)
        return self.add_lines(t_ns, lines)

    def add_lines(self, t_ns: int, lines: LineSet) -> FrameResult:
        """Add a picture whose lines were extracted elsewhere, for instance in another thread."""
        from vision import measure_lines

        camera = self._camera()

        def measure(attitude: Attitude | None, prior: Prior) -> FrameMeasurement:
            return measure_lines(lines, camera, attitude, prior)

        return self._add_frame(t_ns, measure)

    def add_measurement(self, t_ns: int, measurement: FrameMeasurement) -> FrameResult:
        """Add a frame that was measured elsewhere."""
        return self._add_frame(t_ns, measurement)

    def add_unreadable_frame(self, t_ns: int) -> FrameResult:
        """Add a frame of which there is no picture, so that it is counted and its age is known."""
        return self._add_frame(t_ns, None)

    def estimate(self, now_ns: int | None = None) -> Estimate:
        """Newest estimate, predicted to the newest sample.

        ``now_ns`` is the caller's clock, where status and ages should tell of sources that have fallen silent since.
        """
        state = self._machine.state
        if now_ns is not None and state.t_ns is not None:
            now_ns = max(now_ns, state.t_ns)
        return describe(state, self.config, now_ns)

    def smoothed(self) -> Estimate:
        """Estimate of ``config.fixed_lag_s`` ago, with all that has been measured since then.

        It is that of the last sample at or before the newest sample's time less the lag; of the first one while the
        flight is shorter. Status and ages are those of that time.

        Raises
        ------
        InputError
            Where the configuration asks for no lag.
        """
        if self._lag is None:
            raise InputError(
                "the estimator keeps no window to smooth", remedy="set fixed_lag_s = 1.0 (0.25 to 2 s)"
            )
        return self._lag.smoothed(self._timeline.entries)

    def finish(self) -> None:
        """End the flight: hand what is still in the buffer to ``on_final``."""
        self._timeline.finish()

    def _finalise(self, entry: Entry) -> None:
        if self._lag is not None:
            self._lag.keep(entry)
        if self._on_final is not None:
            self._on_final(entry)

    def _camera(self) -> Camera:
        if self.camera is None:
            raise InputError(
                "the estimator has no camera", remedy="give one: CorridorEstimator(config, camera)"
            )
        return self.camera

    def _add_frame(self, t_ns: int, measure: Measure | None) -> FrameResult:
        entry = self._add(t_ns - self._delay_ns, Kind.FRAME, (t_ns, measure))
        if entry is None or entry.frame is None:
            self.last_frame = FrameResult(t_ns, None, False, Reason.LATE)
        else:
            self.last_frame = entry.frame
            self.counters[f"frame_{entry.frame.reason}"] += 1
        return self.last_frame

    def _add(self, t_ns: int, kind: Kind, payload: Any) -> Entry | None:
        t_ns = int(t_ns)
        name = _NAMES[kind]
        if self._timeline.is_late(t_ns):
            self.counters[f"{name}_late"] += 1
            self._late_in_a_row += 1
            if self._late_in_a_row < CLOCK_RESET_SAMPLES:
                return None
            # Nothing but late samples: it is the clock that was set back.
            self.counters["clock_set_back"] += 1
            self._timeline.restart(t_ns)
            if self._lag is not None:
                self._lag.clear()
        self._late_in_a_row = 0
        entry = self._timeline.insert(t_ns, kind, payload)
        self.counters[f"{name}_duplicate" if entry is None else name] += 1
        return entry


def _vector(values: npt.ArrayLike) -> Vector | None:
    """Three finite floats; None where they are not."""
    if type(values) is np.ndarray and values.shape == (3,):
        x, y, z = values.tolist()  # the usual case, for half the price
    else:
        x, y, z = values if isinstance(values, tuple) else np.asarray(values, dtype=float).reshape(3).tolist()
    if isfinite(x) and isfinite(y) and isfinite(z):
        return float(x), float(y), float(z)
    return None
