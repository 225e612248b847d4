"""Pictures without a calibration: what `corridor measure` assumes, says, and is unsure about."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from math import atan, degrees, hypot, nan, radians, tan
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from PIL import Image

from fusion.pictures.assumed_camera import AssumedView, AssumedViews, Source, assume_views
from fusion.pictures.exif import PictureHeader, read_header
from fusion.pictures.measure import measure_images
from fusion.simulate import office_views
from tests.command import Corridor
from vision import Camera, FrameMeasurement, InputError, Reason, measure_frame
from vision.cameras.camera import Distortion
from vision.images import read_image

FOV_DEG = 50.0
SIZE = (400, 300)
FILM_TAG, WIDTH_TAG, HEIGHT_TAG, ORIENTATION_TAG, EXIF_TAG = 0xA405, 0xA002, 0xA003, 0x0112, 0x8769


class Run(NamedTuple):
    code: int
    rows: list[dict[str, str]]
    notes: list[str]


Measure = Callable[..., Run]


@pytest.fixture
def measure(corridor: Corridor) -> Measure:
    """Run `corridor measure`, its table as rows and its notes as lines."""

    def run(*arguments: str | Path) -> Run:
        code, out, err = corridor("measure", *arguments)
        return Run(code, list(csv.DictReader(out.splitlines())), err.splitlines())

    return run


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[float]]:
    """Six pictures of a camera of 50 degrees, and their true headings."""
    folder = tmp_path_factory.mktemp("walk")
    camera = Camera.from_fov(*SIZE, radians(FOV_DEG))
    headings = []
    for i, view in enumerate(office_views(camera, 6, seed=21, views_per_scene=6, tilt_std_rad=radians(5))):
        cv2.imwrite(str(folder / f"{i}.png"), view.image)
        headings.append(view.heading_rad)
    return folder, headings


def save_jpeg(
    path: Path, source: Path, film_mm: object, *, taken: tuple[int, int] | None = None, orientation: int = 1
) -> Path:
    """Save a picture as a phone would, its focal length written into it."""
    exif = Image.Exif()
    exif[ORIENTATION_TAG] = orientation
    details = exif.get_ifd(EXIF_TAG)
    details[FILM_TAG] = film_mm
    if taken is not None:
        details[WIDTH_TAG], details[HEIGHT_TAG] = taken
    with Image.open(source) as image:
        image.save(path, quality=95, exif=exif)
    return path


class TestMeasure:
    def test_a_fisheye_is_found_and_said(self, measure: Measure, tmp_path: Path) -> None:
        focal = 200 / radians(55)
        lens = Camera(400, 300, focal, focal, 199.5, 149.5, Distortion.EQUIDISTANT, (0.0,) * 4)
        headings = []
        for i, view in enumerate(office_views(lens, 6, seed=22, views_per_scene=3, tilt_std_rad=radians(4))):
            cv2.imwrite(str(tmp_path / f"{i}.png"), view.image)
            headings.append(view.heading_rad)
        run = measure(tmp_path)
        (note,) = (line for line in run.notes if "field of view" in line)
        assert "distortion F atan(r / F) with F = " in note
        assert float(note.split("field of view of ")[1].split()[0]) == pytest.approx(110.0, rel=0.05)
        assert float(note.split("F = ")[1].split()[0]) == pytest.approx(focal, rel=0.05)
        right = [
            abs(float(row["heading_rad"]) - true) < radians(2.0)
            for row, true in zip(run.rows, headings, strict=True)
            if row["accepted"] == "true"
        ]
        assert len(right) >= 5
        assert all(right)

    def test_the_field_of_view_is_found_and_said(
        self, measure: Measure, walk: tuple[Path, list[float]]
    ) -> None:
        folder, headings = walk
        run = measure(folder)
        assert run.code == 0
        (note,) = [note for note in run.notes if "field of view" in note]
        assert note.startswith("corridor: no --camera: assuming a horizontal field of view of ")
        fov, std = (float(word) for word in note.split(" of ")[2].split(" degrees")[0].split(" +- "))
        assert abs(fov - FOV_DEG) < 3.0
        assert 1.0 <= std < 6.0
        for words in ("found from", "pictures", "no distortion", "looking straight ahead", "--camera"):
            assert words in note
        errors = [
            abs(float(row["heading_rad"]) - heading)
            for row, heading in zip(run.rows, headings, strict=True)
            if row["accepted"] == "true"
        ]
        assert len(errors) >= 4
        assert max(errors) < radians(1.5)

    def test_the_old_assumption_was_far_worse(self, walk: tuple[Path, list[float]]) -> None:
        folder, headings = walk
        paths = sorted(folder.iterdir())
        found = measure_images(paths)
        fixed = measure_images(paths, views=assume_views(paths, radians(70)))
        error = [np.abs(table["heading_rad"] - headings)[table["accepted"]] for table in (found, fixed)]
        assert found["accepted"].sum() >= fixed["accepted"].sum()
        assert np.median(error[1]) > 4 * np.median(error[0])

    def test_fov_fixes_it(self, measure: Measure, walk: tuple[Path, list[float]]) -> None:
        run = measure(walk[0] / "1.png", "--fov", "50")
        assert run.code == 0
        assert "a horizontal field of view of 50 degrees as given, no distortion" in run.notes[0]
        camera = Camera.from_fov(*SIZE, radians(50))
        table = measure_images([walk[0] / "1.png"], camera)
        assert float(run.rows[0]["heading_rad"]) == pytest.approx(table["heading_rad"][0], abs=1e-6)
        assert float(run.rows[0]["heading_std_rad"]) > table["heading_std_rad"][0]

    @pytest.mark.parametrize("fov", ["0", "-40", "180", "nan"])
    def test_a_fov_that_is_none(self, measure: Measure, walk: tuple[Path, list[float]], fov: str) -> None:
        run = measure(walk[0], "--fov", fov)
        assert run.code == 2
        assert len(run.notes) == 1
        assert "--fov is" in run.notes[0]
        assert "1 to 170 degrees" in run.notes[0]

    def test_fov_and_camera_together(
        self, measure: Measure, walk: tuple[Path, list[float]], tmp_path: Path
    ) -> None:
        (tmp_path / "cam.yaml").write_text(
            "camera_model: pinhole\nintrinsics: [429.0, 429.0, 199.5, 149.5]\nresolution: [400, 300]\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
            "T_BS:\n  data: [0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 0, 1]\n"
        )
        run = measure(walk[0], "--camera", tmp_path / "cam.yaml", "--fov", "50")
        assert run.code == 2
        assert "--fov and --camera" in run.notes[-1]
        calibrated = measure(walk[0], "--camera", tmp_path / "cam.yaml")
        assert not any("field of view" in note for note in calibrated.notes)

    def test_a_blank_picture_cannot_tell(self, measure: Measure, tmp_path: Path) -> None:
        cv2.imwrite(str(tmp_path / "wall.png"), np.full((120, 160), 150, np.uint8))
        run = measure(tmp_path / "wall.png")
        assert run.code == 0
        assert "65 +- 20 degrees like ordinary cameras, because the pictures give no clue" in run.notes[0]
        assert run.rows[0]["accepted"] == "false"

    def test_pictures_of_different_sizes_are_different_cameras(
        self, measure: Measure, walk: tuple[Path, list[float]], tmp_path: Path
    ) -> None:
        image = read_image(walk[0] / "2.png")
        cv2.imwrite(str(tmp_path / "half.png"), cv2.resize(image, (200, 150), interpolation=cv2.INTER_AREA))
        run = measure(*sorted(walk[0].iterdir()), tmp_path / "half.png")
        notes = [note for note in run.notes if "field of view" in note]
        assert len(notes) == 2
        assert "6 pictures of 400x300: assuming" in notes[0]
        assert "1 picture of 200x150: assuming" in notes[1]

    def test_many_sizes_are_summed_up(self) -> None:
        groups = [AssumedView(w, 100, radians(w), radians(2), Source.PICTURES) for w in range(40, 110, 10)]
        notes = AssumedViews(tuple(groups)).notes()
        assert len(notes) == 5
        assert "3 pictures in 3 more groups: assuming 80 to 100 degrees" in notes[-1]

    def test_an_unreadable_picture_is_no_camera(
        self, measure: Measure, walk: tuple[Path, list[float]], tmp_path: Path
    ) -> None:
        (tmp_path / "torn.jpg").write_bytes(b"\xff\xd8\xff")
        run = measure(tmp_path / "torn.jpg", walk[0] / "0.png")
        assert run.code == 0
        assert len([note for note in run.notes if "field of view" in note]) == 1
        assert run.rows[0]["reason"] == "unreadable"

    def test_the_articles_method_assumes_no_field_of_view(
        self, measure: Measure, walk: tuple[Path, list[float]]
    ) -> None:
        run = measure(walk[0] / "0.png", "--method", "paper")
        assert run.code == 0
        assert not any("field of view" in note for note in run.notes)


class TestExif:
    def test_the_written_focal_length_is_used_and_said(
        self, measure: Measure, walk: tuple[Path, list[float]], tmp_path: Path
    ) -> None:
        film_mm = 37  # 43.27 mm of film over the diagonal: 50.1 degrees across 4:3
        run = measure(save_jpeg(tmp_path / "phone.jpg", walk[0] / "1.png", film_mm))
        assert (
            "a horizontal field of view of 50 +- 1 degrees, by the focal length in the EXIF" in run.notes[0]
        )

    def test_by_the_diagonal(self) -> None:
        fov_rad = PictureHeader(4032, 3024, 26.0).horizontal_fov_rad
        assert fov_rad == pytest.approx(2 * atan(0.5 * 0.8 * hypot(36, 24) / 26))
        upright = PictureHeader(3024, 4032, 26.0).horizontal_fov_rad
        assert fov_rad is not None
        assert upright is not None
        assert tan(upright / 2) == pytest.approx(0.75 * tan(fov_rad / 2))

    def test_turned_pictures_are_as_they_decode(self, walk: tuple[Path, list[float]], tmp_path: Path) -> None:
        path = save_jpeg(tmp_path / "turned.jpg", walk[0] / "0.png", 30, taken=SIZE, orientation=6)
        header = read_header(path)
        assert header == PictureHeader(300, 400, 30.0)
        assert read_image(path).shape == (400, 300)

    @pytest.mark.parametrize("film_mm", [0, 2000, "wide"])
    def test_nonsense_is_left_aside(
        self, walk: tuple[Path, list[float]], tmp_path: Path, film_mm: object
    ) -> None:
        path = save_jpeg(tmp_path / "odd.jpg", walk[0] / "0.png", film_mm)
        assert read_header(path) == PictureHeader(*SIZE)

    def test_a_cropped_picture_has_lost_its_focal_length(
        self, walk: tuple[Path, list[float]], tmp_path: Path
    ) -> None:
        whole = save_jpeg(tmp_path / "whole.jpg", walk[0] / "0.png", 30, taken=(4000, 3000))
        cropped = save_jpeg(tmp_path / "cropped.jpg", walk[0] / "0.png", 30, taken=(4000, 2250))
        assert read_header(whole) == PictureHeader(*SIZE, 30.0)
        assert read_header(cropped) == PictureHeader(*SIZE)

    def test_what_pillow_cannot_read_is_decoded(self, tmp_path: Path) -> None:
        (tmp_path / "torn.png").write_bytes(b"\x89PNG\r\n\x1a\n")
        assert read_header(tmp_path / "torn.png") is None
        assert read_header(tmp_path / "missing.png") is None
        cv2.imwrite(str(tmp_path / "deep.pgm"), np.zeros((20, 30), np.uint16))
        assert read_header(tmp_path / "deep.pgm") == PictureHeader(30, 20)


class TestWidened:
    MEASURED = FrameMeasurement(
        accepted=True, reason=Reason.OK, heading_rad=radians(10), heading_std_rad=radians(0.1)
    )

    def test_by_what_the_focal_length_may_be_off_by(self) -> None:
        """Compare with the heading that the same vanishing point has one sigma of field of view away."""
        view = AssumedView(640, 480, radians(60), radians(3), Source.PICTURES)
        off = replace(view, horizontal_rad=radians(63))
        x_px = view.camera().fx_px * tan(self.MEASURED.heading_rad)
        moved = abs(atan(x_px / off.camera().fx_px) - self.MEASURED.heading_rad)
        centre = atan(0.01 * 640 / view.camera().fx_px)
        widened = view.widened(self.MEASURED)
        assert widened.heading_std_rad == pytest.approx(hypot(radians(0.1), moved, centre), rel=0.05)
        assert widened.accepted
        assert widened.heading_rad == self.MEASURED.heading_rad

    def test_straight_ahead_the_focal_length_does_not_matter(self) -> None:
        ahead = replace(self.MEASURED, heading_rad=0.0)
        sure = AssumedView(640, 480, radians(60), 0.0, Source.GIVEN)
        unsure = AssumedView(640, 480, radians(60), radians(20), Source.ORDINARY)
        assert sure.widened(ahead).heading_std_rad == unsure.widened(ahead).heading_std_rad

    def test_too_wide_is_not_accepted(self) -> None:
        view = AssumedView(640, 480, radians(65), radians(20), Source.ORDINARY)
        widened = view.widened(replace(self.MEASURED, heading_rad=radians(25)))
        assert (widened.accepted, widened.reason) == (False, Reason.UNCERTAIN)
        assert degrees(widened.heading_std_rad) > 3.0

    def test_nothing_measured_stays_nothing(self) -> None:
        view = AssumedView(640, 480, radians(65), radians(20), Source.ORDINARY)
        nothing = FrameMeasurement(accepted=False, reason=Reason.TOO_FEW_LINES)
        assert np.isnan(view.widened(nothing).heading_std_rad)
        assert view.widened(replace(self.MEASURED, heading_std_rad=nan)).accepted


class TestAssumeViews:
    def test_another_size_than_the_file_said_is_an_ordinary_camera(self, tmp_path: Path) -> None:
        path = tmp_path / "a.png"
        cv2.imwrite(str(path), np.zeros((120, 160), np.uint8))
        views = assume_views([path], radians(40))
        assert views.of(path, np.zeros((120, 160), np.uint8)).source is Source.GIVEN
        assert views.of(path, np.zeros((60, 160), np.uint8)).source is Source.ORDINARY

    def test_a_wrong_given_one_is_refused(self) -> None:
        with pytest.raises(InputError, match="--fov is 400 degrees"):
            assume_views([], radians(400))

    def test_progress_is_told(self, walk: tuple[Path, list[float]]) -> None:
        told: list[tuple[int, int]] = []
        assume_views(sorted(walk[0].iterdir()), progress=lambda done, total: told.append((done, total)))
        assert told == [(i, 6) for i in range(6)]


def test_the_table_ends_with_the_next_best_heading(walk: tuple[Path, list[float]], measure: Measure) -> None:
    picture = walk[0] / "0.png"
    (row,) = measure(picture, "--fov", str(FOV_DEG)).rows
    m = measure_frame(read_image(picture), Camera.from_fov(*SIZE, radians(FOV_DEG)))
    assert list(row)[-2:] == ["second_heading_rad", "second_score"]
    assert float(row["second_heading_rad"]) == pytest.approx(m.second_heading_rad, abs=1e-6)
    assert float(row["second_score"]) == pytest.approx(m.second_score, abs=1e-6)
