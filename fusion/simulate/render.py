"""Pictures of a `Mesh` in linear light, through any `vision.Camera`.

The picture is cut into tiles. What a tile can see is found once, by the four planes through its rim, and sorted by
depth; its rays then test few surfaces each. One ray goes through every pixel corner. Where the four corners of a
pixel meet one surface, their mean is its colour; where they do not, the pixel is sampled on a grid. So
edges are exact averages over the pixel, and their place is good to a few hundredths of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulate.kernels import FAR_M, hit_distance, mirror_share, radiance, scatter, trace
from fusion.simulate.mesh import Mesh
from vision import Camera
from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

TILE = 8
MAX_SEEN = 4096


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What does not change from frame to frame of one camera.

    Parameters
    ----------
    corner_rays
        Unit vectors in the body frame through the pixel corners, (h + 1, w + 1, 3); NaN outside the lens.
    pixel_rad
        Angular size of each pixel, (h, w).
    """

    camera: Camera
    corner_rays: FloatArray
    pixel_rad: FloatArray

    @classmethod
    def of(cls, camera: Camera) -> View:
        """Compute the rays of a camera."""
        h, w = camera.height_px, camera.width_px
        y, x = np.mgrid[0 : h + 1, 0 : w + 1]
        points = np.stack([x.ravel() - 0.5, y.ravel() - 0.5], axis=1)
        rays = (camera.rays(points) @ camera.R_body_camera.T).reshape(h + 1, w + 1, 3)
        right = np.linalg.norm(rays[:-1, 1:] - rays[:-1, :-1], axis=2)
        down = np.linalg.norm(rays[1:, :-1] - rays[:-1, :-1], axis=2)
        return cls(camera, np.ascontiguousarray(rays), np.sqrt(right * down))


@compiled
def _rotate(R: FloatArray, ray: FloatArray) -> Any:
    return (
        R[0, 0] * ray[0] + R[0, 1] * ray[1] + R[0, 2] * ray[2],
        R[1, 0] * ray[0] + R[1, 1] * ray[1] + R[1, 2] * ray[2],
        R[2, 0] * ray[0] + R[2, 1] * ray[1] + R[2, 2] * ray[2],
    )


@compiled
def _tile_pyramid(rays: FloatArray, n: int, slack: float, axis: FloatArray, rim: FloatArray) -> bool:
    """Find a pyramid round n rays: its axis (3,) and four rim vectors (4, 3); False if there is no ray."""
    axis[:] = 0.0
    found = 0
    for k in range(n):
        if rays[k, 0] == rays[k, 0]:
            axis += rays[k]
            found += 1
    if found == 0:
        return False
    axis /= np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    side = np.empty(3)
    if abs(axis[2]) < 0.9:
        side[0], side[1], side[2] = axis[1], -axis[0], 0.0
    else:
        side[0], side[1], side[2] = 0.0, axis[2], -axis[1]
    side /= np.sqrt(side[0] ** 2 + side[1] ** 2 + side[2] ** 2)
    up = np.cross(axis, side)
    low_x, high_x, low_y, high_y = FAR_M, -FAR_M, FAR_M, -FAR_M
    for k in range(n):
        r = rays[k]
        if r[0] != r[0]:
            continue
        z = r[0] * axis[0] + r[1] * axis[1] + r[2] * axis[2]
        x = (r[0] * side[0] + r[1] * side[1] + r[2] * side[2]) / z
        y = (r[0] * up[0] + r[1] * up[1] + r[2] * up[2]) / z
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    low_x, high_x, low_y, high_y = low_x - slack, high_x + slack, low_y - slack, high_y + slack
    rim[0] = axis + low_x * side + low_y * up
    rim[1] = axis + high_x * side + low_y * up
    rim[2] = axis + high_x * side + high_y * up
    rim[3] = axis + low_x * side + high_y * up
    return True


@compiled
def _outside(points: FloatArray, n: int, origin: FloatArray, planes: FloatArray) -> bool:
    """Whether all n points lie outside one of the planes through the origin."""
    for p in range(planes.shape[0]):
        a, b, c = planes[p, 0], planes[p, 1], planes[p, 2]
        shift = a * origin[0] + b * origin[1] + c * origin[2]
        out = True
        for k in range(n):
            if a * points[k, 0] + b * points[k, 1] + c * points[k, 2] > shift:
                out = False
                break
        if out:
            return True
    return False


@compiled
def _box_outside(box: FloatArray, origin: FloatArray, planes: FloatArray) -> bool:
    for p in range(planes.shape[0]):
        far = 0.0
        for k in range(3):
            n = planes[p, k]
            far += n * ((box[k + 3] if n > 0.0 else box[k]) - origin[k])
        if far < 0.0:
            return True
    return False


@compiled
def _tile_seen(
    mesh: Mesh,
    origin: FloatArray,
    axis: FloatArray,
    rim: FloatArray,
    seen: npt.NDArray[np.int64],
    near: FloatArray,
) -> int:
    """List the surfaces a tile can see with the least depth along its axis, nearest first; return how many."""
    planes = np.empty((5, 3))
    for k in range(4):
        a, b = rim[k], rim[(k + 1) % 4]
        planes[k, 0] = a[1] * b[2] - a[2] * b[1]
        planes[k, 1] = a[2] * b[0] - a[0] * b[2]
        planes[k, 2] = a[0] * b[1] - a[1] * b[0]
        if planes[k, 0] * axis[0] + planes[k, 1] * axis[1] + planes[k, 2] * axis[2] < 0.0:
            planes[k] = -planes[k]
    planes[4] = axis
    stack = np.empty(64, np.int64)
    stack[0], depth, count = 0, 1, 0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        if _box_outside(mesh.node_box[node], origin, planes):
            continue
        link = mesh.node_link[node]
        if link[2] == 1:
            stack[depth], stack[depth + 1] = link[0], link[1]
            depth += 2
            continue
        for k in range(link[0], link[0] + link[1]):
            i = mesh.order[k]
            g = mesh.geometry[i]
            height = g[14] - g[3] * origin[0] - g[4] * origin[1] - g[5] * origin[2]
            if height > 0.0 or count >= MAX_SEEN or _outside(mesh.corners[i], 4, origin, planes):
                continue
            # 1/depth is linear over the pyramid's section: its greatest value stands at a rim vector
            inverse = 1e-9
            for j in range(4):
                slope = g[3] * rim[j, 0] + g[4] * rim[j, 1] + g[5] * rim[j, 2]
                inverse = max(inverse, slope / min(height, -1e-12))
            depth_i = 1.0 / inverse
            place = count
            while place > 0 and near[place - 1] > depth_i:
                near[place], seen[place] = near[place - 1], seen[place - 1]
                place -= 1
            near[place], seen[place] = depth_i, i
            count += 1
    return count


@compiled
def _nearest(
    mesh: Mesh,
    origin: FloatArray,
    dx: float,
    dy: float,
    dz: float,
    seen: npt.NDArray[np.int64],
    near: FloatArray,
    count: int,
) -> Any:
    best, best_t, best_u, best_v = -1, FAR_M, 0.0, 0.0
    for k in range(count):
        if near[k] > best_t:
            break
        t, u, v = hit_distance(mesh, seen[k], origin[0], origin[1], origin[2], dx, dy, dz)
        if t < best_t:
            best, best_t, best_u, best_v = seen[k], t, u, v
    return best, best_t, best_u, best_v


@compiled
def _mirrored(
    mesh: Mesh, i: int, t: float, origin: FloatArray, d: FloatArray, angle: float, rough: float, key: int
) -> float:
    """Light that a glossy surface mirrors, from a jittered reflected ray; the picture is smoothed afterwards."""
    g = mesh.geometry[i]
    px, py, pz = origin[0] + t * d[0], origin[1] + t * d[1], origin[2] + t * d[2]
    nx = g[3] + rough * (scatter(key, 1, 0) + scatter(key, 2, 0) - 1.0)
    ny = g[4] + rough * (scatter(key, 3, 0) + scatter(key, 4, 0) - 1.0)
    nz = g[5] + rough * (scatter(key, 5, 0) + scatter(key, 6, 0) - 1.0)
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / size, ny / size, nz / size
    slope = 2.0 * (nx * d[0] + ny * d[1] + nz * d[2])
    rx, ry, rz = d[0] - slope * nx, d[1] - slope * ny, d[2] - slope * nz
    lift = 0.003
    j, far, u, v = trace(mesh, px + lift * g[3], py + lift * g[4], pz + lift * g[5], rx, ry, rz, 200.0, False)
    if j < 0:
        return 0.0
    return min(radiance(mesh, j, t + far, u, v, rx, ry, rz, angle + rough), 6.0)


@compiled
def _render(
    mesh: Mesh,
    rays: FloatArray,
    pixel_rad: FloatArray,
    origins: FloatArray,
    rotations: FloatArray,
    grid: int,
    slack: float,
    rough: float,
    direct: Image,
    share: Image,
    mirror: Image,
) -> None:
    """Fill diffuse light, mirror share and mirrored light; pose of pixel row y is ``rotations[y]``, ``origins[y]``."""
    height, width = direct.shape
    side = TILE + 1
    seen, near = np.empty(MAX_SEEN, np.int64), np.empty(MAX_SEEN)
    d = np.empty((side * side, 3))
    ids = np.empty(side * side, np.int64)
    light, gloss, dist = np.empty(side * side), np.empty(side * side), np.empty(side * side)
    axis, rim, ray = np.empty(3), np.empty((4, 3)), np.empty(3)
    for top in range(0, height, TILE):
        rows = min(TILE, height - top)
        for left in range(0, width, TILE):
            columns = min(TILE, width - left)
            n = 0
            for y in range(rows + 1):
                R = rotations[min(top + y, height - 1)]
                for x in range(columns + 1):
                    d[n, 0], d[n, 1], d[n, 2] = _rotate(R, rays[top + y, left + x])
                    n += 1
            if not _tile_pyramid(d, n, slack, axis, rim):
                continue
            middle = origins[min(top + rows // 2, height - 1)]
            count = _tile_seen(mesh, middle, axis, rim, seen, near)
            for k in range(n):
                ids[k], light[k], gloss[k], dist[k] = -1, 0.0, 0.0, 0.0
                if d[k, 0] != d[k, 0]:
                    continue
                y, x = k // (columns + 1), k % (columns + 1)
                origin = origins[min(top + y, height - 1)]
                i, t, u, v = _nearest(mesh, origin, d[k, 0], d[k, 1], d[k, 2], seen, near, count)
                ids[k], dist[k] = i, t
                if i >= 0:
                    angle = pixel_rad[min(top + y, height - 1), min(left + x, width - 1)]
                    light[k] = radiance(mesh, i, t, u, v, d[k, 0], d[k, 1], d[k, 2], angle)
                    g = mesh.geometry[i]
                    cosine = -(g[3] * d[k, 0] + g[4] * d[k, 1] + g[5] * d[k, 2])
                    gloss[k] = mirror_share(mesh.surface[i, 2], cosine)
            for y in range(rows):
                origin = origins[top + y]
                for x in range(columns):
                    a = y * (columns + 1) + x
                    b, c = a + columns + 1, a + columns + 2
                    py, px = top + y, left + x
                    angle = pixel_rad[py, px]
                    if gloss[a] > 0.0:
                        key = py * width + px
                        mirror[py, px] = _mirrored(mesh, ids[a], dist[a], origin, d[a], angle, rough, key)
                    if ids[a] == ids[a + 1] and ids[a] == ids[b] and ids[a] == ids[c]:
                        direct[py, px] = 0.25 * (light[a] + light[a + 1] + light[b] + light[c])
                        share[py, px] = 0.25 * (gloss[a] + gloss[a + 1] + gloss[b] + gloss[c])
                        continue
                    total, total_share = 0.0, 0.0
                    for k in range(grid * grid):
                        fx, fy = (k % grid + 0.5) / grid, (k // grid + 0.5) / grid
                        for m in range(3):
                            upper = d[a, m] * (1.0 - fx) + d[a + 1, m] * fx
                            lower = d[b, m] * (1.0 - fx) + d[c, m] * fx
                            ray[m] = upper * (1.0 - fy) + lower * fy
                        if ray[0] != ray[0]:
                            continue
                        i, t, u, v = _nearest(mesh, origin, ray[0], ray[1], ray[2], seen, near, count)
                        if i >= 0:
                            total += radiance(mesh, i, t, u, v, ray[0], ray[1], ray[2], angle / grid)
                            g = mesh.geometry[i]
                            cosine = -(g[3] * ray[0] + g[4] * ray[1] + g[5] * ray[2])
                            total_share += mirror_share(mesh.surface[i, 2], cosine)
                    direct[py, px] = total / (grid * grid)
                    share[py, px] = total_share / (grid * grid)


def render_linear(
    mesh: Mesh, view: View, origins: FloatArray, rotations: FloatArray, grid: int = 4, roughness: float = 0.02
) -> Image:
    """Radiance (h, w) seen from a pose, or from one pose per pixel row (rolling shutter).

    Parameters
    ----------
    origins, rotations
        Camera centre (3,) or (h, 3), and R_world_body (3, 3) or (h, 3, 3); world z down, metres.
    grid
        Samples across a pixel where edges cross it.
    roughness
        Spread of the floor's normal, radians: how blurred its reflections are.
    """
    height, width = view.camera.height_px, view.camera.width_px
    rolling = origins.ndim == 2
    slack = 1e-6
    if rolling:  # a tile's rows see from slightly different places
        slack = 0.02 + 2 * TILE * float(np.abs(np.diff(rotations, axis=0)).max(initial=0.0))
    origins = np.ascontiguousarray(np.broadcast_to(origins, (height, 3)))
    rotations = np.ascontiguousarray(np.broadcast_to(rotations, (height, 3, 3)))
    direct, share, mirror = (np.zeros((height, width), np.float32) for _ in range(3))
    _render(
        mesh,
        view.corner_rays,
        view.pixel_rad,
        origins,
        rotations,
        grid,
        slack,
        roughness,
        direct,
        share,
        mirror,
    )
    if share.any():
        return direct + share * _spread(mirror, share > 0, height)
    return direct


def _spread(mirror: Image, where: npt.NDArray[np.bool_], height: int) -> Image:
    """Smooth mirrored light within the glossy region: the jitter of single rays becomes a soft reflection."""
    size = (max(3, round(height / 80) | 1), max(3, round(height / 40) | 1))
    mask = where.astype(np.float32)
    blurred = cv2.GaussianBlur(mirror * mask, size, 0)
    weight = cv2.GaussianBlur(mask, size, 0)
    return np.asarray(blurred / np.maximum(weight, 1e-3), np.float32)
