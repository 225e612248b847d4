"""The lateral offset over time: several places at once until time and motion tell, and honest about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, inf, nan, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.estimator.lateral.gaussian_sum import (
    MAX_HYPOTHESES,
    Acceleration,
    OffsetModel,
    OffsetReadout,
    OffsetState,
    Path,
    along_path,
    frame_evidence,
    in_new_corridor,
    initial_offset_state,
    lasting_variances,
    moments,
    propagate,
    readout,
    transition,
    update,
    with_roll,
    with_speed,
)
from fusion.estimator.lateral.kernels import S, V, Y, levelled
from fusion.estimator.lateral.mixture_kernels import MAX_SPREAD_NORM, spread_about
from fusion.estimator.lateral.smoother import (
    LONGEST_STEP_S,
    OffsetStep,
    OffsetSteps,
    at_times,
    smoothed_offsets,
)
from vision.lateral.mixture import OffsetMixture, cannot_tell

G = 9.80665
MODEL = OffsetModel()
LEVEL = (0.0, 0.0, 1.0)
IMU_S, FRAME_S = 0.005, 0.05
Parts = Sequence[tuple[float, float, float]]


def mixture(*parts: tuple[float, float, float]) -> OffsetMixture:
    """Weight, offset and sigma of each component."""
    weight, offset, std = np.array(parts, dtype=float).reshape(-1, 3).T
    return OffsetMixture(weight, offset, std, np.full(len(weight), nan))


def seen(state: OffsetState, *parts: tuple[float, float, float], heading_rad: float = 0.0) -> OffsetState:
    """Take in a frame without an arm between camera and body."""
    return update(state, frame_evidence([mixture(*parts)], FRAME_S, heading_rad, (0.0, 0.0)), MODEL)


def moved_on(state: OffsetState, seconds: float, right_m_s2: float = 0.0, accel: bool = True) -> OffsetState:
    """Fly on, level and along the axis."""
    force = (0.0, right_m_s2, -G) if accel else None
    for _ in range(round(seconds / IMU_S)):
        state = propagate(state, IMU_S, 0.0, force, LEVEL)
    return state


class Flight:
    """A vehicle of known motion in a corridor 2 m wide, so that half widths are metres; noise from a seed."""

    def __init__(
        self, seed: int, y: Callable[[float], float], roughness: float = 0.3, bias: float = 0.1
    ) -> None:
        self.rng, self.y, self.roughness, self.bias = np.random.default_rng(seed), y, roughness, bias

    def accel(self, t: float) -> float:
        h = 1e-3
        true = (self.y(t + h) - 2 * self.y(t) + self.y(t - h)) / h**2
        return float(true + self.bias + self.roughness * self.rng.normal())

    def run(
        self,
        seconds: float,
        evidence: Callable[[float], OffsetMixture],
        accel: bool = True,
        model: OffsetModel = MODEL,
    ) -> tuple[list[OffsetStep], np.ndarray[Any, Any], list[OffsetReadout]]:
        """Return steps, times and readouts of every frame."""
        state, steps, times, out = initial_offset_state(), [], [], []
        for k in range(1, round(seconds / FRAME_S) + 1):
            for i in range(10):
                t = (k - 1) * FRAME_S + (i + 1) * IMU_S
                force = (0.0, self.accel(t), -G) if accel else None
                state = propagate(state, IMU_S, 0.0, force, LEVEL)
            frame = frame_evidence([evidence(k * FRAME_S)], FRAME_S if k > 1 else nan, 0.0, (0.0, 0.0))
            path = state.path
            state = update(state, frame, model)
            steps.append(OffsetStep(path, state, frame))
            times.append(k * FRAME_S)
            out.append(readout(state, model))
        return steps, np.array(times), out


def weave(t: float) -> float:
    return 0.3 * sin(0.9 * t)


def test_nothing_is_known_before_a_frame_and_after_one_alone() -> None:
    state = initial_offset_state()
    assert not readout(state, MODEL).known
    state = seen(state, (0.9, 0.3, 0.01))
    assert not readout(state, MODEL).known
    for _ in range(12):
        state = seen(moved_on(state, FRAME_S), (0.9, 0.3, 0.01))
    found = readout(state, MODEL)
    assert found.known
    assert found.offset_norm == pytest.approx(0.3, abs=0.01)


def test_frames_that_cannot_tell_leave_it_unknown() -> None:
    state = initial_offset_state()
    for _ in range(50):
        state = update(moved_on(state, FRAME_S), frame_evidence([cannot_tell()], FRAME_S, 0.0, (0, 0)), MODEL)
    assert not readout(state, MODEL).known
    assert state.weight[-1] == pytest.approx(1.0)


def test_two_places_stay_open_while_frames_show_both() -> None:
    state = initial_offset_state()
    for _ in range(60):
        state = seen(moved_on(state, FRAME_S), (0.45, 0.3, 0.01), (0.45, -0.2, 0.01))
        assert not readout(state, MODEL).known
    assert readout(state, MODEL).probability == pytest.approx(0.5, abs=0.1)


def test_two_places_are_told_apart_by_how_they_move() -> None:
    """One stands still in the picture while the accelerometer says that the vehicle weaves: it cannot be right.

    Only in a corridor of known width: in one of any width the vehicle could weave unseen.
    """
    model = OffsetModel(inverse_half_width=(1.0, 0.02))
    flight = Flight(1, weave)
    _, times, out = flight.run(8.0, lambda t: mixture((0.4, weave(t), 0.01), (0.4, 0.6, 0.01)), model=model)
    assert out[20].probability < 0.6
    last = out[-1]
    assert last.offset_norm == pytest.approx(weave(times[-1]), abs=0.03)
    assert last.probability > 0.7
    assert not [o for o, t in zip(out, times, strict=True) if o.known and abs(o.offset_norm - weave(t)) > 0.1]


def test_a_burst_of_wrong_frames_does_not_capture_it_for_long() -> None:
    flight = Flight(2, weave)

    def evidence(t: float) -> OffsetMixture:
        return mixture((0.8, -0.6, 0.01)) if 4.0 < t < 4.2 else mixture((0.8, weave(t), 0.01))

    _, times, out = flight.run(8.0, evidence)
    for o, t in zip(out, times, strict=True):
        assert not (o.known and abs(o.offset_norm - weave(t)) > 0.1)
    assert out[-1].known


def test_a_step_of_the_accelerometer_integrates() -> None:
    state = initial_offset_state()
    for _ in range(200):
        state = seen(moved_on(state, FRAME_S), (0.9, 0.0, 0.005))
    state = moved_on(state, 1.0, right_m_s2=0.3)
    found = readout(state, MODEL)
    s = float(state.x[0, S])
    assert found.offset_norm == pytest.approx(0.5 * 0.3 * s, abs=0.03)
    assert found.velocity_norm_s == pytest.approx(0.3 * s, abs=0.05)
    assert 0.02 < found.std_norm < 0.15


def test_a_constant_bias_is_learned() -> None:
    flight = Flight(3, weave, bias=0.2)
    steps, _, _ = flight.run(15.0, lambda t: mixture((0.9, weave(t), 0.01)))
    x = steps[-1].after.x[0]
    assert x[2] / x[S] == pytest.approx(0.2, abs=0.06)


def test_without_accelerometer_the_rate_fades_and_the_sigma_grows() -> None:
    flight = Flight(4, lambda t: 0.1 * t - 0.3)
    steps, _, out = flight.run(4.0, lambda t: mixture((0.9, 0.1 * t - 0.3, 0.01)), accel=False)
    state = moved_on(steps[-1].after, 2.0, accel=False)
    later = readout(state, MODEL)
    assert 0.0 < later.velocity_norm_s < 0.5 * out[-1].velocity_norm_s
    assert later.std_norm > MODEL.known_std_norm
    assert not later.known


def test_a_vibrating_accelerometer_is_given_up() -> None:
    still = moved_on(initial_offset_state()._replace(accel=Acceleration(0.0, 0.0, 0.0, 1)), 0.1)
    F, _ = transition(still.path, MODEL)
    assert F[V, V] == 1.0
    shaken = initial_offset_state()
    for k in range(100):
        shaken = propagate(shaken, IMU_S, 0.0, (0.0, 15.0 * (-1) ** k, -G), LEVEL)
    F, _ = transition(shaken.path, MODEL)
    assert F[V, V] < 1.0
    assert F[Y, S] == 0.0


def test_another_corridor_forgets_the_offset_but_not_the_roll() -> None:
    state = with_roll(initial_offset_state(), 0.01, 0.002, 0.05)
    for _ in range(20):
        state = seen(moved_on(state, FRAME_S), (0.9, 0.3, 0.01))
    assert readout(state, MODEL).known
    state = in_new_corridor(state)
    assert not readout(state, MODEL).known
    assert state.roll.mean > 0.004
    assert np.isfinite(state.accel.last)


def test_a_step_in_the_width_is_followed() -> None:
    """Frames speak of another place from one frame to the next: unknown for a moment, then there."""
    state = initial_offset_state()
    for _ in range(40):
        state = seen(moved_on(state, FRAME_S), (0.9, 0.2, 0.01))
    known_wrong = 0
    for _ in range(40):
        state = seen(moved_on(state, FRAME_S), (0.9, 0.5, 0.01))
        found = readout(state, MODEL)
        known_wrong += found.known and abs(found.offset_norm - 0.5) > 0.1
    assert known_wrong <= 6
    assert readout(state, MODEL).offset_norm == pytest.approx(0.5, abs=0.02)


def test_flying_back_right_is_left() -> None:
    state = initial_offset_state()
    for _ in range(20):
        state = seen(moved_on(state, FRAME_S), (0.9, 0.3, 0.01), heading_rad=3.1)
    assert readout(state, MODEL).offset_norm == pytest.approx(-0.3, abs=0.01)


@pytest.mark.parametrize("heading_rad", [0.3, -0.3, 3.14159 + 0.3])
def test_the_camera_ahead_of_the_body_is_taken_off(heading_rad: float) -> None:
    """The body is at 0.2 half widths of 1 m; a camera 0.5 m ahead swings out with the heading."""
    model = OffsetModel(inverse_half_width=(1.0, 0.01))
    side = 1.0 if cos(heading_rad) > 0 else -1.0
    camera = side * (0.2 + 0.5 * sin(heading_rad))
    state = initial_offset_state()
    for _ in range(30):
        frame = frame_evidence([mixture((0.9, camera, 0.01))], FRAME_S, heading_rad, (0.5, 0.0))
        state = update(moved_on(state, FRAME_S), frame, model)
    assert readout(state, model).offset_norm == pytest.approx(0.2, abs=0.01)


def test_a_velocity_across_the_corridor_carries_it_on() -> None:
    state = initial_offset_state()
    for _ in range(20):
        state = seen(moved_on(state, FRAME_S, accel=False), (0.9, 0.0, 0.01))
    for _ in range(100):
        state = moved_on(state, 0.01, accel=False)
        state = with_speed(along_path(state, state.path, MODEL)._replace(path=Path()), 0.4, 0.05**2)
    found = readout(state, MODEL)
    assert found.offset_norm == pytest.approx(0.4 * float(state.x[0, S]), abs=0.08)


@pytest.mark.parametrize("speed_m_s", [5.0, 10.0, -30.0, 99.0])
def test_a_velocity_that_cannot_be_does_not_tell_the_width(speed_m_s: float) -> None:
    state = initial_offset_state()
    for _ in range(40):
        state = seen(moved_on(state, FRAME_S), (0.9, 0.2, 0.01))
    state = along_path(state, state.path, MODEL)._replace(path=Path())
    after = with_speed(state, speed_m_s, 0.1**2)
    std = np.sqrt(state.P[0, S, S])
    assert abs(after.x[0, S] - state.x[0, S]) < 2.5 * std
    assert np.sqrt(after.P[0, S, S]) > 0.25 * std
    again = with_speed(after, 0.0, 0.1**2)  # and nothing is locked: true ones count as before
    assert again.P[0, V, V] < after.P[0, V, V]
    assert readout(again, MODEL).offset_norm == pytest.approx(0.2, abs=0.02)


def test_frames_that_each_leave_much_open_are_not_averaged_to_certainty() -> None:
    """An error that lasts stays however many frames agree, and is the larger the more each of them leaves open."""
    std = []
    for spread in (0.02, 0.06, 0.12):
        state = initial_offset_state()
        for _ in range(400):
            state = seen(moved_on(state, FRAME_S), (0.9, 0.0, spread))
        usual, whole = lasting_variances(state, MODEL)
        assert whole >= usual
        std.append(readout(state, MODEL).std_norm)
        assert std[-1] ** 2 == pytest.approx(state.P[0, Y, Y] + whole, rel=0.05)
        assert readout(state, MODEL).std_norm == pytest.approx(moments(state, MODEL)[1][Y, Y] ** 0.5)
    assert std[0] < 0.02 < std[1] < std[2]


def test_an_error_of_the_scale_grows_with_the_offset() -> None:
    centre, aside = initial_offset_state(), initial_offset_state()
    for _ in range(100):
        centre = seen(moved_on(centre, FRAME_S), (0.9, 0.0, 0.01))
        aside = seen(moved_on(aside, FRAME_S), (0.9, 0.6, 0.01))
    more = readout(aside, MODEL).std_norm ** 2 - readout(centre, MODEL).std_norm ** 2
    assert more == pytest.approx((MODEL.scale_std * 0.6) ** 2, rel=0.05)


@pytest.mark.parametrize("std", [0.01, 0.1])
def test_spread_of_known_likelihoods(std: float) -> None:
    evidence = np.array([[0.5, 0.1, std**2]])
    assert spread_about(evidence, 0.1) == pytest.approx(std**2)
    assert spread_about(evidence, 0.2) == pytest.approx(0.1**2 + std**2)
    assert spread_about(evidence, 0.9) == pytest.approx(MAX_SPREAD_NORM**2)
    assert spread_about(evidence[:0], 0.1) < 0.0
    both = np.array(
        [[0.3, 0.05, std**2], [0.3, -0.04, std**2], [0.35, 0.8, std**2]]
    )  # the place of both is likelier
    assert spread_about(both, 0.0) == pytest.approx((0.05**2 + 0.04**2) / 2 + std**2)


def test_frames_that_scatter_are_not_averaged_to_certainty() -> None:
    std = []
    for scatter in (0.0, 0.04, 0.08):
        state = initial_offset_state()
        for k in range(400):
            state = seen(moved_on(state, FRAME_S), (0.9, scatter * (-1) ** (k // 10), 0.02))
        std.append(readout(state, MODEL).std_norm)
    assert std[0] < std[1] < std[2]
    assert std[2] > 0.3 * 0.08


@pytest.mark.parametrize(("roll", "pitch"), [(0.2, 0.0), (-0.1, 0.15), (0.0, -0.3)])
def test_specific_force_is_levelled(roll: float, pitch: float) -> None:
    down = np.array([-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch)])
    R = np.array(
        [
            [cos(pitch), sin(pitch) * sin(roll), sin(pitch) * cos(roll)],
            [0.0, cos(roll), -sin(roll)],
            [-sin(pitch), cos(pitch) * sin(roll), cos(pitch) * cos(roll)],
        ]
    )
    level = np.array([0.7, -0.4, -G])
    body = R.T @ level
    assert levelled(tuple(body), tuple(down), 0.0) == pytest.approx((0.7, -0.4), abs=1e-12)
    forward, right = levelled(tuple(body), tuple(down), 0.01)
    assert (forward, right) == pytest.approx((0.7, -0.4 + 0.01 * G), abs=1e-9)


def test_the_roll_of_the_verticals_is_averaged() -> None:
    rng = np.random.default_rng(5)
    state = initial_offset_state()
    for _ in range(200):
        state = with_roll(state, 0.012 + 0.003 * rng.normal(), 0.003, FRAME_S)
    assert state.roll.mean == pytest.approx(0.012, abs=0.003)


def test_backward_transitions_undo_forward_ones() -> None:
    path = Path(0.2, 0.2, 0.05, 0.004, 0.001)
    F, Q = transition(path, MODEL)
    back, Q_back = transition(path, MODEL, backward=True)
    np.testing.assert_allclose(back @ F, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(Q_back, back @ Q @ back.T, rtol=1e-9, atol=1e-15)


def test_without_accelerometer_the_way_back_is_as_uncertain_as_the_way_there() -> None:
    F, Q = transition(Path(0.2), MODEL)
    back, Q_back = transition(Path(0.2), MODEL, backward=True)
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])  # time turned round: the rate changes its sign
    np.testing.assert_allclose(back, mirror @ F @ mirror, atol=1e-15)
    np.testing.assert_allclose(Q_back, mirror @ Q @ mirror, atol=1e-15)


@pytest.mark.parametrize("gap_s", [0.05, 1.0, 20.0])
def test_one_frame_alone_is_not_relied_on_however_late_it_comes(gap_s: float) -> None:
    state = initial_offset_state()
    for place in (-0.5, 0.4):
        state = update(state, frame_evidence([mixture((0.95, place, 0.01))], gap_s, 0.0, (0.0, 0.0)), MODEL)
        found = readout(state, MODEL)
        assert not (found.known and found.offset_norm == pytest.approx(place, abs=0.1))


@pytest.mark.parametrize("frame_s", [0.02, 0.05, 0.2])
def test_known_within_a_second_at_any_rate_of_frames(frame_s: float) -> None:
    state, t_s = initial_offset_state(), 0.0
    while not readout(state, MODEL).known:
        evidence = frame_evidence([mixture((0.85, 0.2, 0.02))], frame_s if t_s else nan, 0.0, (0.0, 0.0))
        state = update(moved_on(state, frame_s), evidence, MODEL)
        t_s += frame_s
        assert t_s < 1.5
    assert t_s > 0.1


def test_smoothed_is_better_knows_the_start_and_mirrors() -> None:
    flight = Flight(6, weave)
    rng = np.random.default_rng(7)

    def evidence(t: float) -> OffsetMixture:
        if t < 1.0:
            return mixture((0.45, weave(t), 0.02), (0.45, weave(t) - 0.4, 0.02))
        return mixture((0.8, weave(t) + 0.02 * rng.normal(), 0.02))

    steps, times, out = flight.run(8.0, evidence)
    smooth = smoothed_offsets(steps, MODEL)
    truth = np.array([weave(t) for t in times])

    def rmse(readouts: Sequence[OffsetReadout]) -> float:
        y = np.array([o.offset_norm for o in readouts])
        return float(np.sqrt(np.mean((y - truth)[20:] ** 2)))

    assert not out[10].known
    assert smooth[10].known
    assert smooth[10].offset_norm == pytest.approx(truth[10], abs=0.05)
    assert rmse(smooth) < rmse(out)
    z = np.abs(np.array([o.offset_norm for o in smooth]) - truth) / np.array([o.std_norm for o in smooth])
    assert np.percentile(z, 90) < 2.4
    between = 0.5 * (times[1:] + times[:-1])
    y, std, known = at_times(times, smooth, between)
    assert known.all()
    assert np.sqrt(np.mean((y - np.array([weave(t) for t in between])) ** 2)) < 0.03
    assert (std > 0.0).all()


@pytest.mark.parametrize("accel", [True, False])
@pytest.mark.parametrize("gap_s", [1.0, 2.0, 4.0])
def test_where_no_frame_comes_for_seconds_the_smoothed_offset_follows_the_motion(
    accel: bool, gap_s: float
) -> None:
    """Interpolated over the gap, it would be beyond nine of its sigmas."""
    flight = Flight(3, lambda t: 0.3 * sin(2.0 * t), roughness=0.1)
    start_s, seconds = 4.0, 8.0 + gap_s
    state, steps, seen_s = initial_offset_state(), OffsetSteps(), 0.0
    for k in range(1, round(seconds / IMU_S) + 1):
        t = k * IMU_S
        force = (0.0, flight.accel(t), -G) if accel else None
        state, step = propagate(state, IMU_S, 0.0, force, LEVEL), None
        if k % 10 == 0 and not start_s < t < start_s + gap_s:
            seen = mixture((0.9, flight.y(t) + 0.01 * flight.rng.normal(), 0.01))
            frame = frame_evidence([seen], t - seen_s if seen_s else nan, 0.0, (0.0, 0.0))
            path, seen_s = state.path, t
            state = update(state, frame, MODEL)
            step = OffsetStep(path, state, frame)
        steps.add(round(t * 1e9), step, state)
    times = np.array(steps.t_ns) * 1e-9
    assert np.diff(times).max() < LONGEST_STEP_S + 0.1
    at = np.arange(2.0, seconds - 1.0, 0.02)
    y, std, known = at_times(times, smoothed_offsets(steps.steps, MODEL), at)
    error = np.abs(y - np.array([flight.y(t) for t in at]))
    assert (error / std)[known].max() < 4.0
    inside = (at > start_s + 0.1) & (at < start_s + gap_s - 0.1)
    assert known[~inside].mean() > 0.9
    if accel and gap_s <= 2.0:
        assert known[inside].all()


def test_behind_the_last_frame_motion_makes_no_steps() -> None:
    """There the filter's offset is the smoother's."""
    state, steps = moved_on(initial_offset_state(), FRAME_S), OffsetSteps()
    path, frame = state.path, frame_evidence([mixture((0.9, 0.2, 0.01))], nan, 0.0, (0.0, 0.0))
    state = update(state, frame, MODEL)
    steps.add(0, OffsetStep(path, state, frame), state)
    for k in range(1, 200):
        state = moved_on(state, FRAME_S)
        steps.add(round(k * FRAME_S * 1e9), None, state)
    assert len(steps.steps) == 1


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.1, 2.0), st.floats(0.1, 2.0))
def test_a_path_less_its_beginning_is_its_end(right: float, later: float, t_s: float, later_s: float) -> None:
    start, end = (
        moved_on(initial_offset_state(), t_s, right).path,
        moved_on(initial_offset_state(), later_s, later).path,
    )
    np.testing.assert_allclose(start.followed_by(end).since(start), end, atol=1e-9)


def test_the_smoother_does_not_look_into_another_corridor() -> None:
    state, steps = initial_offset_state(), []
    for k in range(40):
        fresh = k == 20
        if fresh:
            state = in_new_corridor(state)
        state = moved_on(state, FRAME_S)
        path = state.path
        frame = frame_evidence([mixture((0.9, -0.4 if k < 20 else 0.5, 0.01))], FRAME_S, 0.0, (0.0, 0.0))
        state = update(state, frame, MODEL)
        steps.append(OffsetStep(path, state, frame, is_reset=fresh))
    smooth = smoothed_offsets(steps, MODEL)
    assert [round(o.offset_norm, 2) for o in smooth] == [-0.4] * 20 + [0.5] * 20


some_frames = st.lists(
    st.lists(
        st.tuples(st.floats(0.01, 1.0), st.floats(-0.95, 0.95), st.floats(0.005, 0.2)), min_size=0, max_size=8
    ),
    min_size=1,
    max_size=25,
)


def normalised(parts: Parts) -> OffsetMixture:
    total = sum(p[0] for p in parts) + 0.1
    return mixture(*((w / total, y, std) for w, y, std in parts))


@settings(max_examples=60, deadline=None)
@given(some_frames, st.floats(-2.0, 2.0), st.booleans())
def test_weights_sum_to_one_and_covariances_are_symmetric_and_positive(
    frames: list[Parts], right_m_s2: float, accel: bool
) -> None:
    state = initial_offset_state()
    for parts in frames:
        state = moved_on(state, FRAME_S, right_m_s2, accel)
        before = [a.copy() for a in (state.x, state.P, state.weight)]
        after = update(state, frame_evidence([normalised(parts)], FRAME_S, 0.1, (0.06, 0.0)), MODEL)
        for old, kept in zip(before, (state.x, state.P, state.weight), strict=True):
            np.testing.assert_array_equal(old, kept)  # a snapshot stays what it was
        state = after
        assert state.weight.sum() == pytest.approx(1.0)
        assert (state.weight >= 0.0).all()
        assert len(state.x) <= MAX_HYPOTHESES
        for P in state.P:
            np.testing.assert_array_equal(P, P.T)
            scale = np.sqrt(np.diag(P))
            assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > -1e-9


@settings(max_examples=40, deadline=None)
@given(some_frames, st.floats(-1.0, 1.0))
def test_a_mirrored_flight_gives_the_mirrored_offset(frames: list[Parts], right_m_s2: float) -> None:
    one, other = initial_offset_state(), initial_offset_state()
    for parts in frames:
        one, other = moved_on(one, FRAME_S, right_m_s2), moved_on(other, FRAME_S, -right_m_s2)
        mirrored = [(w, -y, std) for w, y, std in parts]
        one = update(one, frame_evidence([normalised(parts)], FRAME_S, 0.0, (0.0, 0.0)), MODEL)
        other = update(other, frame_evidence([normalised(mirrored)], FRAME_S, 0.0, (0.0, 0.0)), MODEL)
    a, b = readout(one, MODEL), readout(other, MODEL)
    assert a.probability == pytest.approx(b.probability, abs=1e-6)
    if a.known:
        assert a.offset_norm == pytest.approx(-b.offset_norm, abs=1e-9)
        assert a.std_norm == pytest.approx(b.std_norm, rel=1e-6)


@pytest.mark.parametrize("factor", [0.3, 5.0])
@pytest.mark.parametrize("accel", [True, False])
def test_scale_free_offset_does_not_depend_on_the_scale(factor: float, accel: bool) -> None:
    """Where all that is metric grows with the corridor, nothing else changes."""

    def flown(scale: float) -> list[OffsetReadout]:
        grown = {
            name: getattr(MODEL, name) * scale
            for name in (
                "accel_noise",
                "accel_bias_std",
                "accel_bias_walk",
                "rough_limit",
                "velocity_std_m_s",
                "start_velocity_std_m_s",
            )
        }
        s, s_std = MODEL.inverse_half_width
        model = MODEL._replace(inverse_half_width=(s / scale, s_std / scale), **grown)
        rng, state, out = np.random.default_rng(3), initial_offset_state(), []
        for k in range(1, 81):
            for i in range(10):
                t = (10 * k - 9 + i) * IMU_S
                force = (0.0, scale * (-0.9 * 0.9 * weave(t) + 0.2 * rng.normal()), -G)
                state = propagate(state, IMU_S, 0.0, force if accel else None, LEVEL)
            if k > 60:  # no frames: carried on
                state = with_speed(
                    along_path(state, state.path, model)._replace(path=Path()), 0.1 * scale, scale**2
                )
            else:
                told = mixture((0.6, weave(k * FRAME_S), 0.02), (0.2, 0.5, 0.02))
                state = update(state, frame_evidence([told], FRAME_S, 0.0, (0.0, 0.0)), model)
            out.append(readout(state, model))
        return out

    one, other = flown(1.0), flown(factor)
    assert any(o.known for o in one)
    for a, b in zip(one, other, strict=True):
        assert b.known == a.known
        assert b[:5] == pytest.approx(a[:5], rel=1e-6, abs=1e-9)


def test_the_same_samples_give_the_same_bits() -> None:
    def last() -> OffsetState:
        steps, _, _ = Flight(8, weave).run(3.0, lambda t: mixture((0.5, weave(t), 0.02), (0.3, 0.4, 0.02)))
        return steps[-1].after

    a, b = last(), last()
    for left, right in zip((a.x, a.P, a.weight), (b.x, b.P, b.weight), strict=True):
        assert left.tobytes() == right.tobytes()


def test_an_offset_carried_on_for_long_is_unknown_not_stale() -> None:
    flight = Flight(9, weave)
    steps, _, out = flight.run(5.0, lambda t: mixture((0.9, weave(t), 0.01)))
    assert out[-1].known
    state, known_s = steps[-1].after, 0.0
    while readout(state, MODEL).known and known_s < inf:
        state = moved_on(state, 0.1)
        known_s += 0.1
    assert 0.5 < known_s < 6.0
    assert readout(state, MODEL).evidence_age_s == pytest.approx(known_s, abs=0.01)
