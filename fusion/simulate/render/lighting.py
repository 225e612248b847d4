"""Light of a scene, computed once per surface cell: soft shadows of every lamp and a gathered bounce.

Emission is radiance; a cell's value is irradiance over pi, so that albedo times it is the radiance seen.
"""

from __future__ import annotations

import numpy as np

from fusion.simulate.render import kernels
from fusion.simulate.render import mesh as layout
from fusion.simulate.render.compile import inner, outer
from fusion.simulate.render.kernels import (
    LIFT_M,
    FloatArray,
    Indices,
    Light,
    dot,
    irradiance,
    scatter,
    sunlight,
    trace,
)
from fusion.simulate.render.mesh import (
    ALBEDO,
    EMISSION,
    LENGTH_A,
    LENGTH_B,
    LIGHT_NU,
    LIGHT_NV,
    LIGHT_START,
    NORMAL,
    POINTS,
    SUN_LIGHT,
    Mesh,
)

LAMP_REACH_M = 9.0
SUN_GRAIN_M = 0.1  # resolution of a patch of sun for the bounced light


@inner
def _direct(
    table: FloatArray, nodes: FloatArray, lamps: Indices, px: float, py: float, pz: float, i: int, key: int
) -> float:
    """Light from the lamps onto a point of surface i, four shadow rays to each lamp in reach."""
    total = 0.0
    for lamp in lamps:
        area = table[lamp, LENGTH_A] * table[lamp, LENGTH_B]
        a, b, c = POINTS, POINTS + 3, POINTS + 9  # the corner and its two neighbours
        cx = table[lamp, POINTS] + table[lamp, POINTS + 6] - 2.0 * px
        cy = table[lamp, POINTS + 1] + table[lamp, POINTS + 7] - 2.0 * py
        reach = LAMP_REACH_M + 4.0 * np.sqrt(area)
        if lamp == i or cx * cx + cy * cy > 4.0 * reach * reach:
            continue
        for k in range(4):
            fu = (k % 2 + scatter(key, lamp, 2 * k)) * 0.5
            fv = (k // 2 + scatter(key, lamp, 2 * k + 1)) * 0.5
            f0 = 1.0 - fu - fv
            x = f0 * table[lamp, a] + fu * table[lamp, b] + fv * table[lamp, c] - px
            y = f0 * table[lamp, a + 1] + fu * table[lamp, b + 1] + fv * table[lamp, c + 1] - py
            z = f0 * table[lamp, a + 2] + fu * table[lamp, b + 2] + fv * table[lamp, c + 2] - pz
            d2 = x * x + y * y + z * z
            d = np.sqrt(d2)
            cos_here = dot(table, i, NORMAL, x, y, z) / d
            cos_lamp = -dot(table, lamp, NORMAL, x, y, z) / d
            if cos_here <= 0.0 or cos_lamp <= 0.0:
                continue
            blocker, _, _, _ = trace(table, nodes, px, py, pz, x / d, y / d, z / d, d - 0.02, True)
            if blocker < 0:
                weight = cos_here * cos_lamp / max(d2, 0.02)
                total += 0.25 * table[lamp, EMISSION] * table[lamp, ALBEDO] * area * weight / np.pi
    return total


@inner
def _gathered(
    table: FloatArray,
    nodes: FloatArray,
    light: Light,
    sun: FloatArray,
    px: float,
    py: float,
    pz: float,
    i: int,
    key: int,
    rays: int,
) -> float:
    """Light reflected onto a point: mean over cosine-weighted rays of albedo times light."""
    nx, ny, nz = table[i, NORMAL], table[i, NORMAL + 1], table[i, NORMAL + 2]
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
        j, far, u, v = trace(table, nodes, px, py, pz, dx, dy, dz, 60.0, False)
        if j >= 0 and table[j, EMISSION] <= 0.0:
            seen = irradiance(table, light, j, u, v)
            if sun[SUN_LIGHT] > 0.0:
                x, y, z = px + far * dx, py + far * dy, pz + far * dz
                seen += sunlight(table, nodes, sun, j, x, y, z, SUN_GRAIN_M)
            total += table[j, ALBEDO] * seen
    return total / rays


@outer(kernels, layout)
def _fill(
    table: FloatArray, nodes: FloatArray, lamps: Indices, light: Light, sun: FloatArray, out: Light, rays: int
) -> None:
    """Compute every cell's light: from the lamps (rays 0), or gathered from ``light``."""
    a, b, c = POINTS, POINTS + 3, POINTS + 9
    for i in range(table.shape[0]):
        start = int(table[i, LIGHT_START])
        nu, nv = int(table[i, LIGHT_NU]), int(table[i, LIGHT_NV])
        for cell in range(nu * nv):
            fu, fv = (cell % nu + 0.5) / nu, (cell // nu + 0.5) / nv
            f0 = 1.0 - fu - fv
            px = f0 * table[i, a] + fu * table[i, b] + fv * table[i, c] + LIFT_M * table[i, NORMAL]
            py = (
                f0 * table[i, a + 1]
                + fu * table[i, b + 1]
                + fv * table[i, c + 1]
                + LIFT_M * table[i, NORMAL + 1]
            )
            pz = (
                f0 * table[i, a + 2]
                + fu * table[i, b + 2]
                + fv * table[i, c + 2]
                + LIFT_M * table[i, NORMAL + 2]
            )
            key = start + cell
            if rays == 0:
                out[key] = _direct(table, nodes, lamps, px, py, pz, i, key)
            else:
                out[key] = _gathered(table, nodes, light, sun, px, py, pz, i, key, rays)


@outer(kernels, layout)
def _smooth(table: FloatArray, light: Light) -> Light:
    """Average each cell with its neighbours on the same surface (binomial 3x3)."""
    out = np.empty_like(light)
    for i in range(table.shape[0]):
        start = int(table[i, LIGHT_START])
        nu, nv = int(table[i, LIGHT_NU]), int(table[i, LIGHT_NV])
        for cell in range(nu * nv):
            total, weight = 0.0, 0.0
            for k in range(9):
                du, dv = k % 3 - 1, k // 3 - 1
                a, b = cell % nu + du, cell // nu + dv
                if 0 <= a < nu and 0 <= b < nv:
                    w = (2.0 - abs(du)) * (2.0 - abs(dv))
                    total += w * light[start + b * nu + a]
                    weight += w
            out[start + cell] = total / weight
    return out


def bake(mesh: Mesh, ambient: float, rays: int = 24) -> Mesh:
    """Return the mesh with its light computed.

    Bounces after the first are estimated from the share that one bounce adds.
    """
    table, nodes = mesh.table, mesh.nodes
    lamps = np.flatnonzero(table[:, EMISSION] > 0).astype(np.int64)
    direct, bounce = np.empty_like(mesh.lightmap), np.empty_like(mesh.lightmap)
    _fill(table, nodes, lamps, direct, mesh.sun, direct, 0)
    _fill(table, nodes, lamps, direct, mesh.sun, bounce, rays)
    bounce = _smooth(table, bounce)
    before, after = direct, bounce
    if (
        mesh.sun[SUN_LIGHT] > 0
    ):  # no cell has the sun's direct light: compare the second bounce with the first
        before, after = bounce, np.empty_like(bounce)
        _fill(table, nodes, lamps, bounce, np.zeros_like(mesh.sun), after, rays // 3)
    share = float(np.clip(after.mean() / max(float(before.mean()), 1e-9), 0.0, 0.8))
    return mesh._replace(lightmap=(direct + bounce / (1 - share) + ambient).astype(np.float32))
