"""Straight line segments of one picture: their ends in pixels, and the planes they span with the camera's centre.

A segment with unit rays r_0, r_1 to its ends is described by the unit vectors ``centre`` (towards its middle),
``normal`` (of the plane, parallel to r_0 x r_1) and ``direction = normal x centre``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vision.compiled import compiled
from vision.types import BoolArray, FloatArray, GreyImage


class LineGeometry(NamedTuple):
    """Planes of n lines for compiled code; fields as in `LineSet`, in any one frame."""

    normal: FloatArray  # (n, 3), as the next two
    centre: FloatArray
    direction: FloatArray
    sigma_rad: FloatArray  # (n,)
    arc_rad: FloatArray


@compiled
def rotate_lines(lines: LineGeometry, R: FloatArray) -> LineGeometry:
    """Return the lines rotated by R (3, 3)."""
    n = len(lines.sigma_rad)
    normal, centre, direction = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        for j in range(3):
            a, b, c = R[j, 0], R[j, 1], R[j, 2]
            normal[i, j] = a * lines.normal[i, 0] + b * lines.normal[i, 1] + c * lines.normal[i, 2]
            centre[i, j] = a * lines.centre[i, 0] + b * lines.centre[i, 1] + c * lines.centre[i, 2]
            direction[i, j] = (
                a * lines.direction[i, 0] + b * lines.direction[i, 1] + c * lines.direction[i, 2]
            )
    return LineGeometry(normal, centre, direction, lines.sigma_rad, lines.arc_rad)


@dataclass(frozen=True, slots=True, eq=False)
class LineSet:
    """Line segments of one picture; n lines.

    Parameters
    ----------
    width_px, height_px
        Size of the picture.
    ends_px
        End points (n, 4) x0, y0, x1, y1 in rectified pixels (those of a distortion-free lens with the same
        focal length and principal point); bright is on the right when walking from 0 to 1.
    length_px
        Lengths (n,), rectified pixels.
    rms_px
        Scatter (n,) of the edge pixels across their line.
    n_pixels
        Edge pixels (n,) in the line.
    contrast
        Mean gradient magnitude (n,), in grey levels per pixel times 8 (Sobel 3x3).
    centre, direction, normal
        Unit vectors (n, 3) in the optical frame: towards the middle of the segment, along it, and normal to the
        plane it spans with the camera's centre, on the bright side; ``normal = centre x direction``.
    sigma_rad
        Standard deviation (n,) of the angle of the middle off its plane.
    arc_rad
        Angle (n,) that the segment subtends.
    threshold
        Gradient magnitude above which pixels counted as edges.
    extract_ms
        Time of the extraction, milliseconds.
    grey
        The picture (h, w), uint8, for the steps that use pixels; None for lines without one.
    """

    width_px: int
    height_px: int
    ends_px: FloatArray
    length_px: FloatArray
    rms_px: FloatArray
    n_pixels: FloatArray
    contrast: FloatArray
    centre: FloatArray
    direction: FloatArray
    normal: FloatArray
    sigma_rad: FloatArray
    arc_rad: FloatArray
    threshold: float
    extract_ms: float
    grey: GreyImage | None = None

    def __len__(self) -> int:
        return len(self.length_px)

    def with_ends(self, start: FloatArray, end: FloatArray) -> LineSet:
        """Return the same lines with their planes spanned by other rays (n, 3) to their ends; z must be about 1."""
        centre = start + end
        centre /= np.linalg.norm(centre, axis=1, keepdims=True)
        normal = np.cross(start, end)
        sine = np.linalg.norm(normal, axis=1)
        normal /= sine[:, None]
        return replace(
            self,
            centre=centre,
            direction=np.cross(normal, centre),
            normal=normal,
            arc_rad=np.arctan2(sine, (start * end).sum(axis=1)),
        )

    def cut(self, which: BoolArray, ray: FloatArray) -> LineSet:
        """Return the lines, those marked in ``which`` (n,) cut in two where they pass a ray (3,), optical frame."""
        whole, halved = np.flatnonzero(~which), np.flatnonzero(which)
        lines = np.concatenate([whole, halved, halved])
        ahead = np.arctan2(self.direction[halved] @ ray, self.centre[halved] @ ray)  # of the middle
        nearer = 0.5 + ahead / self.arc_rad[halved]
        share = np.concatenate([np.ones(len(whole)), nearer, 1.0 - nearer])
        turn = 0.5 * np.concatenate([np.zeros(len(whole)), ahead, ahead])
        turn[len(whole) :] += 0.25 * self.arc_rad[lines[len(whole) :]] * np.repeat([-1.0, 1.0], len(halved))
        cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
        centre, direction = self.centre[lines], self.direction[lines]
        start, end = self.ends_px[lines, :2], self.ends_px[lines, 2:]
        first, second = slice(len(whole), len(whole) + len(halved)), slice(len(whole) + len(halved), None)
        end[first] = start[first] + share[first, None] * (end[first] - start[first])
        start[second] = end[first]
        return replace(
            self,
            ends_px=np.hstack([start, end]),
            length_px=self.length_px[lines] * share,
            rms_px=self.rms_px[lines],
            n_pixels=self.n_pixels[lines] * share,
            contrast=self.contrast[lines],
            centre=centre * cosine + direction * sine,
            direction=direction * cosine - centre * sine,
            normal=self.normal[lines],
            sigma_rad=self.sigma_rad[lines] / np.sqrt(share),
            arc_rad=self.arc_rad[lines] * share,
        )

    def geometry(self) -> LineGeometry:
        """Return the lines' planes in the optical frame, for compiled code."""
        return LineGeometry(self.normal, self.centre, self.direction, self.sigma_rad, self.arc_rad)
