"""Light of a scene, computed once: soft shadows from every lamp and one gathered bounce, kept per surface cell.

Emission is radiance; a cell's value is irradiance over pi, so that albedo times it is the radiance seen.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fusion.simulate.kernels import irradiance, scatter, trace
from fusion.simulate.mesh import Mesh
from vision.compiled import compiled

FloatArray = npt.NDArray[np.float64]
LIFT_M = 0.004  # rays start this far off their surface
LAMP_REACH_M = 9.0


@compiled
def _direct(
    mesh: Mesh, lamps: npt.NDArray[np.int64], px: float, py: float, pz: float, i: int, key: int
) -> float:
    """Light from the lamps onto a point of surface i, four shadow rays to each lamp in reach."""
    g = mesh.geometry
    total = 0.0
    nx, ny, nz = g[i, 3], g[i, 4], g[i, 5]
    for lamp in lamps:
        la, lb = g[lamp, 12], g[lamp, 13]
        area = la * lb
        cx = mesh.corners[lamp, 0, 0] + mesh.corners[lamp, 2, 0] - 2.0 * px
        cy = mesh.corners[lamp, 0, 1] + mesh.corners[lamp, 2, 1] - 2.0 * py
        reach = LAMP_REACH_M + np.sqrt(area) * 4.0
        if lamp == i or cx * cx + cy * cy > 4.0 * reach * reach:
            continue
        for k in range(4):
            fu = (k % 2 + scatter(key, lamp, 2 * k)) * 0.5
            fv = (k // 2 + scatter(key, lamp, 2 * k + 1)) * 0.5
            c = mesh.corners[lamp]
            x = c[0, 0] + fu * (c[1, 0] - c[0, 0]) + fv * (c[3, 0] - c[0, 0]) - px
            y = c[0, 1] + fu * (c[1, 1] - c[0, 1]) + fv * (c[3, 1] - c[0, 1]) - py
            z = c[0, 2] + fu * (c[1, 2] - c[0, 2]) + fv * (c[3, 2] - c[0, 2]) - pz
            d2 = x * x + y * y + z * z
            d = np.sqrt(d2)
            cos_here = (nx * x + ny * y + nz * z) / d
            cos_lamp = -(g[lamp, 3] * x + g[lamp, 4] * y + g[lamp, 5] * z) / d
            if cos_here <= 0.0 or cos_lamp <= 0.0:
                continue
            blocker, _, _, _ = trace(mesh, px, py, pz, x / d, y / d, z / d, d - 0.02, True)
            if blocker >= 0:
                continue
            weight = cos_here * cos_lamp / max(d2, 0.02)
            total += 0.25 * mesh.surface[lamp, 1] * mesh.surface[lamp, 0] * area * weight / np.pi
    return total


@compiled
def _gathered(mesh: Mesh, px: float, py: float, pz: float, i: int, key: int, rays: int) -> float:
    """Light reflected onto a point by what it sees: mean over cosine-weighted rays of albedo times light."""
    nx, ny, nz = mesh.geometry[i, 3], mesh.geometry[i, 4], mesh.geometry[i, 5]
    if abs(nx) < 0.7:
        ax, ay, az = 0.0, nz, -ny
    else:
        ax, ay, az = -nz, 0.0, nx
    size = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / size, ay / size, az / size
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    turn = scatter(key, i, 77)
    total = 0.0
    for k in range(rays):
        radius = np.sqrt((k + 0.5) / rays)
        phi = 2.0 * np.pi * (k * 0.6180339887498949 + turn)
        x, y = radius * np.cos(phi), radius * np.sin(phi)
        z = np.sqrt(max(0.0, 1.0 - radius * radius))
        dx, dy, dz = x * ax + y * bx + z * nx, x * ay + y * by + z * ny, x * az + y * bz + z * nz
        j, _, u, v = trace(mesh, px, py, pz, dx, dy, dz, 60.0, False)
        if j >= 0 and mesh.surface[j, 1] <= 0.0:
            total += mesh.surface[j, 0] * irradiance(mesh, j, u, v)
    return total / rays


@compiled
def _fill(mesh: Mesh, lamps: npt.NDArray[np.int64], out: npt.NDArray[np.float32], rays: int) -> None:
    """Compute every cell's light: from the lamps (rays 0), or gathered from ``mesh.lightmap``."""
    for i in range(mesh.geometry.shape[0]):
        start, nu, nv = mesh.light_index[i]
        c = mesh.corners[i]
        g = mesh.geometry[i]
        for jv in range(nv):
            for ju in range(nu):
                fu, fv = (ju + 0.5) / nu, (jv + 0.5) / nv
                px = c[0, 0] + fu * (c[1, 0] - c[0, 0]) + fv * (c[3, 0] - c[0, 0]) + LIFT_M * g[3]
                py = c[0, 1] + fu * (c[1, 1] - c[0, 1]) + fv * (c[3, 1] - c[0, 1]) + LIFT_M * g[4]
                pz = c[0, 2] + fu * (c[1, 2] - c[0, 2]) + fv * (c[3, 2] - c[0, 2]) + LIFT_M * g[5]
                cell = start + jv * nu + ju
                if rays == 0:
                    out[cell] = _direct(mesh, lamps, px, py, pz, i, cell)
                else:
                    out[cell] = _gathered(mesh, px, py, pz, i, cell, rays)


@compiled
def _smooth(light_index: npt.NDArray[np.int64], light: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Average each cell with its neighbours on the same surface (binomial 3x3)."""
    out = np.empty_like(light)
    for i in range(light_index.shape[0]):
        start, nu, nv = light_index[i]
        for jv in range(nv):
            for ju in range(nu):
                total, weight = 0.0, 0.0
                for dv in range(-1, 2):
                    for du in range(-1, 2):
                        a, b = ju + du, jv + dv
                        if 0 <= a < nu and 0 <= b < nv:
                            w = (2.0 - abs(du)) * (2.0 - abs(dv))
                            total += w * light[start + b * nu + a]
                            weight += w
                out[start + jv * nu + ju] = total / weight
    return out


def bake(mesh: Mesh, rays: int = 24, ambient: float = 0.02) -> Mesh:
    """Return the mesh with its light computed; later bounces are estimated from the first one's mean share."""
    lamps = np.flatnonzero(mesh.surface[:, 1] > 0).astype(np.int64)
    direct = np.empty_like(mesh.lightmap)
    _fill(mesh, lamps, direct, 0)
    bounce = np.empty_like(direct)
    _fill(mesh._replace(lightmap=direct), lamps, bounce, rays)
    bounce = _smooth(mesh.light_index, bounce)
    share = float(np.clip(bounce.mean() / max(float(direct.mean()), 1e-9), 0.0, 0.8))
    return mesh._replace(lightmap=(direct + bounce / (1 - share) + ambient).astype(np.float32))
