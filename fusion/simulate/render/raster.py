"""The compiled loops that turn a `Mesh` and a camera's rays into a picture, tile by tile.

The surfaces visible in a tile are found once, by the four planes through its edges, and sorted by depth; each ray
then tests few surfaces. One ray goes through every pixel corner. If the four corners of a pixel hit one surface, the
colour is their mean; otherwise the pixel is sampled on a grid, so that edges are averages over the pixel's area.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fusion.simulate.render import kernels
from fusion.simulate.render import mesh as layout
from fusion.simulate.render.compile import inner, outer
from fusion.simulate.render.kernels import (
    FAR_M,
    LIFT_M,
    FloatArray,
    Indices,
    Light,
    dot,
    hit_distance,
    mirror_share,
    radiance,
    trace,
)
from fusion.simulate.render.mesh import DUAL_A, DUAL_B, GLOSS, NORMAL, PLANE, POINTS, ROUGHNESS

TILE = 8
MAX_SEEN = 4096
SLACK = 1e-6  # tolerance of a tile's visibility against rounding
BLOCK = 6  # size of a block of pixels that share the directions of a rough reflection
GOLDEN_ANGLE = 2.399963229728653
BRIGHTEST = 8.0  # of mirrored light: beyond it the sensor saturates anyway


@inner
def _rotate_rays(
    rays: FloatArray, rotations: FloatArray, top: int, left: int, rows: int, columns: int, out: FloatArray
) -> int:
    """World directions of a tile's corner rays, row by row; return their number."""
    n = 0
    for y in range(top, top + rows + 1):
        pose = min(y, rotations.shape[0] - 1)
        for x in range(left, left + columns + 1):
            a, b, c = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
            for k in range(3):
                out[n, k] = rotations[pose, k, 0] * a + rotations[pose, k, 1] * b + rotations[pose, k, 2] * c
            n += 1
    return n


@inner
def _pyramid(rays: FloatArray, n: int, axis: FloatArray, rim: FloatArray) -> bool:
    """Find a pyramid around n rays: its axis (3,) and four edge vectors (4, 3); False if there is no ray."""
    axis[:] = 0.0
    found = 0
    for k in range(n):
        if rays[k, 0] == rays[k, 0]:
            axis[0] += rays[k, 0]
            axis[1] += rays[k, 1]
            axis[2] += rays[k, 2]
            found += 1
    if found == 0:
        return False
    axis /= np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    ax, ay, az = axis[0], axis[1], axis[2]
    sx, sy, sz = (ay, -ax, 0.0) if abs(az) < 0.9 else (0.0, az, -ay)
    size = np.sqrt(sx * sx + sy * sy + sz * sz)
    sx, sy, sz = sx / size, sy / size, sz / size
    ux, uy, uz = ay * sz - az * sy, az * sx - ax * sz, ax * sy - ay * sx
    low_x, high_x, low_y, high_y = FAR_M, -FAR_M, FAR_M, -FAR_M
    for k in range(n):
        a, b, c = rays[k, 0], rays[k, 1], rays[k, 2]
        if a != a:
            continue
        inverse = 1.0 / (a * ax + b * ay + c * az)
        x, y = (a * sx + b * sy + c * sz) * inverse, (a * ux + b * uy + c * uz) * inverse
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    for k in range(4):
        x = low_x - SLACK if k == 0 or k == 3 else high_x + SLACK
        y = low_y - SLACK if k < 2 else high_y + SLACK
        rim[k, 0], rim[k, 1], rim[k, 2] = ax + x * sx + y * ux, ay + x * sy + y * uy, az + x * sz + y * uz
    return True


@inner
def _outside(table: FloatArray, i: int, origin: FloatArray, planes: FloatArray) -> bool:
    """Whether all corners of surface i lie outside one of the planes through the origin."""
    for p in range(planes.shape[0]):
        a, b, c = planes[p, 0], planes[p, 1], planes[p, 2]
        shift = a * origin[0] + b * origin[1] + c * origin[2]
        out = True
        for k in range(POINTS, POINTS + 12, 3):
            if dot(table, i, k, a, b, c) > shift:
                out = False
                break
        if out:
            return True
    return False


@inner
def _box_outside(nodes: FloatArray, node: int, origin: FloatArray, planes: FloatArray) -> bool:
    for p in range(planes.shape[0]):
        far = 0.0
        for k in range(3):
            n = planes[p, k]
            far += n * ((nodes[node, k + 3] if n > 0.0 else nodes[node, k]) - origin[k])
        if far < 0.0:
            return True
    return False


@inner
def _list_seen(
    table: FloatArray, nodes: FloatArray, origin: FloatArray, axis: FloatArray, rim: FloatArray, planes: FloatArray,
    seen: Indices, near: FloatArray,
) -> int:  # fmt: skip
    """List the surfaces visible in a tile with their least depth along its axis, nearest first; return the count."""
    for k in range(4):
        j = (k + 1) % 4
        planes[k, 0] = rim[k, 1] * rim[j, 2] - rim[k, 2] * rim[j, 1]
        planes[k, 1] = rim[k, 2] * rim[j, 0] - rim[k, 0] * rim[j, 2]
        planes[k, 2] = rim[k, 0] * rim[j, 1] - rim[k, 1] * rim[j, 0]
        inward = planes[k, 0] * axis[0] + planes[k, 1] * axis[1] + planes[k, 2] * axis[2]
        for m in range(3):
            planes[k, m] *= np.sign(inward)
            planes[4, m] = axis[m]
    node, end, count = 0, nodes.shape[0], 0
    while node < end:
        if _box_outside(nodes, node, origin, planes):
            node = int(nodes[node, 6])
            continue
        first = int(nodes[node, 7])
        for i in range(first, first + int(nodes[node, 8])):
            height = table[i, PLANE] - dot(table, i, NORMAL, origin[0], origin[1], origin[2])
            if height > 0.0 or count >= MAX_SEEN or _outside(table, i, origin, planes):
                continue
            # 1/depth is linear over the pyramid's section: its maximum is at an edge vector
            inverse = 1e-9
            for j in range(4):
                slope = dot(table, i, NORMAL, rim[j, 0], rim[j, 1], rim[j, 2])
                inverse = max(inverse, slope / min(height, -1e-12))
            depth = 1.0 / inverse
            place = count
            while place > 0 and near[place - 1] > depth:
                near[place], seen[place] = near[place - 1], seen[place - 1]
                place -= 1
            near[place], seen[place] = depth, i
            count += 1
        node += 1
    return count


@inner
def _nearest(
    table: FloatArray,
    origin: FloatArray,
    dx: float,
    dy: float,
    dz: float,
    seen: Indices,
    near: FloatArray,
    count: int,
) -> Any:
    """Nearest of the listed surfaces along a ray: index or -1, distance, u, v."""
    best, best_t, best_u, best_v = -1, FAR_M, 0.0, 0.0
    ox, oy, oz = origin[0], origin[1], origin[2]
    for k in range(count):
        if near[k] > best_t:
            break
        t, u, v = hit_distance(table, seen[k], ox, oy, oz, dx, dy, dz)
        if t < best_t:
            best, best_t, best_u, best_v = seen[k], t, u, v
    return best, best_t, best_u, best_v


@inner
def _mirrored(
    table: FloatArray, nodes: FloatArray, lightmap: Light, textures: Light, sun: FloatArray,
    i: int, t: float, origin: FloatArray,
    dx: float, dy: float, dz: float, angle: float, x: int, y: int,
) -> float:  # fmt: skip
    """Light that a glossy surface mirrors along one reflected ray.

    The normal is tilted by the roughness; the pixels of a block of `BLOCK` by `BLOCK` divide the directions evenly,
    so that the mean over a block is the mean over all directions.
    """
    k = (x % BLOCK) + BLOCK * (y % BLOCK)
    lean = 1.5 * table[i, ROUGHNESS] * np.sqrt((k + 0.5) / (BLOCK * BLOCK))
    a, b = lean * np.cos(GOLDEN_ANGLE * k), lean * np.sin(GOLDEN_ANGLE * k)
    nx = table[i, NORMAL] + a * table[i, DUAL_A] + b * table[i, DUAL_B]
    ny = table[i, NORMAL + 1] + a * table[i, DUAL_A + 1] + b * table[i, DUAL_B + 1]
    nz = table[i, NORMAL + 2] + a * table[i, DUAL_A + 2] + b * table[i, DUAL_B + 2]
    slope = 2.0 * (nx * dx + ny * dy + nz * dz) / (nx * nx + ny * ny + nz * nz)
    rx, ry, rz = dx - slope * nx, dy - slope * ny, dz - slope * nz
    px = origin[0] + t * dx + LIFT_M * table[i, NORMAL]
    py = origin[1] + t * dy + LIFT_M * table[i, NORMAL + 1]
    pz = origin[2] + t * dz + LIFT_M * table[i, NORMAL + 2]
    j, far, u, v = trace(table, nodes, px, py, pz, rx, ry, rz, FAR_M, False)
    if j < 0:
        return 0.0
    angle += table[i, ROUGHNESS]
    return min(
        radiance(table, nodes, lightmap, textures, sun, j, t + far, u, v, rx, ry, rz, angle), BRIGHTEST
    )


@inner
def _share(table: FloatArray, i: int, dx: float, dy: float, dz: float) -> float:
    gloss = table[i, GLOSS]
    return mirror_share(gloss, -dot(table, i, NORMAL, dx, dy, dz)) if gloss > 0.0 else 0.0


@inner
def _corner_pass(
    table: FloatArray, nodes: FloatArray, lightmap: Light, textures: Light, sun: FloatArray,
    d: FloatArray, n: int, origin: FloatArray, angle: float,
    seen: Indices, near: FloatArray, count: int, ids: Indices, hit: FloatArray,
) -> None:  # fmt: skip
    """Trace the rays d (n, 3): surface into ``ids``; light, mirror share and distance into ``hit`` (n, 3)."""
    for k in range(n):
        ids[k], hit[k, 0], hit[k, 1], hit[k, 2] = -1, 0.0, 0.0, 0.0
        dx, dy, dz = d[k, 0], d[k, 1], d[k, 2]
        if dx != dx:
            continue
        i, t, u, v = _nearest(table, origin, dx, dy, dz, seen, near, count)
        if i >= 0:
            ids[k], hit[k, 2] = i, t
            hit[k, 0] = radiance(table, nodes, lightmap, textures, sun, i, t, u, v, dx, dy, dz, angle)
            hit[k, 1] = _share(table, i, dx, dy, dz)


@inner
def _edge_pixel(
    table: FloatArray, nodes: FloatArray, lightmap: Light, textures: Light, sun: FloatArray,
    d: FloatArray, corner: Any, origin: FloatArray, angle: float,
    seen: Indices, near: FloatArray, count: int, ids: Indices, hit: FloatArray, grid: int,
) -> Any:  # fmt: skip
    """Mean light and mirror share over a grid of rays within the pixel between four corner rays.

    A sample on the same surface as a corner gets that corner's colour: colours change little within a pixel and
    surface.
    """
    total, share = 0.0, 0.0
    a, b, c, e = corner
    for k in range(grid * grid):
        fx, fy = (k % grid + 0.5) / grid, (k // grid + 0.5) / grid
        wa, wb, wc, we = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
        dx = wa * d[a, 0] + wb * d[b, 0] + wc * d[c, 0] + we * d[e, 0]
        dy = wa * d[a, 1] + wb * d[b, 1] + wc * d[c, 1] + we * d[e, 1]
        dz = wa * d[a, 2] + wb * d[b, 2] + wc * d[c, 2] + we * d[e, 2]
        if dx != dx:
            continue
        i, t, u, v = _nearest(table, origin, dx, dy, dz, seen, near, count)
        if i < 0:
            continue
        known = (
            a if ids[a] == i else (b if ids[b] == i else (c if ids[c] == i else (e if ids[e] == i else -1)))
        )
        if known >= 0:
            total += hit[known, 0]
            share += hit[known, 1]
        else:
            total += radiance(table, nodes, lightmap, textures, sun, i, t, u, v, dx, dy, dz, angle / grid)
            share += _share(table, i, dx, dy, dz)
    return total / (grid * grid), share / (grid * grid)


@outer(kernels, layout)
def render_rows(
    table: FloatArray, nodes: FloatArray, lightmap: Light, textures: Light, sun: FloatArray,
    rays: FloatArray, pixel_rad: FloatArray,
    origins: FloatArray, rotations: FloatArray, grid: int, turn: int, turns: int,
    direct: Light, share: Light, mirror: Light,
) -> None:  # fmt: skip
    """Fill diffuse light, mirror share and mirrored light (h, w) each.

    Row y is seen from ``origins[y]`` (h, 3) with ``rotations[y]`` (h, 3, 3), body to world; ``rays``
    (h + 1, w + 1, 3) go through the pixel corners. Each of several averaged
    exposures computes the mirrored light of its share of the pixels: ``turn`` of ``turns``.
    """
    height, width = direct.shape
    size = (TILE + 1) * (TILE + 1)
    seen, near, planes = np.empty(MAX_SEEN, np.int64), np.empty(MAX_SEEN), np.empty((5, 3))
    d, ids, hit = np.empty((size, 3)), np.empty(size, np.int64), np.empty((size, 3))
    axis, rim, origin = np.empty(3), np.empty((4, 3)), np.empty(3)
    for top in range(0, height, TILE):
        rows = min(TILE, height - top)
        # one position per tile: within eight rows a rolling shutter moves by a fraction of a millimetre
        for k in range(3):
            origin[k] = origins[top + rows // 2, k]
        for left in range(0, width, TILE):
            columns = min(TILE, width - left)
            n = _rotate_rays(rays, rotations, top, left, rows, columns, d)
            if not _pyramid(d, n, axis, rim):
                continue
            count = _list_seen(table, nodes, origin, axis, rim, planes, seen, near)
            angle = pixel_rad[top + rows // 2, left + columns // 2]
            _corner_pass(
                table, nodes, lightmap, textures, sun, d, n, origin, angle, seen, near, count, ids, hit
            )
            for pixel in range(rows * columns):
                y, x = pixel // columns, pixel % columns
                a = y * (columns + 1) + x
                b, c, e = a + 1, a + columns + 1, a + columns + 2
                py, px = top + y, left + x
                if hit[a, 1] > 0.0 and (px + 2 * py) % turns == turn:
                    mirror[py, px] = _mirrored(
                        table, nodes, lightmap, textures, sun, ids[a], hit[a, 2], origin,
                        d[a, 0], d[a, 1], d[a, 2], angle, px, py,
                    )  # fmt: skip
                if ids[a] == ids[b] and ids[a] == ids[c] and ids[a] == ids[e]:
                    direct[py, px] = 0.25 * (hit[a, 0] + hit[b, 0] + hit[c, 0] + hit[e, 0])
                    share[py, px] = 0.25 * (hit[a, 1] + hit[b, 1] + hit[c, 1] + hit[e, 1])
                else:
                    direct[py, px], share[py, px] = _edge_pixel(
                        table, nodes, lightmap, textures, sun, d, (a, b, c, e), origin, angle,
                        seen, near, count, ids, hit, grid,
                    )  # fmt: skip
