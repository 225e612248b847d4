"""The compiled loops that cast rays at a `Mesh`: nearest hit, shadow, colour of a hit.

A hit is the ray's ``O + t D`` in the surface's plane; the dual vectors of its edges give u and v there, in metres.
The arrays are `Mesh`'s, and its columns are described there.
"""

from __future__ import annotations

from math import cos, hypot, sin
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.simulate.render import mesh as m
from fusion.simulate.render.compile import inner

FloatArray = npt.NDArray[np.float64]
Light = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]

FAR_M = 1e9
LIFT_M = 0.004  # distance of a ray's start from its surface
SIZE = m.TEXTURE_SIZE
LEVELS = m.TEXTURE_LEVELS
COPIES = (2 * SIZE - 1) * (2 * SIZE - 1)  # numbers in one texture's ripmap
NORMAL, CORNER, DUAL_A, DUAL_B = m.NORMAL, m.CORNER, m.DUAL_A, m.DUAL_B
LENGTH_A, LENGTH_B, PLANE, ELLIPSE = m.LENGTH_A, m.LENGTH_B, m.PLANE, m.ELLIPSE
EMISSION, GLOSS, ALBEDO, CONTRAST, TEXTURE = m.EMISSION, m.GLOSS, m.ALBEDO, m.CONTRAST, m.TEXTURE
SCALE_U, SCALE_V, SHIFT_U, SHIFT_V = m.SCALE_U, m.SCALE_V, m.SHIFT_U, m.SHIFT_V
JOINT_U, JOINT_V, JOINT_WIDTH, JOINT_ALBEDO = m.JOINT_U, m.JOINT_V, m.JOINT_WIDTH, m.JOINT_ALBEDO
JOINT_TURN, ORIGIN_U, ORIGIN_V = m.JOINT_TURN, m.ORIGIN_U, m.ORIGIN_V
LIGHT_START, LIGHT_NU, LIGHT_NV = m.LIGHT_START, m.LIGHT_NU, m.LIGHT_NV
POINTS, SUN_X, SUN_Y, SUN_Z, SUN_LIGHT = m.POINTS, m.SUN_X, m.SUN_Y, m.SUN_Z, m.SUN_LIGHT
SUN_WALL_Y, SUN_FIRST, SUN_LAST = m.SUN_WALL_Y, m.SUN_FIRST, m.SUN_LAST
SUN_PITCH, SUN_PANE, SUN_SILL, SUN_HEAD, SUN_SLOPE = (
    m.SUN_PITCH,
    m.SUN_PANE,
    m.SUN_SILL,
    m.SUN_HEAD,
    m.SUN_SLOPE,
)
WALL_FITTINGS_M = 0.06  # frames and bars up to this far from the window wall cast no shadow


@inner
def dot(table: FloatArray, i: int, column: int, x: float, y: float, z: float) -> float:
    """Scalar product of a vector with the one that starts in a column of the table."""
    return float(table[i, column] * x + table[i, column + 1] * y + table[i, column + 2] * z)


@inner
def hit_distance(
    table: FloatArray, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> Any:
    """Distance to surface i with its u and v, metres; FAR_M if it is missed or seen from behind."""
    slope = dot(table, i, NORMAL, dx, dy, dz)
    if slope > -1e-9:
        return FAR_M, 0.0, 0.0
    t = (table[i, PLANE] - dot(table, i, NORMAL, ox, oy, oz)) / slope
    if t < 1e-6:
        return FAR_M, 0.0, 0.0
    px, py, pz = (
        ox + t * dx - table[i, CORNER],
        oy + t * dy - table[i, CORNER + 1],
        oz + t * dz - table[i, CORNER + 2],
    )
    u = dot(table, i, DUAL_A, px, py, pz)
    if u < 0.0 or u > table[i, LENGTH_A]:
        return FAR_M, 0.0, 0.0
    v = dot(table, i, DUAL_B, px, py, pz)
    if v < 0.0 or v > table[i, LENGTH_B]:
        return FAR_M, 0.0, 0.0
    if table[i, ELLIPSE] > 0.0:
        a, b = 2.0 * u / table[i, LENGTH_A] - 1.0, 2.0 * v / table[i, LENGTH_B] - 1.0
        if a * a + b * b > 1.0:
            return FAR_M, 0.0, 0.0
    return t, u, v


@inner
def trace(
    table: FloatArray, nodes: FloatArray, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float,
    reach: float, any_hit: bool,
) -> Any:  # fmt: skip
    """Nearest surface within ``reach`` (or any, for shadows): index or -1, distance, u, v."""
    ix = 1.0 / dx if abs(dx) > 1e-12 else 1e12
    iy = 1.0 / dy if abs(dy) > 1e-12 else 1e12
    iz = 1.0 / dz if abs(dz) > 1e-12 else 1e12
    best, best_t, best_u, best_v = -1, reach, 0.0, 0.0
    node, count = 0, nodes.shape[0]
    while node < count:
        a, b = (nodes[node, 0] - ox) * ix, (nodes[node, 3] - ox) * ix
        near, far = min(a, b), max(a, b)
        a, b = (nodes[node, 1] - oy) * iy, (nodes[node, 4] - oy) * iy
        near, far = max(near, min(a, b)), min(far, max(a, b))
        a, b = (nodes[node, 2] - oz) * iz, (nodes[node, 5] - oz) * iz
        near, far = max(near, min(a, b)), min(far, max(a, b))
        if far < 0.0 or near > far or near >= best_t:
            node = int(nodes[node, 6])
            continue
        first = int(nodes[node, 7])
        for i in range(first, first + int(nodes[node, 8])):  # none in an inner node
            t, u, v = hit_distance(table, i, ox, oy, oz, dx, dy, dz)
            if t < best_t:
                best, best_t, best_u, best_v = i, t, u, v
                if any_hit:
                    return best, best_t, best_u, best_v
        node += 1
    return best, best_t, best_u, best_v


@inner
def texture_value(textures: Light, number: int, u: float, v: float, width_u: float, width_v: float) -> float:
    """Texture at (u, v), in repetitions, averaged over a footprint of the given widths."""
    level_u, width = 0, width_u * SIZE
    while width > 1.4 and level_u < LEVELS - 1:
        width *= 0.5
        level_u += 1
    level_v, width = 0, width_v * SIZE
    while width > 1.4 and level_v < LEVELS - 1:
        width *= 0.5
        level_v += 1
    columns, rows = SIZE >> level_u, SIZE >> level_v
    # copies are ordered by (level_v, level_u); the widths of a row of copies add up to 2 SIZE - 1
    start = number * COPIES
    start += (2 * SIZE - 2 * rows) * (2 * SIZE - 1) + rows * (2 * SIZE - 2 * columns)
    x, y = u * columns - 0.5, v * rows - 0.5
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - x0, y - y0
    xa, xb = x0 & (columns - 1), (x0 + 1) & (columns - 1)
    ya, yb = start + (y0 & (rows - 1)) * columns, start + ((y0 + 1) & (rows - 1)) * columns
    low = textures[ya + xa] * (1.0 - fx) + textures[ya + xb] * fx
    high = textures[yb + xa] * (1.0 - fx) + textures[yb + xb] * fx
    return float(low * (1.0 - fy) + high * fy)


@inner
def joint_share(x: float, footprint: float, spacing: float, width: float) -> float:
    """Share of a footprint about x within joints, which begin at the multiples of the spacing."""
    a, b = (x - 0.5 * footprint) / spacing, (x + 0.5 * footprint) / spacing
    fill = width / spacing
    ia, ib = np.floor(a), np.floor(b)
    area = (ib * fill + min(b - ib, fill)) - (ia * fill + min(a - ia, fill))
    return float(min(1.0, area * spacing / footprint))


@inner
def irradiance(table: FloatArray, lightmap: Light, i: int, u: float, v: float) -> float:
    """Baked light on surface i at (u, v) metres, bilinear."""
    start = int(table[i, LIGHT_START])
    nu, nv = int(table[i, LIGHT_NU]), int(table[i, LIGHT_NV])
    x, y = u / table[i, LENGTH_A] * nu - 0.5, v / table[i, LENGTH_B] * nv - 0.5
    x, y = min(max(x, 0.0), nu - 1.0), min(max(y, 0.0), nv - 1.0)
    x0, y0 = int(x), int(y)
    x1, y1 = min(x0 + 1, nu - 1), min(y0 + 1, nv - 1)
    fx, fy = x - x0, y - y0
    low = lightmap[start + y0 * nu + x0] * (1.0 - fx) + lightmap[start + y0 * nu + x1] * fx
    high = lightmap[start + y1 * nu + x0] * (1.0 - fx) + lightmap[start + y1 * nu + x1] * fx
    return float(low * (1.0 - fy) + high * fy)


@inner
def reflectance(
    table: FloatArray, textures: Light, i: int, u: float, v: float, foot_u: float, foot_v: float
) -> float:
    """Albedo of surface i at (u, v) metres, averaged over a footprint in metres."""
    value = table[i, ALBEDO]
    number = int(table[i, TEXTURE])
    if number >= 0:
        scale_u, scale_v = table[i, SCALE_U], table[i, SCALE_V]
        x, y = u * scale_u + table[i, SHIFT_U], v * scale_v + table[i, SHIFT_V]
        sample = texture_value(textures, number, x, y, foot_u * scale_u, foot_v * scale_v)
        value *= max(0.0, 1.0 + table[i, CONTRAST] * (sample - 1.0))
    width = table[i, JOINT_WIDTH]
    if width > 0.0:
        clear, c, s = 1.0, cos(table[i, JOINT_TURN]), sin(table[i, JOINT_TURN])
        u, v = u + table[i, ORIGIN_U], v + table[i, ORIGIN_V]
        if table[i, JOINT_U] > 0.0:
            foot = hypot(c * foot_u, s * foot_v)
            clear *= 1.0 - joint_share(c * u + s * v, max(foot, 1e-5), table[i, JOINT_U], width)
        if table[i, JOINT_V] > 0.0:
            foot = hypot(c * foot_v, s * foot_u)
            clear *= 1.0 - joint_share(c * v - s * u, max(foot, 1e-5), table[i, JOINT_V], width)
        value = value * clear + table[i, JOINT_ALBEDO] * (1.0 - clear)
    return float(value)


@inner
def sunlight(
    table: FloatArray, nodes: FloatArray, sun: FloatArray, i: int, px: float, py: float, pz: float, footprint: float
) -> float:  # fmt: skip
    """Light of the sun on surface i at a world point: through a pane of the window wall, if unobstructed."""
    cosine = dot(table, i, NORMAL, sun[SUN_X], sun[SUN_Y], sun[SUN_Z])
    if cosine <= 0.0:
        return 0.0
    way = (sun[SUN_WALL_Y] - py) / sun[SUN_Y]  # to the window wall
    x, z = px + way * sun[SUN_X], pz + way * sun[SUN_Z]
    height = -z - sun[SUN_SLOPE] * x
    if way <= WALL_FITTINGS_M or x < sun[SUN_FIRST] or x > sun[SUN_LAST]:
        return 0.0
    size = max(footprint, 1e-4)
    share = min(max((height - sun[SUN_SILL]) / size + 0.5, 0.0), 1.0)
    share *= min(max((sun[SUN_HEAD] - height) / size + 0.5, 0.0), 1.0)
    if share <= 0.0:
        return 0.0
    share *= joint_share(x - sun[SUN_FIRST], size, sun[SUN_PITCH], sun[SUN_PANE])
    if share <= 0.0:
        return 0.0
    ox, oy, oz = (
        px + LIFT_M * table[i, NORMAL],
        py + LIFT_M * table[i, NORMAL + 1],
        pz + LIFT_M * table[i, NORMAL + 2],
    )
    reach = way - WALL_FITTINGS_M / abs(sun[SUN_Y])
    blocker, _, _, _ = trace(table, nodes, ox, oy, oz, sun[SUN_X], sun[SUN_Y], sun[SUN_Z], reach, True)
    return float(share * cosine * sun[SUN_LIGHT]) if blocker < 0 else 0.0


@inner
def surface_point(table: FloatArray, i: int, u: float, v: float, k: int) -> float:
    """Component k of the world point at (u, v) metres on surface i."""
    a, b = u / table[i, LENGTH_A], v / table[i, LENGTH_B]
    return float(
        (1.0 - a - b) * table[i, POINTS + k] + a * table[i, POINTS + 3 + k] + b * table[i, POINTS + 9 + k]
    )


@inner
def radiance(
    table: FloatArray, nodes: FloatArray, lightmap: Light, textures: Light, sun: FloatArray, i: int, t: float,
    u: float, v: float, dx: float, dy: float, dz: float, angle: float,
) -> float:  # fmt: skip
    """Diffuse and emitted light from a hit; ``angle`` is the pixel's angular size, for the footprint."""
    inverse = 1.0 / dot(table, i, NORMAL, dx, dy, dz)
    along_u = dot(table, i, DUAL_A, dx, dy, dz) * inverse
    along_v = dot(table, i, DUAL_B, dx, dy, dz) * inverse
    foot_u = t * angle * np.sqrt(1.0 + along_u * along_u)
    foot_v = t * angle * np.sqrt(1.0 + along_v * along_v)
    albedo = reflectance(table, textures, i, u, v, foot_u, foot_v)
    if table[i, EMISSION] > 0.0:
        return float(table[i, EMISSION] * albedo)  # reflections of a lamp or a window are negligible
    light = irradiance(table, lightmap, i, u, v)
    if sun[SUN_LIGHT] > 0.0:
        x, y, z = (
            surface_point(table, i, u, v, 0),
            surface_point(table, i, u, v, 1),
            surface_point(table, i, u, v, 2),
        )
        light += sunlight(table, nodes, sun, i, x, y, z, t * angle)
    return albedo * light


@inner
def mirror_share(gloss: float, cosine: float) -> float:
    """Fresnel reflection after Schlick, scaled so that gloss is the value at perpendicular view."""
    x = 1.0 - cosine
    x2 = x * x
    return gloss + (0.6 - gloss) * x2 * x2 * x


@inner
def scatter(a: int, b: int, c: int) -> float:
    """Hash of three numbers to [0, 1): repeatable jitter without state."""
    h = (a * 374761393 + b * 668265263 + c * 2147483647) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return ((h ^ (h >> 15)) & 0xFFFFFF) / 16777216.0
