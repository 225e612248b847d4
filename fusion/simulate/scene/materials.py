"""Materials of walls, floors and ceilings."""

from __future__ import annotations

from fusion.simulate.render.mesh import Material
from fusion.simulate.scene.config import Ceiling, Floor, SceneConfig, WallConfig, WallFinish

TEXTURE_BRICKS = 4, 8  # bricks along and courses up in one repetition of the texture
TILE_M = {Floor.TILES: 0.6, Floor.TERRAZZO: 1.2, Floor.CARPET_TILES: 0.5, Floor.PLANKS: 0.15}


def wall_material(
    wall: WallConfig, finish: WallFinish, albedo: float, origin_m: tuple[float, float] = (0.0, 0.0)
) -> Material:
    """Return a wall's material; its pattern begins at ``origin_m`` along the wall and above the floor."""
    long, high = wall.brick_m
    if finish in (WallFinish.BRICK, WallFinish.BLOCKS):
        size, contrast = (TEXTURE_BRICKS[0] * long, TEXTURE_BRICKS[1] * high), wall.brick_contrast
        if finish is WallFinish.BLOCKS:
            return Material(albedo, "blocks", size, contrast, origin_m=origin_m)
        name = "brick" if contrast >= 0 else "brick_light_mortar"
        return Material(albedo * 0.8, name, size, abs(contrast), origin_m=origin_m)
    if finish is WallFinish.TILES:
        joint = albedo * min(1.5, min(1.5, max(0.0, 1 - 0.5 * wall.brick_contrast)))
        return Material(
            albedo, "vinyl", (1.3, 1.3), 0.3, wall.brick_m, 0.004, joint, 0.0, wall.gloss, 0.008, 0.0, origin_m
        )  # fmt: skip
    if finish is WallFinish.PANELS:
        return Material(albedo, "plaster", (1.5, 1.5), 1.0, (1.2, 0.0), 0.008, 0.15)
    return Material(albedo, "plaster", (1.7, 1.7), 1.0)


def floor_material(config: SceneConfig) -> Material:
    """Return the floor's material."""
    material = _floor_covering(config).but(joint_turn_rad=config.floor_turn_rad)
    return material if config.floor_joint_m is None else material.but(joint_width_m=config.floor_joint_m)


def _floor_covering(config: SceneConfig) -> Material:
    albedo, gloss, rough = config.floor_albedo, config.floor_gloss, config.floor_roughness_rad
    kind, start = config.floor, config.floor_tile_start_m
    origin = start if any(start) else None
    side = config.floor_tile_m or TILE_M.get(kind, 0.0)
    joint = albedo * config.floor_joint_ratio
    if kind is Floor.TILES:
        return Material(
            albedo, "vinyl", (2.1, 2.1), 0.8, (side, side), 0.006, joint, 0.0, gloss, rough, 0.0, origin
        )
    if kind is Floor.TERRAZZO:
        joint *= 0.5 / 0.45
        return Material(
            albedo, "speckle", (0.8, 0.8), 1.0, (side, side), 0.004, joint, 0.0, gloss, rough, 0.0, origin
        )
    if kind is Floor.CARPET:
        return Material(albedo * 0.6, "carpet", (0.7, 0.7), 1.0)
    if kind is Floor.CARPET_TILES:
        return Material(
            albedo * 0.6, "carpet", (0.7, 0.7), 1.0, (side, side), 0.004, albedo * 0.4, origin_m=origin
        )
    if kind is Floor.PLANKS:
        return Material(
            albedo, "vinyl", (2.1, 2.1), 0.8, (0.0, side), 0.004, joint, 0.0, gloss, rough, 0.0, origin
        )
    return Material(albedo, "vinyl", (2.3, 2.3), 1.0, (0.0, 2.0), 0.004, albedo * 0.6, 0.0, gloss, rough)


def ceiling_material(config: SceneConfig) -> Material:
    """Return the ceiling's material."""
    albedo = config.ceiling_albedo
    if config.ceiling is Ceiling.BOARDS:
        return Material(albedo, "ceiling_board", (0.6, 0.6), 1.0, (0.6, 0.6), 0.02, albedo * 0.8)
    if config.ceiling is Ceiling.OPEN:
        return Material(albedo * 0.35, "vinyl", (1.5, 1.5), 2.0)
    return Material(albedo, "plaster", (2.0, 2.0), 0.6)
