"""Measurement of pictures without a flight, for ``corridor measure``: a table row for each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from fusion.estimator.tables import FRAME_DTYPE, Table
from fusion.files import replacing
from fusion.logs import FORMATS, format_of
from fusion.logs.csv.rows import parse_time
from fusion.logs.pictures.camera_folder import PICTURE_SUFFIXES
from fusion.pictures.assumed_camera import AssumedView, AssumedViews, assume_views
from fusion.pictures.attitude_file import AttitudeFile
from fusion.progress import Progress
from vision import Camera, FrameMeasurement, InputError, Reason, measure_frame
from vision.frame import Method
from vision.images import GreyImage, read_image

ASPECT_TOLERANCE = 0.01
HEIC_SUFFIXES = {".heic", ".heif"}  # listed, so that a picture that cannot be read is reported

#: `FRAME_DTYPE`, with the picture first and the next best heading last; times only from file names.
IMAGE_DTYPE = np.dtype(
    [
        ("image", "O"),
        ("timestamp_ns", "O"),
        *FRAME_DTYPE.descr[1:],
        ("second_heading_rad", "f8"),
        ("second_score", "f8"),
    ]
)


def find_images(sources: Sequence[Path]) -> list[Path]:
    """List pictures: files as named, folders by their picture files in natural order (2 before 10).

    Raises
    ------
    InputError
        If a source does not exist or a folder contains no picture.
    """
    found: list[Path] = []
    for source in sources:
        if source.is_dir():
            inside = [
                path for path in source.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES | HEIC_SUFFIXES
            ]
            if not inside:
                flight = (source / "mav0").is_dir()
                raise InputError(
                    "the folder contains no pictures",
                    file=source,
                    remedy=f"this is a flight: corridor fuse {source}"
                    if flight
                    else "give pictures (jpg, png, bmp, tif, pgm, webp) or a folder that contains them",
                )
            found += sorted(inside, key=_natural_order)
        elif source.exists():
            if source.suffix.lower() not in PICTURE_SUFFIXES and (module := format_of(source)) is not None:
                name = next(name for name, known in FORMATS.items() if known == module)
                raise InputError(
                    f"is of the format {name}, no picture",
                    file=source,
                    remedy=f"`corridor fuse --video {source} --camera CAM.yaml` measures its frames"
                    if name == "video"
                    else f"give pictures; `corridor inspect {source}` says what this holds",
                )
            found.append(source)
        else:
            raise InputError("there is no such picture or folder", file=source, remedy="check the path")
    return found


def check_table_file(path: Path) -> None:
    """Raise `InputError` if a table would replace a folder or a picture."""
    if path.is_dir() or path.suffix.lower() in PICTURE_SUFFIXES:
        what = "folder" if path.is_dir() else "picture"
        raise InputError(
            f"-o names a {what}", file=path, remedy="give a file for the table, such as frames.csv"
        )


def _natural_order(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def camera_for(camera: Camera, image: GreyImage, file: Path) -> Camera:
    """Scale a calibration to a picture's size.

    Parameters
    ----------
    camera
        The calibration.
    image
        The picture, grey (h, w).
    file
        For the error if the aspect ratios differ.

    Raises
    ------
    InputError
        If the aspect ratios differ by more than one percent.
    """
    height, width = image.shape
    if (width, height) == (camera.width_px, camera.height_px):
        return camera
    if abs(width * camera.height_px / (height * camera.width_px) - 1.0) > ASPECT_TOLERANCE:
        camera.require_size(width, height, file)
    return _resized(camera, width, height)


@lru_cache(maxsize=16)
def _assumed_camera(view: AssumedView) -> Camera:
    return view.camera()


@lru_cache(maxsize=16)
def _resized(camera: Camera, width_px: int, height_px: int) -> Camera:
    return camera.resized(width_px, height_px)


def measure_images(
    paths: Sequence[Path],
    camera: Camera | None = None,
    attitudes: AttitudeFile | None = None,
    method: Method = "geometric",
    overlay_dir: Path | None = None,
    progress: Progress = lambda done, total: None,
    views: AssumedViews | None = None,
) -> Table:
    """Measure pictures one by one; those that cannot be decoded become rows with the reason ``unreadable``.

    Parameters
    ----------
    paths
        The pictures.
    camera
        Their calibration; see `camera_for`. None to assume one: see ``views``.
    attitudes
        Roll and pitch per picture, if known.
    method
        ``geometric`` or ``paper``.
    overlay_dir
        Folder for a drawing of each measured picture, ``NAME_overlay.jpg``.
    progress
        Called with (done, total).
    views
        Assumptions if there is no calibration; None: from `assume_views`. The headings' sigmas then include their
        uncertainty.

    Returns
    -------
    ndarray
        Rows of `IMAGE_DTYPE`, one per path.

    Raises
    ------
    InputError
        If no picture can be decoded, or the calibration has another aspect ratio.
    """
    if camera is None and views is None:
        views = assume_views(paths) if method == "geometric" else AssumedViews()
    measurer = _Measurer(camera, views or AssumedViews(), attitudes, method)
    table = np.zeros(len(paths), IMAGE_DTYPE)
    overlays = None if overlay_dir is None else _Overlays(overlay_dir, paths)
    problems: list[InputError] = []
    for row, path in enumerate(paths):
        t_ns = parse_time(path.stem)  # EuRoC names pictures by their time
        try:
            image = read_image(path)
        except InputError as error:
            problems.append(error)
            measurement = FrameMeasurement(accepted=False, reason=Reason.UNREADABLE)
        else:
            own_camera, measurement = measurer.measure(path, t_ns, image)
            if overlays is not None:
                overlays.draw(path, image, own_camera, measurement)
        _fill(table, row, path, t_ns, measurement)
        progress(row + 1, len(paths))
    if problems and len(problems) == len(paths):
        raise _none_readable(problems)
    return table


def _none_readable(problems: Sequence[InputError]) -> InputError:
    """Return the error to raise if no picture can be read, from the pictures' errors."""
    if len(problems) == 1:
        return problems[0]
    return InputError(f"none of the {len(problems)} pictures can be read; the first: {problems[0]}")


class _Measurer:
    """Measures pictures with a calibration or, without one, with an assumed camera."""

    def __init__(
        self, camera: Camera | None, views: AssumedViews, attitudes: AttitudeFile | None, method: Method
    ) -> None:
        self._camera, self._views, self._attitudes, self._method = camera, views, attitudes, method
        self._warm = False

    def measure(self, path: Path, t_ns: int | None, image: GreyImage) -> tuple[Camera, FrameMeasurement]:
        """Measure a picture; return also the camera that was used."""
        view: AssumedView | None = None
        if self._camera is not None:
            camera = camera_for(self._camera, image, path)
        else:
            view = self._views.of(path, image)
            camera = _assumed_camera(view)
        attitude = None if self._attitudes is None else self._attitudes.of(path, t_ns)
        if not self._warm:  # the first call loads or compiles code: exclude it from `vision_ms`
            measure_frame(image, camera, attitude, method=self._method)
            self._warm = True
        measurement = measure_frame(image, camera, attitude, method=self._method)
        if view is not None and self._method == "geometric":
            measurement = view.widened(measurement)
        return camera, measurement


def _fill(table: Table, row: int, path: Path, t_ns: int | None, measurement: FrameMeasurement) -> None:
    table["image"][row] = str(path)
    table["timestamp_ns"][row] = "" if t_ns is None else str(t_ns)
    table["vp_x_px"][row], table["vp_y_px"][row] = measurement.vp_px
    table["reason"][row] = measurement.reason.value
    table["position"][row] = "" if measurement.position is None else measurement.position.value
    for of_a_filter in ("innovation_rad", "test_ratio"):  # there is no filter here
        table[of_a_filter][row] = np.nan
    table["accepted"][row] = measurement.accepted
    table["n_lines"][row] = measurement.n_lines
    table["n_inliers"][row] = measurement.n_inliers
    table["heading_rad"][row] = measurement.heading_rad
    table["heading_std_rad"][row] = measurement.heading_std_rad
    table["lateral_offset_norm"][row] = measurement.lateral_offset_norm
    table["lateral_offset_norm_std"][row] = measurement.lateral_offset_norm_std
    table["paper_yaw_rad"][row] = measurement.paper_yaw_rad
    table["vision_ms"][row] = measurement.vision_ms
    table["second_heading_rad"][row] = measurement.second_heading_rad
    table["second_score"][row] = measurement.second_score


def check_overlay_dir(folder: Path) -> None:
    """Raise `InputError` if drawings cannot be written to a folder of this name, before the pictures are measured."""
    if folder.is_file() or (folder.suffix.lower() in PICTURE_SUFFIXES and not folder.is_dir()):
        raise InputError(
            "is a file, not a folder" if folder.is_file() else "is the name of a picture, not of a folder",
            file=folder,
            remedy="give --overlay a folder; the drawing of NAME.jpg in it is NAME_overlay.jpg",
        )


class _Overlays:
    """A folder of drawings with names that differ from each other and from the given pictures."""

    def __init__(self, folder: Path, paths: Sequence[Path]) -> None:
        if any(path.resolve().parent == folder.resolve() for path in paths):
            raise InputError(
                "the drawings would lie among the pictures",
                file=folder,
                remedy="give --overlay a folder of its own",
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make the folder: {error.strerror}", file=folder) from error
        self.folder = folder
        self.used: set[str] = set()

    def draw(self, path: Path, image: GreyImage, camera: Camera, measurement: FrameMeasurement) -> None:
        """Write the drawing of a measured picture."""
        import cv2

        from vision.overlay import draw_overlay

        name, copy = f"{path.stem}_overlay.jpg", 1
        while name in self.used:
            copy += 1
            name = f"{path.stem}_overlay_{copy}.jpg"
        self.used.add(name)
        encoded = cv2.imencode(".jpg", draw_overlay(image, camera, measurement))[1]
        with replacing(self.folder / name) as draft:
            draft.write_bytes(encoded.tobytes())
