"""A scene as flat arrays for the compiled loops: parallelograms with materials, and their bounding volumes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

LEAF_SIZE = 4
NO_TEXTURE = -1


@dataclass(frozen=True, slots=True)
class Material:
    """What a surface looks like; lengths in metres, reflectances and strengths without unit.

    Parameters
    ----------
    albedo
        Mean diffuse reflectance, 0 to 1.
    texture
        Name of a procedural texture of `fusion.simulate.textures`, or None for a plain surface.
    texture_size_m
        Extent of one repetition along the surface's two edges; None stretches one copy over the surface.
    contrast
        How strongly the texture modulates the albedo (1: as drawn).
    joint_spacing_m, joint_width_m, joint_albedo
        A rectangular pattern of joints along the two edges (spacing 0: none), and its reflectance.
    emission
        Emitted radiance; light panels have about 10 where a lit white wall has 1.
    gloss
        Mirror reflection at perpendicular view, 0 to 1; it rises to grazing view after Schlick.
    """

    albedo: float
    texture: str | None = None
    texture_size_m: tuple[float, float] | None = None
    contrast: float = 1.0
    joint_spacing_m: tuple[float, float] = (0.0, 0.0)
    joint_width_m: float = 0.0
    joint_albedo: float = 0.0
    emission: float = 0.0
    gloss: float = 0.0

    def but(self, **changes: object) -> Material:
        """Return a copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


class Mesh(NamedTuple):
    """The arrays the compiled loops read; n surfaces, m tree nodes.

    ``geometry`` (n, 16): corner, normal, dual vector of edge a, dual vector of edge b, lengths of a and b, normal
    dot corner, 1 where the surface is an ellipse inscribed in its parallelogram. ``surface`` (n, 14): albedo,
    emission, gloss, contrast, texture scale (2) and offset (2), joint spacing (2), width, albedo, texture number,
    0. ``corners`` (n, 4, 3). ``light_index`` (n, 3): start in ``lightmap``, cells along a, cells along b.
    ``texture_levels``: ripmaps of every texture, see `fusion.simulate.textures`. ``node_box`` (m, 6) minimum and
    maximum, ``node_link`` (m, 3): leaf -> (first, count, 0), inner -> (left, right, 1); ``order`` (n,) surfaces in
    leaf order.
    """

    geometry: FloatArray
    surface: npt.NDArray[np.float32]
    corners: FloatArray
    light_index: npt.NDArray[np.int64]
    lightmap: npt.NDArray[np.float32]
    texture_start: npt.NDArray[np.int64]
    texture_levels: npt.NDArray[np.float32]
    node_box: FloatArray
    node_link: npt.NDArray[np.int64]
    order: npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A right place to build at: origin (3,), along (3,), out (3,) unit vectors of the world; up is -z."""

    origin: FloatArray
    along: FloatArray
    out: FloatArray

    def point(self, s: float, d: float, h: float) -> FloatArray:
        """World point at s along, d out, h above the origin."""
        return self.origin + s * self.along + d * self.out - h * np.array([0.0, 0.0, 1.0])

    def vector(self, s: float, d: float, h: float) -> FloatArray:
        """World vector of the given components."""
        return s * self.along + d * self.out - h * np.array([0.0, 0.0, 1.0])


@dataclass(slots=True, eq=False)
class Builder:
    """Collects surfaces; `fusion.simulate.scene` turns them into a lit `Mesh`."""

    rng: np.random.Generator
    light_cell_m: float = 0.15
    rows: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, Material, bool]] = field(
        default_factory=list
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
        normal = np.cross(edge_a, edge_b)
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
            # the horizontal edge first, so that textures (text, wood grain) stand upright
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
        for (s0, d0), (s1, d1) in zip(ring[:-1], ring[1:], strict=True):
            outward = frame.vector((s0 + s1) / 2 - centre[0], (d0 + d1) / 2 - centre[1], 0)
            low = frame.point(s0, d0, h[0])
            edge = frame.point(s1, d1, h[0]) - low
            self.quad(low, edge, frame.vector(0, 0, h[1] - h[0]), outward, material)
        corner = frame.point(centre[0] - radius[0], centre[1] - radius[1], h[1])
        a, b = frame.vector(2 * radius[0], 0, 0), frame.vector(0, 2 * radius[1], 0)
        self.quad(corner, a, b, frame.vector(0, 0, 1), lid or material, ellipse=True)

    def arrays(self, texture_number: dict[str, int]) -> dict[str, npt.NDArray[np.generic]]:
        """Pack what was collected: geometry, surface, corners and light_index of `Mesh`."""
        n = len(self.rows)
        geometry, surface = np.zeros((n, 16)), np.zeros((n, 14), np.float32)
        corners, light_index = np.zeros((n, 4, 3)), np.zeros((n, 3), np.int64)
        start = 0
        for i, (corner, a, b, normal, material, ellipse) in enumerate(self.rows):
            la, lb = float(np.linalg.norm(a)), float(np.linalg.norm(b))
            basis = np.linalg.inv(np.stack([a / la, b / lb, normal], axis=1))
            geometry[i] = [*corner, *normal, *basis[0], *basis[1], la, lb, normal @ corner, float(ellipse)]
            corners[i] = corner, corner + a, corner + a + b, corner + b
            size = material.texture_size_m or (la, lb)
            offset = self.rng.random(2) if material.texture_size_m else (0.0, 0.0)
            number = NO_TEXTURE if material.texture is None else texture_number[material.texture]
            surface[i] = [
                material.albedo,
                material.emission,
                material.gloss,
                material.contrast,
                1 / size[0],
                1 / size[1],
                *offset,
                *material.joint_spacing_m,
                material.joint_width_m,
                material.joint_albedo,
                number,
                0,
            ]
            cells = [int(np.clip(np.ceil(length / self.light_cell_m), 1, 400)) for length in (la, lb)]
            light_index[i] = start, *cells
            start += cells[0] * cells[1]
        return {"geometry": geometry, "surface": surface, "corners": corners, "light_index": light_index}


def build_tree(
    corners: FloatArray,
) -> tuple[FloatArray, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Build a bounding volume tree by halving at the median of the longest axis: node_box, node_link, order."""
    low, high = corners.min(axis=1) - 1e-6, corners.max(axis=1) + 1e-6
    centre = (low + high) / 2
    boxes: list[FloatArray] = []
    links: list[tuple[int, int, int]] = []
    order: list[int] = []

    def grow(members: npt.NDArray[np.int64]) -> int:
        node = len(boxes)
        boxes.append(np.concatenate([low[members].min(axis=0), high[members].max(axis=0)]))
        links.append((0, 0, 0))
        if len(members) <= LEAF_SIZE:
            links[node] = (len(order), len(members), 0)
            order.extend(members.tolist())
            return node
        spread = np.ptp(centre[members], axis=0)
        ranked = members[np.argsort(centre[members, int(np.argmax(spread))], kind="stable")]
        half = len(ranked) // 2
        links[node] = (grow(ranked[:half]), grow(ranked[half:]), 1)
        return node

    grow(np.arange(len(corners)))
    return np.array(boxes), np.array(links, np.int64), np.array(order, np.int64)
