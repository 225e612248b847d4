"""Random numbers for scenes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fusion.simulate.scene.config import Surface


class Draw:
    """Random numbers under short names."""

    def __init__(self, seed: int, stream: int = 10) -> None:
        self.rng = np.random.default_rng((seed, stream))

    def chance(self, share: float) -> bool:
        """Return whether an event of this probability occurs."""
        return bool(self.rng.random() < share)

    def between(self, low: float, high: float) -> float:
        """Draw from a uniform distribution."""
        return float(self.rng.uniform(low, high))

    def scale(self, low: float, high: float) -> float:
        """Draw from a log-uniform distribution."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def count(self, low: int, high: int) -> int:
        """Draw an integer, both ends included."""
        return int(self.rng.integers(low, high + 1))

    def one_of(self, *values: Any, p: Sequence[float] | None = None) -> Any:
        """Draw one of the values, with these probabilities."""
        return values[int(self.rng.choice(len(values), p=p))]

    def albedo(self) -> float:
        """Draw a dark, medium or light albedo."""
        return float(self.one_of(self.between(0.03, 0.15), self.between(0.15, 0.5), self.between(0.5, 0.85)))

    def sides(self) -> tuple[Surface, ...]:
        """Draw both walls, or one of them."""
        choices = ((Surface.LEFT, Surface.RIGHT), (Surface.LEFT,), (Surface.RIGHT,))
        return choices[int(self.rng.choice(3, p=(0.5, 0.25, 0.25)))]
