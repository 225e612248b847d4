"""The estimator's state after a sample, and the kinds of samples that change it.

States and samples are immutable records. An `Entry` pairs a sample with the state after it; a late sample in front of
it replaces that state.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from fusion.estimator.camera_delay import Delay
from fusion.estimator.camera_elevation import Elevation
from fusion.estimator.camera_repeats import Repeats
from fusion.estimator.corridor_axis import CorridorAxis
from fusion.estimator.frame_update import FrameResult, FrameSample
from fusion.estimator.gyro_checks import GyroCheck, GyroVerdict
from fusion.estimator.imu_yaw import AttitudeSample, ImuYaw
from fusion.estimator.installation.checks import Installation
from fusion.estimator.kernels import NO_FORCE
from fusion.estimator.lateral.status import Lateral
from fusion.estimator.lateral.updates import usable_force
from fusion.estimator.models import FloatArray, level_yaw_rate
from fusion.estimator.propagation import DeadReckoning, ImuSample
from fusion.estimator.range_width import RangeSample, Width
from fusion.estimator.records import new_record
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.seed import HeadingSeed, WidthChange
from fusion.estimator.smoother import Node
from fusion.estimator.tilt import Tilt
from fusion.estimator.velocity import Velocity, VelocitySample

Sample = ImuSample | AttitudeSample | VelocitySample | RangeSample | FrameSample | HeadingSeed | WidthChange


class Source(NamedTuple):
    """A kind of sample: order at equal times, name in the counters, and whether it propagates the heading."""

    order: int
    name: str
    propagates: bool


SOURCES: dict[type[Sample], Source] = {
    ImuSample: Source(0, "imu", True),
    AttitudeSample: Source(1, "attitude", True),
    VelocitySample: Source(2, "velocity", False),
    RangeSample: Source(3, "range", False),
    FrameSample: Source(4, "frame", True),
    HeadingSeed: Source(5, "heading_seed", False),
    WidthChange: Source(6, "width_change", False),
}


class Checks(NamedTuple):
    """Plausibility checks of the sensors: gyroscope samples, repeated pictures, installation."""

    gyro: GyroCheck = GyroCheck()
    repeats: Repeats = Repeats()
    installation: Installation = Installation()

    def clock_set_back(self) -> Checks:
        """Restart the checks; keep the gyroscope's noise and the statistics of turns."""
        return Checks(self.gyro.clock_set_back(), installation=self.installation.interrupted())


class State(NamedTuple):
    """Everything that the next step depends on: the filter's ``x`` and ``P``, and one field per part; immutable."""

    x: FloatArray
    P: FloatArray
    reckoning: DeadReckoning
    tilt: Tilt = Tilt()
    velocity: Velocity = Velocity()
    width: Width = Width()
    imu_yaw: ImuYaw = ImuYaw()
    axis: CorridorAxis = CorridorAxis()
    lateral: Lateral = Lateral()
    frames: SampleTimes = SampleTimes()
    elevation: Elevation = Elevation()
    delay: Delay | None = None
    checks: Checks = Checks()

    @property
    def t_ns(self) -> int | None:
        """Time of the state; None before any sample."""
        return self.reckoning.t_ns

    def moved(
        self,
        x: FloatArray,
        P: FloatArray,
        reckoning: DeadReckoning,
        lateral: Lateral,
        delay: Delay | None,
        *,
        tilt: Tilt,
        imu_yaw: ImuYaw,
        frames: SampleTimes,
        checks: Checks,
    ) -> State:
        """Return the state after a propagation step; other parts are kept. Faster than `_replace`."""
        parts = (
            x, P, reckoning, tilt, self.velocity, self.width, imu_yaw, self.axis, lateral, frames, self.elevation,
            delay, checks,
        )  # fmt: skip
        return new_record(State, parts)


class Sensed(NamedTuple):
    """Parts of the state after a sample that do not depend on frames, so that a replay can reuse them.

    Parameters
    ----------
    tilt, gyro, installation
        Parts of the state; of the installation only the fields from the IMU are independent of frames.
    step
        Level yaw rate, force (3,) or NaN, direction of gravity (3,), and whether the accelerometer
        corrects it; only for a good gyroscope sample, else None.
    """

    tilt: Tilt
    gyro: GyroCheck
    installation: Installation
    step: tuple[float, ...] | None = None


class Replay(Protocol):
    """A run of samples processed together, such as a `fusion.estimator.gyro_run.GyroRun`."""

    def state(self, i: int) -> State:
        """Return the state after sample ``i``."""

    def nodes(self, i: int) -> tuple[Node, ...]:
        """Return the smoother's steps of sample ``i``."""


class Entry:
    """A sample and the result of processing it.

    Parameters
    ----------
    t_ns, sample
        The sample and its time.
    after
        The engine's state after it.
    nodes
        Its steps for the smoother.
    frame
        The frame's result; None for other samples.

    Attributes
    ----------
    run, place
        The run that gives the state and steps, and the sample's index in it; None and 0 for one processed alone.
    """

    __slots__ = ("_after", "_nodes", "_sensed", "frame", "place", "run", "sample", "t_ns")

    def __init__(
        self,
        t_ns: int,
        sample: Sample,
        after: State,
        nodes: tuple[Node, ...],
        frame: FrameResult | None,
    ) -> None:
        self.t_ns, self.sample, self.frame = t_ns, sample, frame
        self._after: State | None = after
        self._nodes: tuple[Node, ...] | None = nodes
        self._sensed: Sensed | None = None
        self.run: Replay | None = None
        self.place = 0

    @classmethod
    def of_run(cls, sample: Sample, run: Replay, place: int) -> Entry:
        """Return the entry of a sample that was processed in a run."""
        entry = cls.__new__(cls)
        entry.t_ns, entry.sample, entry.frame, entry._sensed = sample.t_ns, sample, None, None
        entry.use_replay(run, place)
        return entry

    def use_replay(self, run: Replay, place: int) -> None:
        """Take state and steps from a place in a run; they are built on first access."""
        self.run, self.place, self._after, self._nodes = run, place, None, None

    @property
    def after(self) -> State:
        """The engine's state after the sample."""
        if self._after is None:
            assert self.run is not None
            self._after = self.run.state(self.place)
        return self._after

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The sample's steps for the smoother."""
        if self._nodes is None:
            assert self.run is not None
            self._nodes = self.run.nodes(self.place)
        return self._nodes

    @property
    def sensed(self) -> Sensed:
        """Parts of the state after the sample that no late frame changes."""
        if self._sensed is None:
            self._sensed = sensed_after(self.after, self.sample)
        return self._sensed


def sensed_after(state: State, sample: Sample | None = None) -> Sensed:
    """Return the parts of a state that no late frame changes; ``sample`` is the one that led to it, if any."""
    tilt, gyro, step = state.tilt, state.checks.gyro, None
    if isinstance(sample, ImuSample) and gyro.verdict is GyroVerdict.GOOD and gyro.clipped_from_ns is None:
        force = usable_force(sample.accel_m_s2) or NO_FORCE
        step = (level_yaw_rate(sample.gyro_rad_s, tilt.down), *force, *tilt.down, float(tilt.follows_force))
    return Sensed(tilt, gyro, state.checks.installation, step)
