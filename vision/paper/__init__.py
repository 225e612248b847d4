"""The published article's own measurement, kept as printed: `method="paper"`."""
