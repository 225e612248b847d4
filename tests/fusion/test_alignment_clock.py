"""Time offset and ratio of turns from made-up headings, whose answers are known."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion.alignment.clock import ClockSearch, corridors_of, find_clock
from fusion.alignment.turning import Turning
from fusion.alignment.views import Sightings

DURATION_S = 20.0
GYRO_HZ, FRAME_HZ = 200.0, 20.0


def weave(seed: int, amplitude_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rates, phases and weights of some sinusoids: the heading is their sum."""
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0.5, 1.0, 5)
    edges = np.array([0.4, 0.8, 1.2, 1.8, 2.4, 3.2])
    return (
        rng.uniform(edges[:-1], edges[1:]),
        rng.uniform(0, 2 * pi, 5),
        amplitude_rad * weights / weights.sum(),
    )


def heading(t: np.ndarray, curve: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    rates, phases, weights = curve
    return np.asarray((weights * np.sin(np.multiply.outer(t, rates) + phases)).sum(axis=-1))


def turning(seed: int, curve: tuple[np.ndarray, ...], noise: float = 0.005, bias: float = 0.02) -> Turning:
    """What a noisy gyroscope with a bias integrates to."""
    rng = np.random.default_rng((seed, 1))
    t = np.arange(-3.0, DURATION_S + 3.0, 1 / GYRO_HZ)
    walk = np.cumsum(rng.normal(0, noise / np.sqrt(GYRO_HZ), len(t)))
    yaw = heading(t, curve) + bias * t + walk + 1.0  # type: ignore[arg-type]
    down = np.tile([0.0, 0.0, 1.0], (len(t), 1))
    return Turning(t, yaw, down, np.full(len(t), 0.01), 0.1, True, noise)


def sightings(t_s: np.ndarray, heading_rad: np.ndarray, std_rad: float) -> Sightings:
    return Sightings.of_headings(t_s, heading_rad, np.full(len(t_s), std_rad))


def look(
    seed: int,
    offset_s: float,
    ratio: float = 1.0,
    amplitude_deg: float = 15.0,
    noise_deg: float = 0.15,
    gross_share: float = 0.0,
    lost: tuple[float, float] = (0.0, 0.0),
    axis: float = 0.0,
    reach_s: float = 3.0,
) -> ClockSearch:
    """Look for the offset in a flight that has it; ``axis`` turns the corridor half way through."""
    rng = np.random.default_rng((seed, 2))
    curve = weave(seed, radians(amplitude_deg))
    t = np.arange(0.0, DURATION_S, 1 / FRAME_HZ)  # as stamped: taken offset_s later by the gyroscope's clock
    seen = ratio * heading(t + offset_s, curve) + rng.normal(0, radians(noise_deg), len(t))
    seen = seen + np.where(t > DURATION_S / 2, axis, 0.0)
    gross = rng.random(len(t)) < gross_share
    seen[gross] += rng.uniform(radians(10), radians(80), int(gross.sum()))
    seen = (seen + pi / 2) % pi - pi / 2
    keep = (t < lost[0]) | (t > lost[1])
    return find_clock(sightings(t[keep], seen[keep], radians(noise_deg)), turning(seed, curve), reach_s)


@given(st.integers(0, 10_000), st.floats(-2.4, 2.4), st.floats(0.8, 1.25))
@settings(max_examples=25, deadline=None)
def test_any_offset_and_ratio_is_found(seed: int, offset_s: float, ratio: float) -> None:
    found = look(seed, offset_s, ratio)
    assert found.determined
    fit = found.fit
    assert fit is not None
    assert abs(fit.offset_s - offset_s) < max(0.005, 5.0 * fit.offset_std_s)
    assert abs(fit.ratio - ratio) < 5.0 * fit.ratio_std


def test_sigmas_are_those_of_many_flights() -> None:
    fits = [look(seed, 0.4, 1.03).fit for seed in range(24)]
    z = np.array(
        [((f.offset_s - 0.4) / f.offset_std_s, (f.ratio - 1.03) / f.ratio_std) for f in fits if f is not None]
    )
    assert len(z) == 24
    stds_s = [
        f.offset_std_s for f in fits if f is not None
    ]  # a rare drawing turns so evenly that it tells less
    assert max(stds_s) < 0.008
    assert np.median(stds_s) < 0.004
    assert np.all(np.abs(z.mean(axis=0)) < 0.5), z.mean(axis=0)
    assert np.all(z.std(axis=0) < 1.3), z.std(axis=0)
    assert np.all(z.std(axis=0) > 0.55), z.std(axis=0)


def test_the_gyroscopes_noise_does_not_shrink_the_ratio() -> None:
    """Noise of the regressor would: by 4 % here, many times the mean's own scatter, were nothing done about it."""
    ratios = [look_noisy(seed) for seed in range(25)]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.01)


def look_noisy(seed: int) -> float:
    curve = weave(seed, radians(8))
    t = np.arange(0.0, DURATION_S, 1 / FRAME_HZ)
    seen = heading(t, curve) + np.random.default_rng((seed, 2)).normal(0, radians(0.05), len(t))
    found = find_clock(sightings(t, seen, radians(0.05)), turning(seed, curve, noise=0.005), 1.0)
    assert found.fit is not None
    return found.fit.ratio


@pytest.mark.parametrize(
    "trouble",
    [
        {"gross_share": 0.15},
        {"lost": (6.0, 11.0)},
        {"axis": radians(-65)},
        {"axis": radians(90), "gross_share": 0.1},
        {"noise_deg": 0.8},
        {"amplitude_deg": 60.0},  # past a right angle the corridor is seen from its other end
    ],
    ids=str,
)
def test_trouble_does_not_fool_it(trouble: dict[str, float]) -> None:
    found = look(4, -1.3, 0.97, **trouble)  # type: ignore[arg-type]
    assert found.determined
    assert found.fit is not None
    assert found.fit.offset_s == pytest.approx(-1.3, abs=max(0.005, 4 * found.fit.offset_std_s))
    assert found.fit.ratio == pytest.approx(0.97, abs=4 * found.fit.ratio_std)
    assert found.fit.n_corridors == (2 if "axis" in trouble else 1)


def test_no_turning_is_told_as_such() -> None:
    for seed in range(8):
        found = look(seed, 0.5, amplitude_deg=0.0)
        assert not found.determined


def test_a_periodic_motion_is_ambiguous() -> None:
    curve = (np.array([2 * pi / 2.0]), np.array([0.3]), np.array([radians(15)]))
    t = np.arange(0.0, DURATION_S, 1 / FRAME_HZ)
    seen = heading(t + 0.2, curve) + np.random.default_rng(0).normal(0, radians(0.2), len(t))
    found = find_clock(sightings(t, seen, radians(0.2)), turning(0, curve), 3.0)
    assert not found.determined
    assert found.rival_s is not None
    assert found.fit is not None
    assert (found.rival_s - found.fit.offset_s) % 1.0 == pytest.approx(
        0.0, abs=0.05
    )  # half a period, or whole ones


def test_an_offset_beyond_reach_is_not_made_up() -> None:
    found = look(2, 2.5, reach_s=1.0)
    assert not found.determined


def test_opposite_turns_are_noticed() -> None:
    found = look(3, 0.1, ratio=-1.0)
    assert not found.determined
    assert found.reversed


def test_corridors_are_levels() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0, 30, 0.1)
    level = np.where(t < 10, 0.2, np.where(t < 20, 1.5, 0.2))
    constant = level + rng.normal(0, radians(0.4), 300)
    gross = rng.random(300) < 0.1
    constant[gross] += 0.5
    wrapped = (constant + pi / 2) % pi - pi / 2
    corridor, unwrapped = corridors_of(t, wrapped)
    assert set(corridor[~gross][20:80]) == {0}
    assert len(set(corridor[corridor >= 0])) == 3
    for number in range(3):
        assert np.ptp(unwrapped[corridor == number]) < radians(10)
    assert np.mean(corridor[gross] >= 0) < 0.1
