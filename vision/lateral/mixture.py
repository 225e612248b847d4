"""What one frame says about the lateral offset, as a sum of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class OffsetMixture:
    """What one frame says about the scale-free lateral offset: Gaussians, and a share that says "cannot tell".

    The likelihood of the offset y in (-1, 1) is ``(1 - sum(weight)) / 2 + sum_j weight_j N(offset_norm_j; y,
    std_norm_j^2)``.

    Parameters
    ----------
    weight
        (k,), not negative, their sum at most 1; what is left over is the probability that the frame cannot tell.
    offset_norm, std_norm
        (k,) means and standard deviations.
    width_per_height
        (k,) corridor width over camera height above the floor; NaN where the component does not tell.
    """

    weight: FloatArray
    offset_norm: FloatArray
    std_norm: FloatArray
    width_per_height: FloatArray
