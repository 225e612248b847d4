"""The compiled loops that shoot rays at a `Mesh`: nearest hit, shadow, colour of a hit.

Geometry of a hit: ray ``P = O + t D``; the plane gives t, the dual vectors of the two edges give u and v in metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.simulate.mesh import Mesh
from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]

FAR_M = 1e9
STACK = 64
SIZE = 256  # of textures, see fusion.simulate.textures
LEVELS = 9


@compiled
def hit_distance(mesh: Mesh, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Any:
    """Distance to surface i with its u and v, metres; FAR_M where it is missed or seen from behind."""
    g = mesh.geometry[i]
    slope = g[3] * dx + g[4] * dy + g[5] * dz
    if slope > -1e-9:
        return FAR_M, 0.0, 0.0
    t = (g[14] - g[3] * ox - g[4] * oy - g[5] * oz) / slope
    if t < 1e-6:
        return FAR_M, 0.0, 0.0
    px, py, pz = ox + t * dx - g[0], oy + t * dy - g[1], oz + t * dz - g[2]
    u = g[6] * px + g[7] * py + g[8] * pz
    if u < 0.0 or u > g[12]:
        return FAR_M, 0.0, 0.0
    v = g[9] * px + g[10] * py + g[11] * pz
    if v < 0.0 or v > g[13]:
        return FAR_M, 0.0, 0.0
    if g[15] > 0.0:
        a, b = 2.0 * u / g[12] - 1.0, 2.0 * v / g[13] - 1.0
        if a * a + b * b > 1.0:
            return FAR_M, 0.0, 0.0
    return t, u, v


@compiled
def box_distance(box: FloatArray, ox: float, oy: float, oz: float, ix: float, iy: float, iz: float) -> float:
    """Distance at which a ray (given by the inverse of its direction) enters a box; FAR_M where it misses."""
    a, b = (box[0] - ox) * ix, (box[3] - ox) * ix
    near, far = min(a, b), max(a, b)
    a, b = (box[1] - oy) * iy, (box[4] - oy) * iy
    near, far = max(near, min(a, b)), min(far, max(a, b))
    a, b = (box[2] - oz) * iz, (box[5] - oz) * iz
    near, far = max(near, min(a, b)), min(far, max(a, b))
    if far < 0.0 or near > far:
        return FAR_M
    return max(near, 0.0)


@compiled
def trace(
    mesh: Mesh, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, reach: float, any_hit: bool
) -> Any:
    """Nearest surface within ``reach`` (or any, for shadows): index or -1, distance, u, v."""
    ix = 1.0 / dx if abs(dx) > 1e-12 else 1e12
    iy = 1.0 / dy if abs(dy) > 1e-12 else 1e12
    iz = 1.0 / dz if abs(dz) > 1e-12 else 1e12
    stack = np.empty(STACK, np.int64)
    stack[0] = 0
    depth = 1
    best, best_t, best_u, best_v = -1, reach, 0.0, 0.0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        if box_distance(mesh.node_box[node], ox, oy, oz, ix, iy, iz) >= best_t:
            continue
        link = mesh.node_link[node]
        if link[2] == 0:
            for k in range(link[0], link[0] + link[1]):
                i = mesh.order[k]
                t, u, v = hit_distance(mesh, i, ox, oy, oz, dx, dy, dz)
                if t < best_t:
                    best, best_t, best_u, best_v = i, t, u, v
                    if any_hit:
                        return best, best_t, best_u, best_v
            continue
        left = box_distance(mesh.node_box[link[0]], ox, oy, oz, ix, iy, iz)
        right = box_distance(mesh.node_box[link[1]], ox, oy, oz, ix, iy, iz)
        first, second = (link[0], link[1]) if left <= right else (link[1], link[0])
        if max(left, right) < best_t:
            stack[depth] = second
            depth += 1
        if min(left, right) < best_t:
            stack[depth] = first
            depth += 1
    return best, best_t, best_u, best_v


@compiled
def texture_value(mesh: Mesh, number: int, u: float, v: float, width_u: float, width_v: float) -> float:
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
    # copies lie by (level_v, level_u); the widths of a row of copies add up to 2 SIZE - 1
    start = mesh.texture_start[number]
    start += (2 * SIZE - 2 * rows) * (2 * SIZE - 1) + rows * (2 * SIZE - 2 * columns)
    x, y = u * columns - 0.5, v * rows - 0.5
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - x0, y - y0
    xa, xb = x0 & (columns - 1), (x0 + 1) & (columns - 1)
    ya, yb = start + (y0 & (rows - 1)) * columns, start + ((y0 + 1) & (rows - 1)) * columns
    levels = mesh.texture_levels
    low = levels[ya + xa] * (1.0 - fx) + levels[ya + xb] * fx
    high = levels[yb + xa] * (1.0 - fx) + levels[yb + xb] * fx
    return low * (1.0 - fy) + high * fy


@compiled
def joint_share(x: float, footprint: float, spacing: float, width: float) -> float:
    """Share of a footprint about x that lies in joints, which end at the multiples of the spacing."""
    a, b = (x - 0.5 * footprint) / spacing, (x + 0.5 * footprint) / spacing
    fill = width / spacing
    ia, ib = np.floor(a), np.floor(b)
    area = (ib * fill + min(b - ib, fill)) - (ia * fill + min(a - ia, fill))
    return min(1.0, area * spacing / footprint)


@compiled
def irradiance(mesh: Mesh, i: int, u: float, v: float) -> float:
    """Baked light on surface i at (u, v) metres, bilinear."""
    start, nu, nv = mesh.light_index[i]
    x = u / mesh.geometry[i, 12] * nu - 0.5
    y = v / mesh.geometry[i, 13] * nv - 0.5
    x, y = min(max(x, 0.0), nu - 1.0), min(max(y, 0.0), nv - 1.0)
    x0, y0 = int(x), int(y)
    x1, y1 = min(x0 + 1, nu - 1), min(y0 + 1, nv - 1)
    fx, fy = x - x0, y - y0
    m = mesh.lightmap
    low = m[start + y0 * nu + x0] * (1.0 - fx) + m[start + y0 * nu + x1] * fx
    high = m[start + y1 * nu + x0] * (1.0 - fx) + m[start + y1 * nu + x1] * fx
    return low * (1.0 - fy) + high * fy


@compiled
def reflectance(mesh: Mesh, i: int, u: float, v: float, foot_u: float, foot_v: float) -> float:
    """Albedo of surface i at (u, v) metres, averaged over a footprint in metres."""
    s = mesh.surface[i]
    value = s[0]
    number = int(s[12])
    if number >= 0 and s[3] > 0.0:
        sample = texture_value(mesh, number, u * s[4] + s[6], v * s[5] + s[7], foot_u * s[4], foot_v * s[5])
        value *= max(0.0, 1.0 + s[3] * (sample - 1.0))
    if s[10] > 0.0:
        clear = 1.0
        if s[8] > 0.0:
            clear *= 1.0 - joint_share(u, max(foot_u, 1e-5), s[8], s[10])
        if s[9] > 0.0:
            clear *= 1.0 - joint_share(v, max(foot_v, 1e-5), s[9], s[10])
        value = value * clear + s[11] * (1.0 - clear)
    return value


@compiled
def radiance(
    mesh: Mesh, i: int, t: float, u: float, v: float, dx: float, dy: float, dz: float, angle: float
) -> float:
    """Diffuse and emitted light from a hit; ``angle`` is the pixel's angular size, for the footprint."""
    g, s = mesh.geometry[i], mesh.surface[i]
    slope = g[3] * dx + g[4] * dy + g[5] * dz
    along_u = (g[6] * dx + g[7] * dy + g[8] * dz) / slope
    along_v = (g[9] * dx + g[10] * dy + g[11] * dz) / slope
    foot_u = t * angle * np.sqrt(1.0 + along_u * along_u)
    foot_v = t * angle * np.sqrt(1.0 + along_v * along_v)
    albedo = reflectance(mesh, i, u, v, foot_u, foot_v)
    if s[1] > 0.0:
        return s[1] * albedo  # a lamp or a window: what it reflects is lost in its own light
    return albedo * irradiance(mesh, i, u, v)


@compiled
def mirror_share(gloss: float, cosine: float) -> float:
    """Fresnel reflection after Schlick, scaled so that gloss is the value at perpendicular view."""
    if gloss <= 0.0:
        return 0.0
    x = 1.0 - cosine
    x2 = x * x
    return gloss + (0.6 - gloss) * x2 * x2 * x


@compiled
def scatter(a: int, b: int, c: int) -> float:
    """Hash of three numbers to [0, 1): repeatable jitter without state."""
    h = (a * 374761393 + b * 668265263 + c * 2147483647) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return ((h ^ (h >> 15)) & 0xFFFFFF) / 16777216.0
