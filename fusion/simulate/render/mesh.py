"""A scene as flat arrays for the compiled loops: parallelograms with materials, and their bounding volumes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

LEAF_SIZE = 4
LARGE_M = 8.0
NO_TEXTURE = -1
TEXTURE_SIZE = 256  # power of two
TEXTURE_LEVELS = 9  # 256, 128, ... 1


@dataclass(frozen=True, slots=True)
class Material:
    """Appearance of a surface; lengths in metres, reflectances and strengths without unit.

    Parameters
    ----------
    albedo
        Mean diffuse reflectance, 0 to 1.
    texture
        Name of a procedural texture of `fusion.simulate.scene.textures`, or None for a plain surface.
    texture_size_m
        Extent of one repetition along the surface's two edges; None stretches one copy over the surface.
    contrast
        Strength of the texture's modulation of the albedo (1: as drawn).
    joint_spacing_m, joint_width_m, joint_albedo
        A rectangular pattern of joints along the two edges (spacing 0: none), and its reflectance.
    emission
        Emitted radiance; about 10 for light panels, compared with 1 for a lit white wall.
    gloss
        Mirror reflection at perpendicular view, 0 to 1; increases towards grazing view after Schlick.
    roughness_rad
        Spread of the normals of a glossy surface, which blurs its reflections.
    joint_turn_rad
        Angle between the joints and the edges.
    origin_m
        Position of the surface's corner in a pattern that continues across its neighbours: bricks and tiles. None:
        joints begin at the corner, textures anywhere.
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
    origin_m: tuple[float, float] | None = None

    def but(self, **changes: object) -> Material:
        """Return a copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


# Columns of `Mesh.table`.
CORNER = 0  # (3) start of edges a and b
NORMAL = 3  # (3) towards the side from which it is seen
DUAL_A, DUAL_B = (
    6,
    9,
)  # (3) dual vectors: their product with a point's vector from the corner is u, v in metres
LENGTH_A, LENGTH_B = 12, 13
PLANE = 14  # normal times corner
ELLIPSE = 15  # 1 if only the inscribed ellipse exists
EMISSION, GLOSS, ROUGHNESS = 16, 17, 18
ALBEDO, CONTRAST, TEXTURE = 19, 20, 21
SCALE_U, SCALE_V, SHIFT_U, SHIFT_V = 22, 23, 24, 25  # metres to repetitions of the texture
JOINT_U, JOINT_V, JOINT_WIDTH, JOINT_ALBEDO, JOINT_TURN = 26, 27, 28, 29, 30
ORIGIN_U, ORIGIN_V = 31, 32  # of the joints, metres
LIGHT_START, LIGHT_NU, LIGHT_NV = 33, 34, 35  # cells in `Mesh.lightmap`
POINTS = 36  # (4, 3) the corners
COLUMNS = 48

# Entries of `Mesh.sun`.
SUN_X, SUN_Y, SUN_Z = 0, 1, 2  # unit vector towards the sun
SUN_LIGHT = 3  # radiance of a white surface square to it; 0: no sun
SUN_WALL_Y = 4  # of the window wall; its panes run along x
SUN_FIRST, SUN_LAST = 5, 6  # panes from this x to that one
SUN_PITCH, SUN_PANE = 7, 8  # from pane to pane, and a pane's width
SUN_SILL, SUN_HEAD = 9, 10  # above the floor
SUN_SLOPE = 11  # rise of the floor over x
SUN_COUNT = 12


class Mesh(NamedTuple):
    """The arrays the compiled loops read; n surfaces, m tree nodes.

    Few and wide arrays, passed one by one: numba counts the references of arrays in tuples atomically at every call.

    Parameters
    ----------
    table
        (n, COLUMNS), see the column names above; surfaces in the order of the tree's leaves.
    nodes
        (m, 9): minimum and maximum of a node's box, the next node if it is missed (else the following one),
        first and count of a leaf's surfaces; inner nodes count none.
    lightmap
        Light on every cell of every surface.
    textures
        Ripmaps of every texture, one after another, see `fusion.simulate.scene.textures`.
    """

    table: FloatArray
    nodes: FloatArray
    lightmap: npt.NDArray[np.float32]
    textures: npt.NDArray[np.float32]
    sun: FloatArray


def _half_area(low: FloatArray, high: FloatArray) -> FloatArray:
    x, y, z = (high - low).T
    return np.asarray(x * y + y * z + z * x)


def _best_split(low: FloatArray, high: FloatArray) -> tuple[npt.NDArray[np.int64], int]:
    """Order boxes (n, 3) and return how many go left, by the surface area heuristic."""
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
    """Build a tree of boxes around surfaces (n, 4, 3).

    Returns `Mesh.nodes` and the required order (n,) of the surfaces.
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

    # floors and ceilings would enlarge every box; tested first, they shorten the ray for the rest
    large = np.max(high - low, axis=1) > LARGE_M
    for members in (np.flatnonzero(large), np.flatnonzero(~large)):
        if len(members):
            grow(members, len(members) if large[members[0]] else LEAF_SIZE)
    return np.array(nodes, float), np.array(order, np.int64)
