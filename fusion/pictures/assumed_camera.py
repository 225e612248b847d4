"""Assumed field of view of pictures without a calibration, with its source and uncertainty.

In the order of preference: the user's value; the focal length in the file's EXIF data; right angles in the pictures;
the usual value of cameras. Pictures of the same size and EXIF focal length are assumed to be from one camera.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import chain
from math import cos, degrees, hypot, isfinite, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.logs.samples import counted
from fusion.pictures.exif import PictureHeader, read_header
from fusion.progress import Progress
from vision import Camera, FrameMeasurement, InputError, Reason
from vision.images import GreyImage, read_image

if TYPE_CHECKING:
    from vision.lines.straightness import Bend

FILM_STD_OF_FOCAL = 0.03  # rounding to millimetres, diagonal or width, stabilisation
FOV_RANGE_RAD = (radians(1.0), radians(170.0))
MAX_NOTES = 4


class Source(StrEnum):
    """Source of an assumed field of view."""

    GIVEN = "given"
    FILM = "film"  # EXIF
    PICTURES = "pictures"
    ORDINARY = "ordinary"


@dataclass(frozen=True, slots=True)
class AssumedView:
    """Assumed camera of some pictures; it looks straight ahead.

    Parameters
    ----------
    width_px, height_px
        Size of the pictures.
    horizontal_rad, std_rad
        Field of view across the picture, and its standard deviation.
    source
        Source of the field of view.
    n_pictures
        Number of pictures that it applies to.
    n_used
        Number of pictures used, if the source is the pictures.
    bend
        Lens distortion by the pictures; None: no distortion.
    """

    width_px: int
    height_px: int
    horizontal_rad: float
    std_rad: float
    source: Source
    n_pictures: int = 1
    n_used: int = 0
    bend: Bend | None = None

    def camera(self) -> Camera:
        """Return the camera with this field of view."""
        if self.bend is None:
            return Camera.from_fov(self.width_px, self.height_px, self.horizontal_rad)
        from vision.axis.field_of_view import FieldOfView

        view = FieldOfView(self.horizontal_rad, self.std_rad, measured=True, bend=self.bend)
        return view.camera(self.width_px, self.height_px)

    def widened(self, measurement: FrameMeasurement) -> FrameMeasurement:
        """Add the assumption's uncertainty to a measurement's sigma; if that is too large, it is not accepted.

        A relative error of the focal length changes a heading by that share of ``sin(heading) cos(heading)``; an
        optical axis off the picture's centre changes all headings.
        """
        from vision.axis.acceptance import MAX_STD_RAD
        from vision.axis.right_angles import CENTRE_STD_OF_SIDE

        heading_rad = measurement.heading_rad
        if not (isfinite(heading_rad) and isfinite(measurement.heading_std_rad)):
            return measurement
        focal_share = self.std_rad / sin(self.horizontal_rad)
        centre_share = CENTRE_STD_OF_SIDE * max(self.width_px, self.height_px) / self.camera().fx_px
        std_rad = hypot(
            measurement.heading_std_rad,
            focal_share * sin(heading_rad) * cos(heading_rad),
            centre_share * cos(heading_rad) ** 2,
        )
        if measurement.accepted and std_rad >= MAX_STD_RAD:
            return replace(measurement, heading_std_rad=std_rad, accepted=False, reason=Reason.UNCERTAIN)
        return replace(measurement, heading_std_rad=std_rad)

    def text(self) -> str:
        """Return the assumption and its reason in one sentence."""
        fov = f"a horizontal field of view of {degrees(self.horizontal_rad):.0f}"
        sure = f"{fov} +- {max(degrees(self.std_rad), 1.0):.0f} degrees"
        lens = f"{self._lens_text()}, looking straight ahead"
        if self.source is Source.GIVEN:
            return f"{fov} degrees as given, {lens}"
        if self.source is Source.FILM:
            return f"{sure}, by the focal length in the EXIF, {lens}"
        if self.source is Source.PICTURES:
            found = f"found from {counted(self.n_used, 'picture')}"
            return f"{sure}, {found}, {lens}; give --camera for a calibrated one"
        return (
            f"{sure} like ordinary cameras, because the pictures give no clue, {lens}; give --fov or --camera"
        )

    def _lens_text(self) -> str:
        if self.bend is None:
            return "no distortion"
        radius_px = self.bend.radius_px(self.width_px, self.height_px)
        std_px = max(radius_px * self.bend.std_rad / self.bend.rad, 1.0)
        return f"distortion F atan(r / F) with F = {radius_px:.0f} +- {std_px:.0f} pixels"


@dataclass(frozen=True, slots=True)
class AssumedViews:
    """The views of all pictures.

    Parameters
    ----------
    groups
        One for each camera.
    by_path
        The group of each picture that could be read.
    """

    groups: tuple[AssumedView, ...] = ()
    by_path: Mapping[Path, AssumedView] = field(default_factory=dict)

    def of(self, path: Path, image: GreyImage) -> AssumedView:
        """Look up a picture's view; an ordinary one if its size was unknown or differs from its file's header."""
        height_px, width_px = image.shape
        view = self.by_path.get(path)
        if view is not None and (view.width_px, view.height_px) == (width_px, height_px):
            return view
        return _ordinary(width_px, height_px)

    def notes(self) -> list[str]:
        """Return the assumptions, a line per group while there are few."""
        lines = []
        several = len(self.groups) > 1
        for view in self.groups[:MAX_NOTES]:
            which = f"{counted(view.n_pictures, 'picture')} of {view.width_px}x{view.height_px}: "
            lines.append(f"no --camera: {which if several else ''}assuming {view.text()}")
        rest = self.groups[MAX_NOTES:]
        if rest:
            low, high = (degrees(bound(view.horizontal_rad for view in rest)) for bound in (min, max))
            between = f"{low:.0f} to {high:.0f}" if round(low) < round(high) else f"{low:.0f}"
            lines.append(
                f"no --camera: {counted(sum(view.n_pictures for view in rest), 'picture')} in "
                f"{counted(len(rest), 'more group')}: assuming {between} degrees, each as above"
            )
        return lines


def assume_views(
    paths: Sequence[Path],
    horizontal_fov_rad: float | None = None,
    progress: Progress = lambda done, total: None,
) -> AssumedViews:
    """Determine the assumptions for pictures without a calibration.

    Parameters
    ----------
    paths
        The pictures; unreadable ones are left out.
    horizontal_fov_rad
        The user's value, or None.
    progress
        Called with (done, total) pictures.

    Raises
    ------
    InputError
        If the given field of view is implausible.
    """
    if horizontal_fov_rad is not None and not FOV_RANGE_RAD[0] <= horizontal_fov_rad <= FOV_RANGE_RAD[1]:
        low, high = (degrees(bound) for bound in FOV_RANGE_RAD)
        raise InputError(
            f"--fov is {degrees(horizontal_fov_rad):g} degrees",
            remedy=f"give the horizontal field of view, {low:.0f} to {high:.0f} degrees",
        )
    headers = {path: read_header(path) for path in paths}
    cameras: dict[PictureHeader, list[Path]] = {}
    for path, header in headers.items():
        if header is not None:
            cameras.setdefault(header, []).append(path)
    by_path: dict[Path, AssumedView] = {}
    groups = []
    for header, members in cameras.items():
        view = _view(header, members, horizontal_fov_rad, progress)
        groups.append(view)
        by_path.update(dict.fromkeys(members, view))
    return AssumedViews(tuple(groups), by_path)


def _view(
    header: PictureHeader, paths: Sequence[Path], given_rad: float | None, progress: Progress
) -> AssumedView:
    ordinary = replace(_ordinary(header.width_px, header.height_px), n_pictures=len(paths))
    if given_rad is not None:
        return replace(ordinary, horizontal_rad=given_rad, std_rad=0.0, source=Source.GIVEN)
    written_rad = header.horizontal_fov_rad
    if written_rad is not None:
        std_rad = FILM_STD_OF_FOCAL * sin(written_rad)
        return replace(ordinary, horizontal_rad=written_rad, std_rad=std_rad, source=Source.FILM)
    from vision.axis.field_of_view import estimate_field_of_view

    images = _spread(paths, header, progress)
    first = next(images, None)
    if first is None:
        return ordinary
    found = estimate_field_of_view(chain([first], images))
    bend = found.bend if found.bend.rad > 0.0 else None
    if not found.measured:
        return replace(ordinary, bend=bend)
    return replace(
        ordinary,
        horizontal_rad=found.horizontal_rad,
        std_rad=found.std_rad,
        source=Source.PICTURES,
        n_used=found.n_used,
        bend=bend,
    )


def _ordinary(width_px: int, height_px: int) -> AssumedView:
    from vision.axis.field_of_view import ordinary_field_of_view

    fov = ordinary_field_of_view(width_px, height_px)
    return AssumedView(width_px, height_px, fov.horizontal_rad, fov.std_rad, Source.ORDINARY)


def _spread(paths: Sequence[Path], header: PictureHeader, progress: Progress) -> Iterator[GreyImage]:
    """Read pictures in an order that spreads the first few over all: neighbours look alike."""
    from vision.axis.field_of_view import MAX_TRIED

    bits = max(len(paths) - 1, 1).bit_length()
    order = sorted(range(len(paths)), key=lambda i: int(f"{i:0{bits}b}"[::-1], 2))
    for done, i in enumerate(order):
        progress(done, min(len(paths), MAX_TRIED))
        try:
            image = read_image(paths[i])
        except InputError:
            continue
        if image.shape == (header.height_px, header.width_px):
            yield image
