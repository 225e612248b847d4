"""The benchmarks run and print what they say; what they do to pictures is what they say; their scores count right."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pictures
import pytest

from support import cases, harmless, perturb, ransac, scenes, scores
from tests.files import HALLWAY, OFFICE, ROOT
from vision import Attitude, Camera, FrameMeasurement, Reason
from vision.cameras.camera import Distortion
from vision.rotations import rotation_from_angles

RNG = np.random.default_rng
CAMERA = Camera.from_fov(160, 120, math.radians(70))


def grey(value: int = 128, shape: tuple[int, int] = (120, 160)) -> np.ndarray:
    return np.full(shape, value, np.uint8)


def case_of(image: np.ndarray, **changes: Any) -> cases.Case:
    case = cases.Case("test", 0, image, CAMERA, Attitude(0.01, -0.02), (0.1,))
    return replace(case, **changes)


def result_of(
    error_deg: float, *, accepted: bool = True, std_deg: float = 1.0, offset_error: float = math.nan
) -> cases.Result:
    return cases.Result(
        source="test",
        index=0,
        accepted=accepted,
        reason="ok" if accepted else "ambiguous",
        n_lines=9,
        n_inliers=5,
        truth_rad=0.0,
        heading_rad=math.radians(error_deg),
        error_rad=math.radians(error_deg),
        std_rad=math.radians(std_deg),
        second_score=0.1,
        elevation_rad=0.0,
        offset_norm=0.0,
        offset_error_norm=offset_error,
        offset_std_norm=0.02,
        vision_ms=1.0,
        exact=True,
    )


def mounted(yaw_rad: float, pitch_rad: float) -> np.ndarray:
    """Rotation from the optical frame of a camera that looks aside and down."""
    return rotation_from_angles(yaw_rad, pitch_rad, 0.0).T @ Camera.from_fov(8, 8, 1.0).R_body_camera


@pytest.fixture(scope="module")
def corridor_view() -> cases.Case:
    """Return a simulated view that shows heading and offset plainly."""
    views = list(cases.simulated_cases((320, 240), 4, 3))
    results = [cases.measure(case)[0] for case in views]
    plain = [r.n_inliers > 12 and r.second_score < 0.3 and math.isfinite(r.answer_norm) for r in results]
    return views[plain.index(True)]


# --- what is done to pictures ---


def test_rolling_shutter_moves_rows_in_proportion_to_their_time() -> None:
    # A smooth wave has one phase per row, so that shifts can be read to a hundredth of a pixel.
    x = np.arange(160)
    image = np.repeat(np.round(128 + 100 * np.sin(2 * np.pi * x / 40)).astype(np.uint8)[None, :], 121, axis=0)
    skewed = perturb.skewed_picture(image, 12.0)
    inner = slice(20, 140)

    def phase_px(row: np.ndarray) -> float:
        wave = np.exp(-2j * np.pi * x[inner] / 40)
        return float(np.angle(np.sum((row[inner] - 128.0) * wave)) * 40 / (2 * np.pi))

    reference = phase_px(image[0])
    for y, expected in ((0, -6.0), (30, -3.0), (60, 0.0), (90, 3.0), (120, 6.0)):
        assert phase_px(skewed[y]) - reference == pytest.approx(expected, abs=0.05)


def test_rolling_shutter_turns_with_the_camera() -> None:
    """While the camera turns right the scene moves left, most in the rows read last."""
    image = grey(0)
    image[:, 80] = 255
    right = perturb.with_rolling_shutter(case_of(image), RNG(0)).image
    left = perturb.with_rolling_shutter(case_of(image, index=1), RNG(0)).image
    assert right[-1].argmax() < 80 < right[0].argmax()
    assert left[-1].argmax() > 80 > left[0].argmax()
    total_px = CAMERA.fx_px * perturb.TURN_RATE_RAD_S * perturb.READOUT_S
    assert int(right[0].argmax()) - int(right[-1].argmax()) == pytest.approx(total_px, abs=1.01)


@pytest.mark.parametrize("askew", [False, True])
def test_cover_hides_a_fifth(askew: bool) -> None:
    for seed in range(10):
        mask = perturb.cover_mask((240, 320), 0.20, askew, RNG(seed))
        assert mask.mean() == pytest.approx(0.20, abs=0.006)
        rim = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
        assert not rim.any()


def test_cover_leaves_the_rest_alone() -> None:
    image = RNG(1).integers(0, 256, (120, 160), dtype=np.uint8)
    covered = perturb.with_cover()(case_of(image), RNG(2)).image
    assert (covered != image).mean() == pytest.approx(0.20, abs=0.01)
    assert len(np.unique(covered[covered != image])) == 1


def test_motion_blur_is_as_long_as_said() -> None:
    for length, angle in ((6.0, 0.0), (15.0, 0.0), (15.0, 1.0), (6.0, math.pi / 2)):
        kernel = perturb.motion_kernel(length, angle).astype(float)
        half = kernel.shape[0] // 2
        y, x = np.mgrid[-half : half + 1, -half : half + 1]
        along = x * math.cos(angle) + y * math.sin(angle)
        across = -x * math.sin(angle) + y * math.cos(angle)
        assert kernel.sum() == pytest.approx(1.0)
        assert (kernel * along).sum() == pytest.approx(0.0, abs=1e-6)
        # A smear of length L has variance L^2 / 12; splitting it over pixels adds at most a quarter each way.
        assert (kernel * along**2).sum() == pytest.approx(length**2 / 12, abs=0.26)
        assert (kernel * across**2).sum() < 0.26


def test_even_frames_are_blurred_level() -> None:
    image = grey(0)
    image[60, 80] = 255
    blurred = perturb.with_motion_blur(15.0)(case_of(image), RNG(0)).image
    rows, columns = np.nonzero(blurred)
    assert set(rows) == {60}
    assert columns.max() - columns.min() + 1 in (15, 16, 17)


def test_light_follows_the_tone_curve() -> None:
    dark = perturb.exposed_picture(grey(200), 0.15, RNG(0))
    assert dark.mean() == pytest.approx(200 * 0.15 ** (1 / 2.2), rel=0.01)
    assert dark.std() > 0.5
    bright = perturb.exposed_picture(grey(100), 4.0, RNG(0))
    np.testing.assert_allclose(bright, 100 * 4.0 ** (1 / 2.2), atol=0.51)
    assert (perturb.exposed_picture(grey(200), 4.0, RNG(0)) == 255).all()


def test_noise_and_dark_grey() -> None:
    noisy = perturb.with_noise(10.0)(case_of(grey()), RNG(0)).image
    assert noisy.std() == pytest.approx(10.0, rel=0.05)
    dark = perturb.with_grey_scaled(0.15, 1.5)(case_of(grey(200)), RNG(0)).image
    assert dark.mean() == pytest.approx(30.0, abs=0.2)
    assert dark.std() == pytest.approx(1.5, rel=0.1)


def test_jpeg_and_defocus_lose_detail() -> None:
    image = RNG(3).integers(0, 256, (120, 160), dtype=np.uint8)
    assert perturb.with_defocus(2.0)(case_of(image), RNG(0)).image.std() < 0.25 * image.std()
    assert 0 < np.abs(perturb.with_jpeg(30)(case_of(image), RNG(0)).image.astype(int) - image).mean() < 60


@pytest.mark.parametrize("roll_deg", [-20.0, 7.0, 20.0])
def test_roll_shows_the_same_directions(roll_deg: float) -> None:
    """What a pixel of the rolled picture shows lies in the direction its camera and roll say."""
    y, x = np.mgrid[0:120, 0:160]
    image = (x + 0.5 * y).astype(np.uint8)
    rolled, camera = perturb.rolled_picture(image, CAMERA, math.radians(roll_deg))
    pixels = np.array([[40.0, 30.0], [120.0, 30.0], [80.0, 60.0], [10.0, 110.0], [155.0, 5.0]])
    level = Attitude(math.radians(roll_deg), 0.0).R_level_body()
    rays = camera.rays(pixels) @ (level @ camera.R_body_camera).T
    before = CAMERA.project(rays @ CAMERA.R_body_camera)
    assert (before >= 0).all()
    assert (before < (160, 120)).all()  # the corners stay filled
    shown = rolled[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    np.testing.assert_allclose(shown, before[:, 0] + 0.5 * before[:, 1], atol=1.6)


def test_roll_tilt_and_focal_length_say_what_they_did() -> None:
    case = case_of(grey())
    rolled = perturb.with_roll(math.radians(20))(case, RNG(0))
    assert rolled.attitude is not None
    assert 0 < abs(rolled.attitude.roll_rad - 0.01) <= math.radians(20)
    assert rolled.attitude.pitch_rad == -0.02
    tilted = perturb.with_tilt_error(math.radians(3))(case, RNG(0)).attitude
    assert tilted is not None
    assert case.attitude is not None
    assert math.hypot(tilted.roll_rad - 0.01, tilted.pitch_rad + 0.02) == pytest.approx(math.radians(3))
    assert tilted.std_rad == case.attitude.std_rad
    assert perturb.with_focal_error(0.02)(case, RNG(0)).camera.fx_px == pytest.approx(1.02 * CAMERA.fx_px)
    shorter = perturb.with_focal_error(0.02)(replace(case, index=1), RNG(0)).camera
    assert shorter.fy_px == pytest.approx(0.98 * CAMERA.fy_px)


@pytest.mark.parametrize("name", perturb.ON_PICTURES)
def test_every_perturbation_keeps_size_and_truth_and_is_repeatable(name: str) -> None:
    image = RNG(4).integers(0, 256, (120, 160), dtype=np.uint8)
    case = case_of(image, index=3)
    first, second = (perturb.ON_PICTURES[name](case, RNG(5)) for _ in range(2))
    np.testing.assert_array_equal(first.image, second.image)
    assert first.image.shape == image.shape
    assert first.image.dtype == np.uint8
    assert (first.camera.width_px, first.camera.height_px) == (160, 120)
    assert first.headings_rad == case.headings_rad
    np.testing.assert_array_equal(case.image, image)


@pytest.mark.parametrize(
    "camera",
    [
        Camera(160, 120, 110.0, 112.0, 70.0, 63.0, Distortion.RADTAN, (-0.2, 0.05, 0.003, -0.004)),
        Camera(
            160,
            120,
            80.0,
            80.0,
            84.0,
            55.0,
            Distortion.EQUIDISTANT,
            (0.01, 0.0, 0.0, 0.0),
            mounted(0.1, -0.2),
        ),
    ],
)
def test_the_mirrored_camera_sees_the_mirrored_world(camera: Camera) -> None:
    body = np.array([[1.0, 0.3, 0.2], [1.0, -0.4, -0.1], [1.0, 0.0, 0.0]])  # FRD
    there = camera.project(body @ camera.R_body_camera)
    other = harmless.mirrored_camera(camera)
    back = other.project(body * (1.0, -1.0, 1.0) @ other.R_body_camera)
    np.testing.assert_allclose(back, np.column_stack([159.0 - there[:, 0], there[:, 1]]), atol=1e-9)


@pytest.mark.parametrize("name", harmless.HARMLESS)
def test_harmless_changes_leave_heading_and_offset_as_they_were(name: str, corridor_view: cases.Case) -> None:
    change, sign = harmless.HARMLESS[name]
    changed = change(corridor_view)
    assert changed.headings_rad[0] == sign * corridor_view.headings_rad[0]
    before, after = (cases.measure(case)[0] for case in (corridor_view, changed))
    assert before.accepted
    assert after.accepted
    assert abs(math.degrees(sign * after.heading_rad - before.heading_rad)) < 0.5
    assert abs(sign * after.answer_norm - before.answer_norm) < 0.1


def test_a_change_is_counted_with_its_sign() -> None:
    before = [replace(result_of(e), answer_norm=0.2) for e in (1.0, -2.0)] + [result_of(0.0, accepted=False)]
    after = [replace(result_of(-e), answer_norm=-0.21) for e in (1.5, -2.0)] + [result_of(0.0)]
    found = pictures.repeat_of(before, after, -1.0)
    assert found.heading_worst_deg == pytest.approx(0.5)
    assert found.flips == pytest.approx(1 / 3)
    assert found.offset_p90_percent == pytest.approx(0.5)


# --- what is right ---


def test_error_is_to_the_nearest_right_answer_from_either_end() -> None:
    case = case_of(grey(), headings_rad=(0.2, -1.0))
    assert case.error_rad(0.25) == pytest.approx(0.05)
    assert case.error_rad(-1.1) == pytest.approx(-0.1)
    assert case.error_rad(0.2 + math.pi) == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(case.error_rad(math.nan))


def test_the_corridor_flown_is_right_and_another_only_where_the_camera_looks_along_it() -> None:
    def right(flown: float, other: float) -> list[float]:
        answers = cases.right_answers(math.radians(flown), [math.radians(other)])
        return [round(math.degrees(h), 6) for h in answers]

    assert right(20.0, -70.0) == [20.0]
    assert right(-70.0, 20.0) == [-70.0, 20.0]
    assert right(40.0, -50.0) == [40.0, -50.0]  # about as near: either will do
    assert right(175.0, 85.0) == [-5.0]  # seen backwards a corridor is still one


def test_the_constant_of_a_yaw_does_not_mind_the_half_turn() -> None:
    """The hallway's second corridor lies a quarter turn from the first: errors straddle where they wrap."""
    errors_deg = [89.0, 89.5, -89.8, -89.0, 88.0]  # -89.8 and -89 are 90.2 and 91, wrapped
    constant = cases.constant_rad([*map(result_of, errors_deg), result_of(10.0, accepted=False)])
    assert math.degrees(cases.half_turn(constant - math.radians(89.5))) == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(cases.constant_rad([result_of(1.0, accepted=False)]))


def test_offsets_count_in_the_corridor_flown_only() -> None:
    case = case_of(grey(), headings_rad=(0.2, -1.0), offset_norm=0.3)

    def offset_error(heading_rad: float) -> float:
        found = FrameMeasurement(True, Reason.OK, heading_rad=heading_rad, lateral_offset_norm=0.35)
        return cases.score(case, found).offset_error_norm

    assert offset_error(0.21) == pytest.approx(0.05)
    assert math.isnan(offset_error(-1.02))


def test_a_camera_mounted_askew_is_a_turned_vehicle() -> None:
    rotation = cases.rotation_of(0.3, Attitude(0.05, -0.04))
    assert cases.angles_of(rotation) == pytest.approx((0.3, 0.05, -0.04))
    views = list(scenes.scene_cases("yaw 25 to 45 deg", (32, 24), 4, 0))
    assert len(views) == 4
    for case in views:
        assert math.radians(24.5) < abs(case.headings_rad[0]) < math.radians(45.5)
    assert {math.copysign(1.0, c.headings_rad[0]) for c in views} == {-1.0, 1.0}


def test_junction_views_know_both_corridors() -> None:
    scene = scenes.SCENES["across a junction"].scene(5)
    angle = scene.junctions[0].angle_rad
    assert math.radians(45) <= abs(angle) <= math.radians(135)
    truths = scenes.SCENES["across a junction"].truths
    assert truths is not None
    assert truths(scene, 0.0) == (0.0,)
    assert truths(scene, cases.half_turn(angle)) == pytest.approx((cases.half_turn(angle), 0.0), abs=1e-12)


def test_turned_right_along_ransac_too() -> None:
    assert ransac.heading_of(np.array([math.cos(0.2), -math.sin(0.2), 0.0])) == pytest.approx(0.2)
    assert ransac.heading_of(-np.array([math.cos(0.2), -math.sin(0.2), 0.0])) == pytest.approx(0.2)


# --- scores ---


def test_heading_score_counts() -> None:
    results = [
        *(result_of(e) for e in (0.5, -1.0, 4.0, -89.0)),
        result_of(1.0, accepted=False),
        result_of(2.0, accepted=False),
        result_of(math.nan, accepted=False),
        result_of(0.1, accepted=False),
    ]
    s = scores.heading_score(results)
    assert (s.frames, s.accepted, s.gross, s.across) == (8, 0.5, 2, 1)
    assert s.worst == pytest.approx(89.0)
    assert s.median == pytest.approx(2.5)
    assert s.rmse == pytest.approx(math.sqrt((0.25 + 1 + 16 + 89**2) / 4))
    assert s.sigma_p90 == pytest.approx(np.percentile([0.5, 1, 4, 89], 90))
    assert s.silenced_right == pytest.approx(0.5)
    assert scores.reasons_of(results) == "ambiguous 50.0"


def test_nothing_accepted_is_no_number() -> None:
    s = scores.heading_score([result_of(1.0, accepted=False)])
    assert s.accepted == 0.0
    assert math.isnan(s.rmse)
    assert math.isnan(s.sigma_p90)
    assert scores.number(s.rmse) == "-"


def test_offset_score_is_in_per_cent_of_the_width() -> None:
    # Half a width is 1 in the scale-free form: 0.02 are 1 %, 0.2 are 10 %.
    results = [result_of(0.0, offset_error=e) for e in (0.02, -0.02, 0.2)] + [result_of(0.0)]
    s = scores.offset_score(results)
    assert s.answered == 0.75
    assert s.wrong_corner == pytest.approx(1 / 3)
    assert s.worst == pytest.approx(10.0)
    assert s.median == pytest.approx(1.0)


def test_table_is_aligned() -> None:
    lines = scores.table(("", "RMSE"), [("a", "1.00"), ("long", "-")]).splitlines()
    assert lines == ["        RMSE", "  a     1.00", "  long     -"]


# --- whole runs ---


def run(name: str, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / name), *arguments],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "120", "NO_COLOR": "1"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def row(out: str, name: str) -> list[str]:
    """Cells of the one table line that starts so, without its name."""
    (line,) = [line for line in out.splitlines() if line.startswith(f"  {name}  ")]
    return line[2 + len(name) :].split()


@pytest.mark.parametrize(
    "name", ["accuracy.py", "perturbations.py", "pictures.py", "rolling_shutter.py", "frame.py"]
)
def test_help(name: str) -> None:
    assert "--every" in run(name, "--help")


def test_accuracy_prints_a_row_per_set() -> None:
    if not OFFICE.is_dir():
        pytest.skip("data/office is not in this checkout")
    out = run("accuracy.py", "--every", "100", "--worst", "1")
    headings, offsets = out.split("Lateral offset", 1)
    sets = {"office 640x480": 3, "office 640x480, no attitude": 3, "office 320x240": 3, "office 160x120": 3}
    sets |= {"office 80x60": 3, "simulated 320x240": 3, "simulated 640x480": 1}
    for name, frames in sets.items():
        assert row(headings, name)[0] == str(frames)
    if HALLWAY.is_dir():
        assert row(headings, "hallway 0-41 320x240")[0] == "1"
    assert 0.0 <= float(row(headings, "office 640x480")[3]) < 3.0
    assert row(offsets, "office 640x480")[0] == "3"
    assert "Worst accepted frames" in out


def test_perturbations_print_a_row_each_and_the_total(tmp_path: Path) -> None:
    table, folder = tmp_path / "frames.csv", tmp_path / "overlays"
    arguments = ("--every", "150", "--only", "noise 10", "--only", "dead end", "--processes", "1")
    out = run("perturbations.py", *arguments, "--csv", str(table), "--overlays", str(folder))
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    by_name = {name: sum(r["perturbation"] == name for r in rows) for name in ("noise 10", "dead end")}
    assert by_name["dead end"] == 3  # of 240 at 320x240 and 60 at 640x480
    headings = out[: out.index("Lateral offset")]  # the offsets' table has the same rows
    assert int(row(headings, "noise 10")[0]) == by_name["noise 10"]
    assert int(row(headings, "dead end")[0]) == by_name["dead end"]
    gross = [r for r in rows if r["accepted"] == "True" and abs(float(r["error_rad"])) > math.radians(3)]
    last = out.splitlines()[-1]
    assert last.startswith(f"total: {len(rows)} frames, {len(gross)} accepted errors above 3 degrees")
    assert len(list(folder.iterdir())) == len(gross)


def test_perturbations_refuse_unknown_names() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "perturbations.py"), "--only", "nonsense"],
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0
    assert "nonsense" in done.stderr


def test_frame_prints_times_beside_errors() -> None:
    if not OFFICE.is_dir():
        pytest.skip("data/office is not in this checkout")
    out = run("frame.py", "--every", "100", "--no-first-call")
    for size in ("640x480", "320x240"):
        part = out.split(f"office at {size}, 3 frames")[1].split("\n\n")[0]
        for name in ("GaussianBlur + Canny", "heading", "heading + offset", "measure_frame", "paper"):
            assert float(row(part, name)[0]) > 0
        assert row(part, "OpenCV's LSD")[-1] == "-"  # it answers nothing
        assert float(row(part, "measure_frame")[-1]) < 5.0
    assert "lu-vp-detect==1.0.4: skipped" in out
    assert "resident:" in out


def test_pictures_print_every_set_and_every_change() -> None:
    out = run("pictures.py", "--every", "150")
    assert row(out, "office")[0] == "2"
    assert row(out, "office")[1:3] == ["100.0", "%"]
    for name in harmless.HARMLESS:
        assert f"    {name}  " in out
    if HALLWAY.is_dir():
        assert "hallway 62-90" in out
    else:
        assert "mononav_hallway: not beside this checkout, skipped" in out


def test_rolling_shutter_prints_a_row_per_readout_and_rate() -> None:
    out = run("rolling_shutter.py", "--every", "30")
    rows = [line.split() for line in out.splitlines() if line.startswith(("  20 ms", "  33 ms"))]
    assert [(cells[0], cells[2]) for cells in rows[:2]] == [("20", "0"), ("20", "15")]
    assert len(rows) == 10
    assert rows[-1][3] == "3.96"  # degrees turned in 33 ms at 120 degrees/s
