"""The estimator's parts one by one: what each takes, what it returns, and what it leaves alone."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, isnan, nan, radians, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.estimator import axis_acquisition, junctions
from fusion.estimator.axis_acquisition import Recovery
from fusion.estimator.camera_elevation import FLOOR_RAD, Elevation
from fusion.estimator.config import FusionConfig
from fusion.estimator.corridor_axis import CorridorAxis
from fusion.estimator.ekf import CorridorEKF
from fusion.estimator.engine import Engine
from fusion.estimator.frame_update import FrameSample, measure_with_prior, reason_to_reject
from fusion.estimator.imu_yaw import AttitudeSample, ImuYaw, fuse_imu_yaw
from fusion.estimator.junctions import NewCorridor
from fusion.estimator.lateral.status import Lateral, LateralReadout, LateralStatus, readout
from fusion.estimator.lateral.updates import LateralOffset, MotionStep
from fusion.estimator.models import BIAS, PSI, YAW_OFFSET, ScalarMeasurement
from fusion.estimator.noise_adaptation import ErrorModel, SourceNoise, update_robustly
from fusion.estimator.propagation import DeadReckoning, ImuSample, Mode, Propagation
from fusion.estimator.range_width import RangeSample, Width
from fusion.estimator.sample_times import SampleTimes
from fusion.estimator.state import SOURCES, Sample, State
from fusion.estimator.velocity import Velocity, VelocitySample, with_velocity
from fusion.estimator.votes import Vote
from tests.fusion.simulated import frame
from vision.measurement import Attitude, FrameMeasurement, Prior, Reason

MS = 1_000_000
LEVEL = (0.0, 0.0, 1.0)


def ekf_at(*x: float, std: float = 0.1) -> CorridorEKF:
    return CorridorEKF(np.array([*x, *[0.0] * (3 - len(x))]), np.eye(3) * std**2)


# Times of samples


def test_intervals_and_ages() -> None:
    times = SampleTimes()
    assert isnan(times.age_s(10))
    assert not times.is_silent(10**12, FusionConfig())
    for t_ms in (0, 100, 200):
        times = times.with_sample(t_ms * MS)
    assert times.interval_s == pytest.approx(0.1)
    assert times.age_s(500 * MS) == pytest.approx(0.3)
    assert not times.is_silent(449 * MS, FusionConfig())  # 2.5 intervals
    assert times.is_silent(451 * MS, FusionConfig())
    back = times.clock_set_back()
    assert back.last_ns is None
    assert back.with_sample(5).interval_s == times.interval_s


def test_one_gap_hardly_moves_the_mean_interval() -> None:
    times = SampleTimes(0, 0.1).with_sample(60_000 * MS)
    assert times.interval_s == pytest.approx(0.8 * 0.1 + 0.2 * 0.3)


# Propagation


def test_gyroscope_carries_the_heading_and_its_bias_is_taken_off() -> None:
    propagation, ekf, d = (
        Propagation(FusionConfig()),
        ekf_at(0.2, 0.03),
        DeadReckoning(stored_gyro_bias=(0.03, 1e-4)),
    )
    for k in range(101):
        sample = ImuSample(k * 10 * MS, (0.0, 0.0, 0.5), None)
        d = propagation.with_gyro(d, ekf, sample, 0.5)
    assert d.mode is Mode.GYRO
    assert d.t_ns == 1000 * MS
    assert d.raw_theta_rad == pytest.approx(0.5)
    assert d.theta_rad == pytest.approx(0.47)
    assert float(ekf.x[PSI]) == pytest.approx(0.67)
    assert d.yaw_rate(float(ekf.x[BIAS])) == pytest.approx(0.47)


def test_attitude_takes_over_from_a_silent_gyroscope_and_gives_back() -> None:
    propagation, ekf, d = Propagation(FusionConfig(gyro_gap_s=0.1)), ekf_at(0.0, 0.03), DeadReckoning()
    d = propagation.with_gyro(d, ekf, ImuSample(0, (0.0, 0.0, 0.0), None), 0.0)
    bias = float(ekf.x[BIAS])
    for t_ms, yaw in ((50, 0.7), (200, 0.7), (300, 0.9)):
        d = propagation.with_attitude_yaw(d, ekf, t_ms * MS, yaw)
    assert d.mode is Mode.ATTITUDE
    assert d.stored_gyro_bias[0] == bias
    assert float(ekf.x[BIAS]) == 0.0
    assert d.raw_theta_rad == pytest.approx(0.2)
    assert d.attitude_silence(301 * MS, FusionConfig()) == ""
    assert d.attitude_silence(9000 * MS, FusionConfig()) == "attitude is silent"
    d = propagation.with_gyro(d, ekf, ImuSample(310 * MS, (0.0, 0.0, 0.0), None), 0.0)
    assert d.mode is Mode.GYRO
    assert float(ekf.x[BIAS]) == bias


def test_a_held_rate_is_made_good_by_the_next_sample() -> None:
    """Whatever is asked for in between, the gyroscope's samples count by the trapezoid rule."""
    results = []
    for asked in ((), (3, 7)):
        propagation, ekf, d = (
            Propagation(FusionConfig()),
            ekf_at(),
            DeadReckoning(stored_gyro_bias=(0.0, 1e-8)),
        )
        d = propagation.with_gyro(d, ekf, ImuSample(0, (0.0, 0.0, 0.0), None), 0.2)
        for t_ms in asked:
            d = propagation.hold(d, ekf, t_ms * MS)
        d = propagation.with_gyro(d, ekf, ImuSample(10 * MS, (0.0, 0.0, 0.0), None), 0.4)
        results.append((d.raw_theta_rad, float(ekf.x[PSI])))
    assert results[0] == pytest.approx((0.003, 0.003))
    assert results[1] == pytest.approx(results[0])


# IMU yaw


def test_the_offset_is_followed_and_the_heading_left_alone() -> None:
    config, ekf, part = FusionConfig(imu_yaw_use="never"), ekf_at(0.3), ImuYaw()
    d = DeadReckoning(t_ns=0, mode=Mode.GYRO, attitude=SampleTimes(0))
    before = ekf.x[[PSI, BIAS]].tolist()
    for _ in range(50):
        part = fuse_imu_yaw(part, ekf, 1.0, d, CorridorAxis(acquired=True), config)
    assert part.known
    assert not part.corrects_heading
    assert float(ekf.x[YAW_OFFSET]) == pytest.approx(0.7, abs=0.05)
    assert ekf.x[[PSI, BIAS]].tolist() == before


def test_without_an_axis_the_yaw_is_not_looked_at() -> None:
    ekf, part = ekf_at(0.3), ImuYaw()
    assert fuse_imu_yaw(part, ekf, 1.0, DeadReckoning(), CorridorAxis(), FusionConfig()) is part
    assert ekf.nodes == []


@pytest.mark.parametrize("q", [(0.5, 0.0, 0.0, 0.0), (nan, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0)])
def test_no_unit_quaternion_is_no_attitude(q: tuple[float, float, float, float]) -> None:
    assert AttitudeSample(0, q).fault() == "attitude_not_unit"


@given(st.floats(0.92, 1.08), st.floats(-3, 3))
def test_nearly_unit_quaternions_are_made_unit(length: float, half: float) -> None:
    sample = AttitudeSample(0, (length * cos(half), 0.0, 0.0, length * sin(half)))
    assert sample.fault() == ""
    assert sample.unit() == pytest.approx((cos(half), 0.0, 0.0, sin(half)))


# Corridor axis and junctions


def votes(axis_rad: float, n: int, *, n_accepted: int = 40, linked: bool = False) -> tuple[Vote, ...]:
    return tuple(Vote(k * 100 * MS, axis_rad, radians(0.5), n_accepted, linked) for k in range(n))


def decided(axis: CorridorAxis, theta_rad: float, n: int) -> Recovery | NewCorridor | None:
    now_ns = (n - 1) * 100 * MS
    return junctions.decide(
        axis, theta_rad - axis.anchor_rad, radians(0.3), now_ns, theta_rad, 0.1, FusionConfig()
    )[1]


def known_axis(**changes: Any) -> CorridorAxis:
    return CorridorAxis(
        acquired=True, ever_acquired=True, anchor_rad=0.0, n_accepted=40, support_s=20.0, t_vision_ns=0
    )._replace(**changes)


def test_start_takes_the_median_of_frames_that_agree() -> None:
    ekf, config = ekf_at(std=2.0), FusionConfig(start_frames=3)
    axis = CorridorAxis(votes=votes(-0.2, 2))
    assert axis_acquisition.acquire(axis, ekf, 0, 0.0, False, config, Mode.GYRO) is axis
    axis = axis_acquisition.acquire(
        CorridorAxis(votes=votes(-0.2, 3)), ekf, 300 * MS, 0.0, False, config, Mode.GYRO
    )
    assert axis.acquired
    assert axis.ever_acquired
    assert axis.votes == ()
    assert axis.reset_count == 0
    assert axis.anchor_rad == pytest.approx(-0.2, abs=0.01)
    assert float(ekf.x[PSI]) == pytest.approx(0.2, abs=0.01)


def test_a_gyroscope_of_unknown_bias_makes_the_first_heading_less_sure_and_no_gyroscope_does_not() -> None:
    config, sigma = FusionConfig(start_frames=3), {}
    for mode in (Mode.GYRO, Mode.ATTITUDE, Mode.NONE):
        ekf = ekf_at(std=2.0)
        assert axis_acquisition.acquire(
            CorridorAxis(votes=votes(-0.2, 3)), ekf, 300 * MS, 0.0, False, config, mode
        ).acquired
        sigma[mode] = float(ekf.P[PSI, PSI]) ** 0.5
    assert sigma[Mode.GYRO] > 2.0 * sigma[Mode.NONE]
    assert sigma[Mode.NONE] == sigma[Mode.ATTITUDE]


def test_few_votes_or_contested_ones_mean_nothing() -> None:
    assert decided(known_axis(votes=votes(0.2, 9)), 0.0, 9) is None
    assert decided(known_axis(votes=votes(0.2, 12), n_accepted=60), 0.0, 12) is None


def test_an_axis_nearby_is_waited_out_if_frames_jumped_there_and_a_recovery_if_they_did_not() -> None:
    assert decided(known_axis(votes=votes(radians(10), 10)), 0.0, 10) is None
    found = decided(known_axis(votes=votes(radians(10), 10, linked=True)), 0.0, 10)
    assert isinstance(found, Recovery)
    assert found.heading_rad == pytest.approx(radians(-10))


def test_a_turn_makes_another_corridor_and_no_turn_a_wall() -> None:
    turn = radians(80)
    axis = known_axis(votes=votes(turn, 10))
    found = decided(axis, turn, 10)
    assert isinstance(found, NewCorridor)
    assert found.heading_rad == pytest.approx(0.0, abs=1e-9)
    assert not found.same_corridor
    assert decided(axis, 0.0, 10) is None


def test_recovery_leaves_what_the_imu_yaw_has_shown() -> None:
    ekf = ekf_at(0.5, 0.0, 0.2, std=0.01)
    found = Recovery(0.1, radians(0.5))
    axis = axis_acquisition.recover(known_axis(votes=votes(0.1, 10)), ekf, found, 0, 0.0, True)
    assert float(ekf.x[PSI]) == pytest.approx(0.1, abs=0.01)
    assert float(ekf.x[PSI] + ekf.x[YAW_OFFSET]) == pytest.approx(0.7, abs=0.01)
    assert axis.reset_count == 1
    assert axis.reset_heading_rad == pytest.approx(-0.4, abs=0.01)
    assert axis.votes == ()


@pytest.mark.parametrize("corrects_heading", [True, False])
def test_entering_a_corridor_keeps_the_imu_yaw_and_forgets_the_offset(corrects_heading: bool) -> None:
    ekf, turn = ekf_at(1.3, 0.02, 0.4, std=0.05), radians(80)
    found = NewCorridor(1.3 - turn, turn, radians(0.5), same_corridor=False)
    crossing = junctions.Crossing(corrects_heading, 7)
    axis = junctions.enter_corridor(known_axis(), ekf, found, 0, 1.3, crossing, FusionConfig())
    assert (axis.corridor_index, axis.n_corridors, axis.reset_count) == (1, 2, 1)
    assert axis.corridor_turn_rad == pytest.approx(turn)
    assert float(ekf.x[PSI]) + axis.corridor_turn_rad == pytest.approx(1.3)
    assert ekf.x[[BIAS, YAW_OFFSET]].tolist() == [0.02, 0.4]
    # psi + turn + o, the IMU's yaw, is known no better or worse than before.
    total = np.array([1.0, 0, 1.0])
    assert float(total @ ekf.P @ total) >= 2 * 0.05**2 - 1e-9
    assert axis.previous is not None
    assert axis.previous.n_lateral == 7


# Lateral offset


def frames_of(part: LateralOffset, offsets: Sequence[float], half_m: float = 1.0) -> Lateral:
    """Show a part one frame after another, a tenth of a second apart, from a vehicle at rest."""
    lateral, x = Lateral(), np.zeros(3)
    for k, offset in enumerate(offsets):
        lateral = part.propagated(lateral, MotionStep(0.1 if k else 0.0, 0.0, LEVEL, (0.0, 0.0, -9.80665)))
        lateral = part.fused(lateral, x, k * 100 * MS, frame(0.0, lateral=offset, lateral_std=0.02), half_m)
    return lateral


def told(part: LateralOffset, lateral: Lateral) -> LateralReadout:
    return readout(lateral, part.model, 0.0, Velocity(), lateral.t_ns or 0, 1.0)


def test_offsets_that_agree_become_known_and_a_lone_other_one_does_not_move_it() -> None:
    part = LateralOffset(FusionConfig(), (0.0, 0.0))
    assert told(part, frames_of(part, [0.4])).status is LateralStatus.UNKNOWN
    known = frames_of(part, [0.4] * 10)
    assert told(part, known).status is LateralStatus.KNOWN
    assert told(part, known).offset == pytest.approx(0.4, abs=0.01)
    assert known.reset_count == 0
    struck = frames_of(part, [0.4] * 10 + [-0.7])
    assert told(part, struck).offset == pytest.approx(0.4, abs=0.01)
    assert struck.test_ratio > 1


def test_another_offset_that_lasts_is_one_counted_step() -> None:
    part = LateralOffset(FusionConfig(), (0.0, 0.0))
    contradicted = frames_of(part, [0.4] * 10 + [-0.2] * 25, half_m=1.5)
    assert told(part, contradicted).status is LateralStatus.UNKNOWN
    changed = frames_of(part, [0.4] * 10 + [-0.2] * 150, half_m=1.5)
    assert told(part, changed).offset == pytest.approx(-0.2, abs=0.02)
    assert changed.reset_count == 1
    assert changed.reset_norm == pytest.approx(-0.6, abs=0.03)
    assert changed.reset_m == pytest.approx(-0.9, abs=0.05)


def test_in_another_corridor_nothing_is_known_and_the_step_is_told_later() -> None:
    part = LateralOffset(FusionConfig(), (0.0, 0.0))
    known = frames_of(part, [0.4] * 10)
    again = known.without_offset()
    assert told(part, again).status is LateralStatus.UNKNOWN
    assert again.last_known[0] == pytest.approx(0.4, abs=0.01)
    assert again.step is not None
    assert again.step.is_reset


def test_a_frame_without_an_offset_changes_nothing() -> None:
    part = LateralOffset(FusionConfig(), (0.0, 0.0))
    known = frames_of(part, [0.4] * 10)
    after = part.fused(known, np.zeros(3), 1000 * MS, frame(0.0), 1.0)
    assert after == known


def test_the_camera_s_place_is_taken_off_and_put_on_again() -> None:
    part, aside = LateralOffset(FusionConfig(), (0.3, 0.1)), 0.1 / 1.5
    known = frames_of(part, [0.25 + aside] * 12, half_m=1.5)
    assert told(part, known).offset == pytest.approx(0.25, abs=0.01)
    offset, std = part.expected(known, 0.2, 1.5)
    assert offset == pytest.approx(told(part, known).offset + (0.3 * sin(0.2) + 0.1 * cos(0.2)) / 1.5)
    assert std > 0.1
    assert isnan(part.expected(Lateral(), 0.2, 1.5)[0])


def test_readout_tells_the_speed_along_whatever_is_known() -> None:
    part = LateralOffset(FusionConfig(), (0.0, 0.0))
    velocity = with_velocity(Velocity(), VelocitySample(0, (1.0, 0.0, 0.0)), LEVEL)
    hidden = readout(Lateral(), part.model, 0.3, velocity, 0, 1.0)
    assert isnan(hidden.offset)
    assert hidden.along_m_s == pytest.approx(cos(0.3))


def test_an_offset_that_no_frame_confirms_is_carried_on() -> None:
    part = LateralOffset(FusionConfig(), (0.0, 0.0))
    lateral = frames_of(part, [0.4] * 30)
    for _ in range(25):
        lateral = part.propagated(lateral, MotionStep(0.01, 0.0, LEVEL, (0.0, 0.0, -9.80665)))
    found = readout(lateral, part.model, 0.0, Velocity(), (lateral.t_ns or 0) + 250 * MS, 0.2)
    assert found.status is LateralStatus.COASTING
    assert found.offset_std > told(part, frames_of(part, [0.4] * 30)).offset_std


class Listening(LateralOffset):
    """Notes what it is told."""

    def __init__(self, config: FusionConfig) -> None:
        super().__init__(config, (0.0, 0.0))
        self.steps: list[MotionStep] = []

    def propagated(self, lateral: Lateral, step: MotionStep) -> Lateral:
        self.steps.append(step)
        return super().propagated(lateral, step)


def test_the_lateral_offset_is_told_every_step() -> None:
    """What a part in its place can build on: steps without gaps, heading and rate, forces where there are any."""
    engine = Engine(FusionConfig())
    engine._lateral = part = Listening(engine.config)
    state, force = engine.initial_state(), (0.1, -0.2, -9.8)
    samples: list[Sample] = [
        *(ImuSample(k * 10 * MS, (0.0, 0.0, 0.1), force) for k in range(100)),
        VelocitySample(503 * MS, (1.0, 0.0, 0.0)),
        AttitudeSample(507 * MS, (1.0, 0.0, 0.0, 0.0)),
        RangeSample(508 * MS, 1.2),
        FrameSample(509 * MS, 509 * MS, frame(0.1)),
    ]
    for sample in sorted(samples, key=lambda s: s.t_ns):
        state = engine.process(state, sample).after
    assert sum(step.dt_s for step in part.steps) == pytest.approx(0.99)
    assert len(part.steps) == 103  # a range moves nothing
    assert {step.accel_m_s2 for step in part.steps} == {force, None}
    assert part.steps[-1].heading_rad > part.steps[0].heading_rad


# Velocity, range and elevation


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_velocities_are_levelled(roll: float, pitch: float) -> None:
    down = (-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch))
    forward = (cos(pitch), sin(roll) * sin(pitch), cos(roll) * sin(pitch))
    right = (0.0, cos(roll), -sin(roll))
    x, y, z = (2.0 * f - 0.5 * r + 3.0 * d for f, r, d in zip(forward, right, down, strict=True))
    found = with_velocity(Velocity(), VelocitySample(7, (x, y, z)), down)
    assert (found.forward_m_s, found.sideways_m_s) == pytest.approx((2.0, -0.5))
    assert found.is_known(7 + 500 * MS)
    assert not found.is_known(7 + 501 * MS)
    assert found.clock_set_back() == found._replace(times=found.times.clock_set_back())


def test_where_the_width_comes_from() -> None:
    measured = Width(per_height=1.6)
    assert measured.half_m(FusionConfig(corridor_width_m=2.0, camera_height_m=9.0)) == 1.0
    assert measured.half_m(FusionConfig(camera_height_m=1.5)) == pytest.approx(1.2)
    assert isnan(measured.half_m(FusionConfig()))


def test_frames_and_ranges_make_a_width_that_another_corridor_forgets() -> None:
    width = Width()
    for k in range(20):
        width = width.with_range(RangeSample(k * 110 * MS, 1.25), 0.96).with_frame(k * 110 * MS, 2.0)
    assert width.half_m(FusionConfig()) == pytest.approx(1.2)
    assert width.per_height == pytest.approx(2.0)
    assert width.with_frame(0, nan) is width
    assert width.silence(19 * 110 * MS, FusionConfig()) == ""
    assert width.silence(10**12, FusionConfig()) == "range sensor is silent"
    other = width.corridor_changed()
    assert isnan(other.half_m(FusionConfig()))
    assert isnan(other.per_height)
    assert other.heights == width.heights


def test_one_frame_moves_the_width_per_height_by_a_fifth_at_most() -> None:
    width = Width(per_height=2.0, n_frames=1).with_frame(0, 20.0)
    assert width.per_height == pytest.approx(2.0 + 0.4 / 2)


@pytest.mark.parametrize(
    "sample",
    [
        ImuSample(0, (nan, 0.0, 0.0), None),
        VelocitySample(0, (0.0, float("inf"), 0.0)),
        RangeSample(0, nan),
        RangeSample(0, 0.0),
        RangeSample(0, 101.0),
    ],
)
def test_no_numbers_are_no_samples(sample: ImuSample | VelocitySample | RangeSample) -> None:
    assert sample.fault().startswith(SOURCES[type(sample)].name)


def test_elevation_is_a_mean_that_needs_an_attitude() -> None:
    seen, attitude = (
        frame(0.0, elevation_rad=0.03, elevation_std_rad=radians(0.2)),
        Attitude(0.0, 0.0, radians(0.5)),
    )
    assert Elevation().with_frame(seen, None) == Elevation()
    assert Elevation().with_frame(frame(0.0), attitude) == Elevation()
    found = Elevation()
    for _ in range(3000):
        found = found.with_frame(seen, attitude)
    assert found.mean_rad == pytest.approx(0.03, abs=1e-3)
    assert found.std_rad == FLOOR_RAD


# Frames


def test_what_is_turned_down_before_the_filter_looks() -> None:
    config = FusionConfig()
    assert reason_to_reject(frame(0.1), config) is Reason.OK
    assert reason_to_reject(frame(0.1, n_inliers=3), config) is Reason.TOO_FEW_LINES
    assert reason_to_reject(frame(0.1, accepted=False, reason=Reason.BLUR), config) is Reason.BLUR
    assert reason_to_reject(frame(nan), config) is Reason.UNCERTAIN
    assert reason_to_reject(frame(0.1, std_rad=4.0), config) is Reason.UNCERTAIN


def measured(near: float, free: float, prior_rad: float) -> tuple[float, int]:
    calls = []

    def measure(attitude: Attitude | None, prior: Prior, lateral: bool) -> FrameMeasurement:
        calls.append(prior)
        return frame(free if isnan(prior.heading_rad) else near)

    prior = Prior(heading_rad=prior_rad, heading_std_rad=0.01)
    psi = 0.0 if isnan(prior_rad) else prior_rad
    return measure_with_prior(measure, None, prior, psi, True, FusionConfig()).heading_rad, len(calls)


def test_a_frame_is_measured_again_without_prediction_where_that_does_not_settle_it() -> None:
    turned = radians(30)
    assert measured(0.1, 1.0, 0.1) == (0.1, 1)  # near what is expected
    assert measured(0.1, 1.0, nan) == (1.0, 1)  # nothing is expected
    assert measured(1.0, 0.9, 0.1) == (0.9, 2)  # far off
    # Turned away, what is seen without counts: first the heading, then, where it differs, the offset too.
    assert measured(turned, 0.0, turned) == (0.0, 3)
    assert measured(turned, turned + 0.01, turned) == (turned, 2)


# Noise


def test_an_update_with_doubt_is_weaker_and_learns() -> None:
    m = ScalarMeasurement(0.1, np.eye(5)[0], 0.01)
    plain, doubted = ekf_at(), ekf_at()
    plain.update(m)
    gate, noise = update_robustly(doubted, m, SourceNoise(), ErrorModel(4.0, 0.5, 0.5))
    assert gate.accepted
    assert 0 < float(doubted.x[PSI]) < float(plain.x[PSI])
    assert noise.outlier_share < SourceNoise().outlier_share
    far = ScalarMeasurement(3.0, np.eye(5)[0], 0.01)
    gate, noise = update_robustly(doubted, far, SourceNoise(), ErrorModel(4.0, 0.5, 0.5))
    assert not gate.accepted
    assert noise.outlier_share > SourceNoise().outlier_share


# The engine


def test_a_state_is_a_snapshot_that_later_samples_leave_alone() -> None:
    engine = Engine(FusionConfig(corridor_width_m=2.0, camera_delay_std_s=0.02))
    state, seen = engine.initial_state(), []
    for k in range(200):
        state = engine.process(state, ImuSample(k * 10 * MS, (0.01, 0.0, 0.2), (0.0, 0.0, -9.8))).after
        if k % 5 == 0:
            sample = FrameSample(k * 10 * MS, k * 10 * MS, frame(0.002 * k, lateral=0.1, lateral_std=0.02))
            state = engine.process(state, sample).after
        seen.append((state, repr(state)))
    assert all(repr(state) == text for state, text in seen)
    parts = (part for part in state[2:] if not isinstance(part, Lateral))  # whose arrays are replaced instead
    assert all(hash(part) is not None for part in parts)  # they hold nothing that can be written into


def test_the_same_state_and_sample_give_the_same_bits() -> None:
    engine, other = Engine(FusionConfig()), Engine(FusionConfig())
    state = engine.initial_state()
    for k in range(50):
        sample = ImuSample(k * 10 * MS, (0.0, 0.0, 0.2), None)
        before, state = state, engine.process(state, sample).after
        again: State = other.process(before, sample).after
        assert repr(again) == repr(state)
        assert again.x.tobytes() == state.x.tobytes()
