"""Types of arrays, by name; importing it costs nothing but numpy.

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
"""Structured array; its dtype, which names and explains the fields, stands in the function's docstring."""
Record = Any
"""One element of a `RecordArray` as compiled code takes it, with its fields as attributes."""
GreyImage = npt.NDArray[np.uint8]
"""Grey picture (h, w)."""
ColourImage = npt.NDArray[np.uint8]
"""Colour picture (h, w, 3), blue, green, red."""
