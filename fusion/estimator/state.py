"""What the estimator knows between two samples, and the samples that change it: immutable, without behaviour."""

from __future__ import annotations

from typing import NamedTuple

from fusion.estimator.camera_delay import Delay
from fusion.estimator.camera_elevation import Elevation
from fusion.estimator.camera_repeats import Repeats
from fusion.estimator.corridor_axis import CorridorAxis
from fusion.estimator.frame_update import FrameResult, FrameSample
from fusion.estimator.gyro_checks import GyroCheck
from fusion.estimator.imu_yaw import AttitudeSample, ImuYaw
from fusion.estimator.installation_checks import Installation
from fusion.estimator.lateral_status import Lateral
from fusion.estimator.models import FloatArray
from fusion.estimator.propagation import DeadReckoning, ImuSample
from fusion.estimator.range_width import RangeSample, Width
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.seed import HeadingSeed, WidthChange
from fusion.estimator.smoother import Node
from fusion.estimator.tilt import Tilt
from fusion.estimator.velocity import Velocity, VelocitySample

Sample = ImuSample | AttitudeSample | VelocitySample | RangeSample | FrameSample | HeadingSeed | WidthChange


class Source(NamedTuple):
    """A kind of sample: place among those of one instant, name in the counters, whether it carries the heading on."""

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
    """Whether what the sensors say can be true."""

    gyro: GyroCheck = GyroCheck()
    repeats: Repeats = Repeats()
    installation: Installation = Installation()

    def clock_set_back(self) -> Checks:
        """Start anew, but for what is known of the gyroscope's noise and of the turns so far."""
        return Checks(self.gyro.clock_set_back(), installation=self.installation.interrupted())


class State(NamedTuple):
    """All that the next step depends on: the filter's state and covariance, and a share for each part; immutable."""

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


class Entry(NamedTuple):
    """A sample, and what the engine made of it.

    Parameters
    ----------
    t_ns, sample
        The sample and its time.
    after
        The engine's state behind it.
    nodes
        Its steps for the smoother.
    frame
        What became of it, where it is a frame.
    """

    t_ns: int
    sample: Sample
    after: State
    nodes: tuple[Node, ...]
    frame: FrameResult | None
