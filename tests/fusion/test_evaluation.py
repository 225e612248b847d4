from __future__ import annotations

import json
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pytest

from fusion.estimator.tables import ESTIMATE_DTYPE, FRAME_DTYPE
from fusion.evaluation.errors import evaluate, interpolate_truth, mae, rmse
from fusion.flight import CorridorTruth, TimeArray
from vision.rotations import wrap

UNIX_NS = 1_600_000_000_000_000_000


def make_truth(
    heading_rad: npt.ArrayLike,
    *,
    dt_s: float = 0.1,
    corridor_id: npt.ArrayLike | None = None,
    in_junction: npt.ArrayLike | None = None,
    offset_m: float = 0.2,
    width_m: float = 2.0,
) -> CorridorTruth:
    heading = np.asarray(heading_rad, dtype=float)
    n = len(heading)
    return CorridorTruth(
        t_ns=UNIX_NS + np.arange(n, dtype=np.int64) * round(dt_s * 1e9),
        heading_rad=heading,
        lateral_offset_m=np.full(n, offset_m),
        corridor_width_m=np.full(n, width_m),
        corridor_id=np.ones(n, dtype=np.int64) if corridor_id is None else np.asarray(corridor_id),
        in_junction=np.zeros(n, dtype=bool) if in_junction is None else np.asarray(in_junction, dtype=bool),
    )


def make_estimates(
    t_ns: TimeArray,
    heading_rad: npt.ArrayLike,
    std_rad: npt.ArrayLike = 0.01,
    status: str | Sequence[str] = "tracking",
    offset_m: float = 0.2,
    offset_norm: float = 0.2,
) -> npt.NDArray[np.void]:
    table = np.zeros(len(t_ns), dtype=ESTIMATE_DTYPE)
    table["timestamp_ns"], table["heading_rad"], table["heading_std_rad"] = t_ns, heading_rad, std_rad
    table["lateral_offset_m"], table["lateral_offset_std_m"] = offset_m, 0.05
    table["lateral_offset_norm"], table["lateral_offset_norm_std"] = offset_norm, 0.05
    table["status"] = status
    return table


def test_rmse_and_mae_of_known_errors() -> None:
    assert rmse([3.0, -4.0], [0.0, 0.0]) == pytest.approx(np.sqrt(12.5))
    assert mae([3.0, -4.0], [0.0, 0.0]) == pytest.approx(3.5)


def test_angles_are_compared_along_the_shorter_arc() -> None:
    assert rmse([3.1], [-3.1], angle=True) == pytest.approx(2 * np.pi - 6.2)
    assert mae([3.1], [-3.1]) == pytest.approx(6.2)


@pytest.mark.parametrize("function", [rmse, mae])
def test_shapes_must_agree_and_hold_something(function: Callable[..., float]) -> None:
    with pytest.raises(ValueError, match="must agree"):
        function([1.0, 2.0], [1.0])
    with pytest.raises(ValueError, match="nothing to compare"):
        function([], [])


def test_truth_is_interpolated_across_half_a_turn() -> None:
    at = interpolate_truth(make_truth([np.pi - 0.1, -np.pi + 0.1]), np.array([UNIX_NS + 50_000_000]))
    assert abs(wrap(at.heading_rad[0] - np.pi)) < 1e-12
    assert at.lateral_offset_norm[0] == pytest.approx(0.2)


def test_truth_is_exact_at_its_own_times_and_keeps_nanoseconds() -> None:
    truth = make_truth([0.0, 1.0], dt_s=1e-6)
    at = interpolate_truth(truth, np.array([UNIX_NS, UNIX_NS + 250, UNIX_NS + 1000]))
    assert at.heading_rad == pytest.approx([0.0, 0.25, 1.0])


def test_no_value_between_corridors_nor_in_a_hole() -> None:
    t = UNIX_NS + np.array([50_000_000, 150_000_000, 250_000_000])
    two = interpolate_truth(make_truth([0.0, 0.0, 1.5, 1.5], corridor_id=[1, 1, 2, 2]), t)
    assert two.known.tolist() == [True, False, True]
    assert np.isnan(two.heading_rad[1])
    sparse = interpolate_truth(make_truth([0.0, 0.0], dt_s=0.8), np.array([UNIX_NS, UNIX_NS + 400_000_000]))
    assert sparse.known.tolist() == [True, False]


def test_constant_errors_give_exactly_those_statistics() -> None:
    truth = make_truth(np.linspace(-0.3, 0.3, 11))
    error = np.tile([0.02, -0.01], 5)
    table = make_estimates(truth.t_ns[:10], truth.heading_rad[:10] + error, offset_m=0.25, offset_norm=0.1)
    out = evaluate(table, truth)
    heading = out["heading"]
    assert heading["count"] == out["judged"] == out["rows"] == 10
    assert heading["rmse_rad"] == pytest.approx(np.sqrt((0.02**2 + 0.01**2) / 2))
    assert heading["mae_rad"] == pytest.approx(0.015)
    assert heading["max_rad"] == pytest.approx(0.02)
    assert heading["bias_rad"] == pytest.approx(0.005)
    assert heading["nees_mean"] == pytest.approx((4 + 1) / 2)
    assert heading["error_over_sigma_p90"] == pytest.approx(2.0)
    assert out["lateral_offset_m"]["rmse_m"] == pytest.approx(0.05)
    assert out["lateral_offset_m"]["nees_mean"] == pytest.approx(1.0)
    assert out["lateral_offset_norm"]["bias_norm"] == pytest.approx(-0.1)


def test_percentiles_are_those_of_the_absolute_error() -> None:
    truth = make_truth(np.zeros(101))
    table = make_estimates(truth.t_ns, np.linspace(-1.0, 1.0, 101))
    heading = evaluate(table, truth)["heading"]
    assert heading["p50_rad"] == pytest.approx(0.5, abs=0.011)
    assert heading["p90_rad"] == pytest.approx(0.90, abs=0.011)
    assert heading["p95_rad"] == pytest.approx(0.96, abs=0.011)
    assert heading["p99_rad"] == pytest.approx(1.0, abs=0.011)


def test_honest_sigmas_give_a_nees_of_one() -> None:
    truth = make_truth(np.zeros(20_000), dt_s=0.005)
    noise = np.random.default_rng(1).normal(0.0, 0.01, 20_000)
    heading = evaluate(make_estimates(truth.t_ns, noise), truth)["heading"]
    assert heading["nees_mean"] == pytest.approx(1.0, abs=0.04)
    assert heading["error_over_sigma_p90"] == pytest.approx(1.645, abs=0.04)


def test_every_excluded_row_is_counted_once() -> None:
    truth = make_truth(
        np.zeros(20), in_junction=np.arange(20) >= 15, corridor_id=np.where(np.arange(20) < 18, 1, 2)
    )
    t_ns = UNIX_NS + np.array([-100, 0, 300, 600, 1000, 1550, 1750, 5000]) * 1_000_000
    status = ["tracking", "tracking", "coasting", "lost", "tracking", "tracking", "tracking", "tracking"]
    out = evaluate(make_estimates(t_ns, 0.5, status=status), truth)
    assert out["excluded"] == {"outside_truth": 2, "junction": 2, "no_truth": 0, "not_tracking": 2}
    assert out["judged"] == 2
    assert out["rows"] == out["judged"] + sum(out["excluded"].values())
    assert out["status_share"] == {"coasting": 0.125, "lost": 0.125, "tracking": 0.75}


def test_frames_are_judged_by_acceptance_and_have_no_metres() -> None:
    truth = make_truth(np.zeros(5))
    table = np.zeros(5, dtype=FRAME_DTYPE)
    table["timestamp_ns"], table["accepted"] = truth.t_ns, [True, True, False, True, True]
    table["heading_rad"], table["heading_std_rad"] = [0.1, 0.1, 2.0, 0.1, 0.1], 0.1
    table["lateral_offset_norm"] = np.nan
    out = evaluate(table, truth)
    assert out["excluded"]["not_accepted"] == 1
    assert out["heading"]["max_rad"] == pytest.approx(0.1)
    assert out["lateral_offset_norm"] == {
        "count": 0,
        **dict.fromkeys(f"{w}_norm" for w in ("rmse", "mae", "max", "p50", "p90", "p95", "p99", "bias")),
        "nees_mean": None,
        "error_over_sigma_p90": None,
    }
    assert "lateral_offset_m" not in out
    assert "status_share" not in out


def test_corridors_are_judged_apart() -> None:
    truth = make_truth(np.zeros(10), corridor_id=np.repeat([1, 7], 5))
    table = make_estimates(truth.t_ns, np.repeat([0.1, -0.3], 5))
    corridors = evaluate(table, truth)["corridors"]
    assert list(corridors) == ["1", "7"]
    assert corridors["1"]["heading"]["bias_rad"] == pytest.approx(0.1)
    assert corridors["7"]["heading"]["bias_rad"] == pytest.approx(-0.3)
    assert corridors["7"]["rows"] == 5
    assert corridors["7"]["status_share"] == {"tracking": 1.0}


def test_nothing_in_common_is_said_with_none_and_is_valid_json() -> None:
    truth = make_truth(np.zeros(5))
    table = make_estimates(truth.t_ns + 10**12, 0.0)
    out = json.loads(json.dumps(evaluate(table, truth).to_dict(), allow_nan=False))
    assert out["judged"] == 0
    assert out["heading"]["rmse_rad"] is None
    assert evaluate(table, make_truth([]))["excluded"]["outside_truth"] == 5


def test_unknown_sigmas_leave_the_errors_standing() -> None:
    truth = make_truth(np.zeros(4))
    heading = evaluate(make_estimates(truth.t_ns, 0.2, std_rad=[np.nan, 0.1, 0.0, 0.1]), truth)["heading"]
    assert heading["count"] == 4
    assert heading["nees_mean"] == pytest.approx(4.0)


def test_a_result_reads_by_attribute_and_as_the_json_it_is_written_as() -> None:
    truth = make_truth(np.zeros(10))
    errors = evaluate(make_estimates(truth.t_ns, 0.1), truth)
    assert errors.heading.rmse == errors["heading"]["rmse_rad"] == pytest.approx(0.1)
    assert dict(errors) == errors.to_dict()
    frames = np.zeros(10, dtype=FRAME_DTYPE)
    frames["timestamp_ns"] = truth.t_ns
    assert evaluate(frames, truth).lateral_offset_m is None
    with pytest.raises(KeyError):
        evaluate(frames, truth)["lateral_offset_m"]
