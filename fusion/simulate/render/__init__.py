"""The renderer: meshes, their light, and pictures of them through any `vision.Camera`; compiled loops."""
