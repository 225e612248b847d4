"""A scene as flat arrays for the compiled loops: parallelograms with materials, and their bounding volumes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

LEAF_SIZE = 4
LARGE_M = 8.0
CLEARANCE_M = 0.25
NO_TEXTURE = -1
TEXTURE_SIZE = 256  # power of two
TEXTURE_LEVELS = 9  # 256, 128, ... 1


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
    roughness_rad
        Spread of the normals of a glossy surface: how blurred its reflections are.
    joint_turn_rad
        Small angle by which the joints are turned against the edges.
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
    roughness_rad: float = 0.015
    joint_turn_rad: float = 0.0

    def but(self, **changes: object) -> Material:
        """Return a copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


# Columns of `Mesh.table`.
CORNER = 0  # (3) where edges a and b start
NORMAL = 3  # (3) towards the side from which it is seen
DUAL_A, DUAL_B = (
    6,
    9,
)  # (3) dual vectors: their product with a point's vector from the corner is u, v in metres
LENGTH_A, LENGTH_B = 12, 13
PLANE = 14  # normal times corner
ELLIPSE = 15  # 1 where only the inscribed ellipse is there
EMISSION, GLOSS, ROUGHNESS = 16, 17, 18
ALBEDO, CONTRAST, TEXTURE = 19, 20, 21
SCALE_U, SCALE_V, SHIFT_U, SHIFT_V = 22, 23, 24, 25  # metres to repetitions of the texture
JOINT_U, JOINT_V, JOINT_WIDTH, JOINT_ALBEDO, JOINT_TURN = 26, 27, 28, 29, 30
LIGHT_START, LIGHT_NU, LIGHT_NV = 31, 32, 33  # cells in `Mesh.lightmap`
POINTS = 34  # (4, 3) the corners
COLUMNS = 46


class Mesh(NamedTuple):
    """The arrays the compiled loops read; n surfaces, m tree nodes.

    Few and wide, and handed on one by one: numba counts references of arrays in tuples, atomically, at every call.

    Parameters
    ----------
    table
        (n, COLUMNS), see the column names above; surfaces in the order of the tree's leaves.
    nodes
        (m, 9): minimum and maximum of a node's box, the node to go on with if it is missed (else the next one),
        first and count of a leaf's surfaces; inner nodes count none.
    lightmap
        Light on every cell of every surface.
    textures
        Ripmaps of every texture, one after another, see `fusion.simulate.textures`.
    """

    table: FloatArray
    nodes: FloatArray
    lightmap: npt.NDArray[np.float32]
    textures: npt.NDArray[np.float32]


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

    def turned(self, s: float, d: float, angle_rad: float) -> Frame:
        """Return the frame turned about the vertical through (s, d), from ``along`` towards ``out``."""
        c, n = np.cos(angle_rad), np.sin(angle_rad)
        along, out = c * self.along + n * self.out, c * self.out - n * self.along
        return Frame(self.point(s, d, 0.0) - s * along - d * out, along, out)


@dataclass(slots=True, eq=False)
class Builder:
    """Collects surfaces; `fusion.simulate.scene` turns them into a lit `Mesh`.

    ``keep_clear`` (k, 3) are world points that no object may come near; ``obstacles`` (minimum, maximum) are the
    boxes of the objects that stand.
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
        """Build one object; it is taken away again if it stands in the way."""
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
        for (s0, d0), (s1, d1) in pairwise(ring):
            outward = frame.vector((s0 + s1) / 2 - centre[0], (d0 + d1) / 2 - centre[1], 0)
            low = frame.point(s0, d0, h[0])
            edge = frame.point(s1, d1, h[0]) - low
            self.quad(low, edge, frame.vector(0, 0, h[1] - h[0]), outward, material)
        corner = frame.point(centre[0] - radius[0], centre[1] - radius[1], h[1])
        a, b = frame.vector(2 * radius[0], 0, 0), frame.vector(0, 2 * radius[1], 0)
        self.quad(corner, a, b, frame.vector(0, 0, 1), lid or material, ellipse=True)

    def table(self, texture_number: dict[str, int]) -> tuple[FloatArray, int]:
        """Pack what was collected into `Mesh.table`; also how many light cells it needs."""
        table = np.zeros((len(self.rows), COLUMNS))
        cells = 0
        for row, (corner, a, b, normal, material, ellipse) in zip(table, self.rows, strict=True):
            la, lb = float(np.linalg.norm(a)), float(np.linalg.norm(b))
            basis = np.linalg.inv(np.stack([a / la, b / lb, normal], axis=1))
            row[CORNER:NORMAL], row[NORMAL:DUAL_A] = corner, normal
            row[DUAL_A:DUAL_B], row[DUAL_B:LENGTH_A] = basis[0], basis[1]
            row[[LENGTH_A, LENGTH_B, PLANE, ELLIPSE]] = la, lb, normal @ corner, float(ellipse)
            row[[EMISSION, GLOSS, ROUGHNESS]] = material.emission, material.gloss, material.roughness_rad
            number = NO_TEXTURE if material.texture is None else texture_number[material.texture]
            row[[ALBEDO, CONTRAST, TEXTURE]] = material.albedo, material.contrast, number
            size = material.texture_size_m or (la, lb)
            shift = self.rng.random(2) if material.texture_size_m else (0.0, 0.0)
            row[SCALE_U:JOINT_U] = [1 / size[0], 1 / size[1], *shift]
            row[JOINT_U:LIGHT_START] = [
                *material.joint_spacing_m,
                material.joint_width_m,
                material.joint_albedo,
                material.joint_turn_rad,
            ]
            nu, nv = (int(np.clip(np.ceil(length / self.light_cell_m), 1, 400)) for length in (la, lb))
            row[LIGHT_START:POINTS] = cells, nu, nv
            row[POINTS:] = np.concatenate([corner, corner + a, corner + a + b, corner + b])
            cells += nu * nv
        return table, cells


def _half_area(low: FloatArray, high: FloatArray) -> FloatArray:
    x, y, z = (high - low).T
    return np.asarray(x * y + y * z + z * x)


def _best_split(low: FloatArray, high: FloatArray) -> tuple[npt.NDArray[np.int64], int]:
    """Order boxes (n, 3) and say how many go left, for the least area times number (surface area heuristic)."""
    n = len(low)
    best, best_order, best_count = np.inf, np.arange(n), n // 2
    number = np.arange(1, n)
    for axis in range(3):
        order = np.argsort(low[:, axis] + high[:, axis], kind="stable")
        a, b = low[order], high[order]
        left = _half_area(np.minimum.accumulate(a), np.maximum.accumulate(b))[:-1]
        right = _half_area(np.minimum.accumulate(a[::-1]), np.maximum.accumulate(b[::-1]))[::-1][1:]
        cost = left * number + right * (n - number)
        k = int(np.argmin(cost))
        if cost[k] < best:
            best, best_order, best_count = float(cost[k]), order, k + 1
    return best_order, best_count


def build_tree(points: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Build a tree of boxes round surfaces (n, 4, 3).

    Returns `Mesh.nodes` and the order (n,) that the surfaces must be put in.
    """
    low, high = points.min(axis=1) - 1e-6, points.max(axis=1) + 1e-6
    nodes: list[list[float]] = []
    order: list[int] = []

    def grow(members: npt.NDArray[np.int64], leaf_size: int = LEAF_SIZE) -> None:
        node, first = len(nodes), len(order)
        nodes.append([*low[members].min(axis=0), *high[members].max(axis=0)])
        if len(members) <= leaf_size:
            order.extend(members.tolist())
            nodes[node] += [len(nodes), first, len(members)]
            return
        ranked, count = _best_split(low[members], high[members])
        grow(members[ranked[:count]])
        grow(members[ranked[count:]])
        nodes[node] += [len(nodes), 0, 0]

    # floors and ceilings would blow up every box they are in; tested first, they shorten the ray for the rest
    large = np.max(high - low, axis=1) > LARGE_M
    for members in (np.flatnonzero(large), np.flatnonzero(~large)):
        if len(members):
            grow(members, len(members) if large[members[0]] else LEAF_SIZE)
    return np.array(nodes, float), np.array(order, np.int64)
