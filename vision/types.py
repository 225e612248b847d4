"""Named array types; the module imports only numpy.

Functions state the shape, unit and frame of each array in their docstrings.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
RecordArray = npt.NDArray[np.void]
"""Structured array; the function's docstring names its dtype, which documents the fields."""
Record = Any
"""One element of a `RecordArray` in compiled code; its fields are attributes."""
GreyImage = npt.NDArray[np.uint8]
"""Grey picture (h, w)."""
ColourImage = npt.NDArray[np.uint8]
"""Colour picture (h, w, 3), blue, green, red."""
