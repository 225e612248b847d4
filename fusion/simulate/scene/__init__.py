"""The building: floor plan, walls, fittings and materials, from a `SceneConfig` to a lit mesh."""
