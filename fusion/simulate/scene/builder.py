"""Construction of surfaces before lighting: local frames, boxes, prisms, and the table of all surfaces."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil

import numpy as np
import numpy.typing as npt

from fusion.simulate.render.mesh import (
    ALBEDO,
    COLUMNS,
    CONTRAST,
    CORNER,
    DUAL_A,
    DUAL_B,
    ELLIPSE,
    EMISSION,
    GLOSS,
    JOINT_U,
    LENGTH_A,
    LENGTH_B,
    LIGHT_START,
    NO_TEXTURE,
    NORMAL,
    PLANE,
    POINTS,
    ROUGHNESS,
    SCALE_U,
    TEXTURE,
    Material,
)

FloatArray = npt.NDArray[np.float64]

CLEARANCE_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A local frame: origin (3,), and the world's unit vectors along (3,) and out (3,); up is -z."""

    origin: FloatArray
    along: FloatArray
    out: FloatArray

    def point(self, s: float, d: float, h: float) -> FloatArray:
        """World point at s along, d out, h above the origin."""
        return self.origin + s * self.along + d * self.out - h * np.array([0.0, 0.0, 1.0])

    def vector(self, s: float, d: float, h: float) -> FloatArray:
        """World vector of the given components."""
        return s * self.along + d * self.out - h * np.array([0.0, 0.0, 1.0])

    def turned(self, s: float, d: float, angle_rad: float) -> Frame:
        """Return the frame rotated about the vertical through (s, d), from ``along`` towards ``out``."""
        c, n = np.cos(angle_rad), np.sin(angle_rad)
        along, out = c * self.along + n * self.out, c * self.out - n * self.along
        return Frame(self.point(s, d, 0.0) - s * along - d * out, along, out)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector product of two vectors (3,), faster than `numpy.cross` for so few numbers."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


@dataclass(slots=True, eq=False)
class Builder:
    """Collects surfaces; `fusion.simulate.scene.build` converts them to a lit `Mesh`.

    ``keep_clear`` (k, 3) are world points that no object may come near; ``obstacles`` (minimum, maximum) are the
    boxes of the objects built.
    """

    rng: np.random.Generator
    light_cell_m: float = 0.15
    keep_clear: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    obstacles: list[FloatArray] = field(default_factory=list)
    rows: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, Material, bool]] = field(
        default_factory=list
    )

    @contextmanager
    def standing(self) -> Iterator[None]:
        """Build one object; it is removed again if it is too near a point to keep clear."""
        first = len(self.rows)
        yield
        if len(self.rows) == first:
            return
        points = np.array([p for c, a, b, *_ in self.rows[first:] for p in (c, c + a, c + b, c + a + b)])
        low, high = points.min(axis=0), points.max(axis=0)
        near = (self.keep_clear > low - CLEARANCE_M) & (self.keep_clear < high + CLEARANCE_M)
        if near.all(axis=1).any():
            del self.rows[first:]
        else:
            self.obstacles.append(np.concatenate([low, high]))

    def incline(self, slope_rad: float) -> None:
        """Let the floor rise along x: verticals stay vertical, and lines across stay level."""
        if slope_rad == 0:
            return
        rise = np.eye(3)
        rise[2, 0] = -np.tan(slope_rad)
        back = np.linalg.inv(rise).T
        for k, (corner, a, b, normal, material, ellipse) in enumerate(self.rows):
            turned = back @ normal
            self.rows[k] = (
                rise @ corner,
                rise @ a,
                rise @ b,
                turned / np.linalg.norm(turned),
                material,
                ellipse,
            )

    def quad(
        self,
        corner: FloatArray,
        edge_a: FloatArray,
        edge_b: FloatArray,
        facing: FloatArray,
        material: Material,
        ellipse: bool = False,
    ) -> None:
        """Add a parallelogram seen only from the side that ``facing`` points to."""
        normal = _cross(edge_a, edge_b)
        size = float(np.linalg.norm(normal))
        if size < 1e-8:  # no area: nothing to see
            return
        normal = normal / size
        if normal @ facing < 0:
            normal = -normal
        self.rows.append((corner, edge_a, edge_b, normal, material, ellipse))

    def box(
        self,
        frame: Frame,
        s: tuple[float, float],
        d: tuple[float, float],
        h: tuple[float, float],
        material: Material,
        faces: str = "sSdDhH",
    ) -> None:
        """Add the faces of a box: s/d/h the lower ends along, out and up, capitals the upper ends."""
        size = (s[1] - s[0], d[1] - d[0], h[1] - h[0])
        low = frame.point(s[0], d[0], h[0])
        edges = (frame.vector(size[0], 0, 0), frame.vector(0, size[1], 0), frame.vector(0, 0, size[2]))
        for axis, name in enumerate("sdh"):
            # the horizontal edge first, so that textures (text, wood grain) are upright
            first, second = ((1, 2), (0, 2), (0, 1))[axis]
            if name in faces:
                self.quad(low, edges[first], edges[second], -edges[axis], material)
            if name.upper() in faces:
                self.quad(low + edges[axis], edges[first], edges[second], edges[axis], material)

    def prism(
        self,
        frame: Frame,
        centre: tuple[float, float],
        radius: tuple[float, float],
        h: tuple[float, float],
        material: Material,
        sides: int = 8,
        lid: Material | None = None,
    ) -> None:
        """Add an upright prism with an elliptic outline (s, d radii): people, bins, bottles."""
        angles = np.arange(sides + 1) * (2 * np.pi / sides) + 0.3
        ring = [
            (centre[0] + radius[0] * np.cos(a), centre[1] + radius[1] * np.sin(a)) for a in angles.tolist()
        ]
        for (s0, d0), (s1, d1) in pairwise(ring):
            outward = frame.vector((s0 + s1) / 2 - centre[0], (d0 + d1) / 2 - centre[1], 0)
            low = frame.point(s0, d0, h[0])
            edge = frame.point(s1, d1, h[0]) - low
            self.quad(low, edge, frame.vector(0, 0, h[1] - h[0]), outward, material)
        corner = frame.point(centre[0] - radius[0], centre[1] - radius[1], h[1])
        a, b = frame.vector(2 * radius[0], 0, 0), frame.vector(0, 2 * radius[1], 0)
        self.quad(corner, a, b, frame.vector(0, 0, 1), lid or material, ellipse=True)

    def table(self, texture_number: dict[str, int]) -> tuple[FloatArray, int]:
        """Pack the collected surfaces into `Mesh.table`; return also the number of light cells."""
        table = np.zeros((len(self.rows), COLUMNS))
        cells = 0
        lengths = [(float(np.linalg.norm(a)), float(np.linalg.norm(b))) for _, a, b, *_ in self.rows]
        units = [
            (a / la, b / lb, normal)
            for (_, a, b, normal, *_), (la, lb) in zip(self.rows, lengths, strict=True)
        ]
        bases = np.linalg.inv(np.array(units).reshape(-1, 3, 3).transpose(0, 2, 1))
        for row, (corner, a, b, normal, material, ellipse), (la, lb), basis in zip(
            table, self.rows, lengths, bases, strict=True
        ):
            row[CORNER:NORMAL], row[NORMAL:DUAL_A] = corner, normal
            row[DUAL_A:DUAL_B], row[DUAL_B:LENGTH_A] = basis[0], basis[1]
            row[[LENGTH_A, LENGTH_B, PLANE, ELLIPSE]] = la, lb, normal @ corner, float(ellipse)
            row[[EMISSION, GLOSS, ROUGHNESS]] = material.emission, material.gloss, material.roughness_rad
            number = NO_TEXTURE if material.texture is None else texture_number[material.texture]
            row[[ALBEDO, CONTRAST, TEXTURE]] = material.albedo, material.contrast, number
            size = material.texture_size_m or (la, lb)
            shift = self.rng.random(2) if material.texture_size_m else (0.0, 0.0)
            if material.origin_m is not None:
                shift = material.origin_m[0] / size[0], material.origin_m[1] / size[1]
            row[SCALE_U:JOINT_U] = [1 / size[0], 1 / size[1], *shift]
            row[JOINT_U:LIGHT_START] = [
                *material.joint_spacing_m,
                material.joint_width_m,
                material.joint_albedo,
                material.joint_turn_rad,
                *(material.origin_m or (0.0, 0.0)),
            ]
            # Lengths are often whole numbers of cells, except for a last bit that depends on the processor.
            nu, nv = (min(max(ceil(length / self.light_cell_m - 1e-6), 1), 400) for length in (la, lb))
            row[LIGHT_START:POINTS] = cells, nu, nv
            row[POINTS:] = np.concatenate([corner, corner + a, corner + a + b, corner + b])
            cells += nu * nv
        return table, cells
