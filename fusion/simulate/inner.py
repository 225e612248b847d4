"""Compile the small functions that the pixel loops call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def inner(function: F) -> F:
    """Compile a function that only compiled functions call, and that makes no arrays.

    numba counts the references of array arguments with atomic instructions, which cost more than the work in a
    ray's test against a surface; without its memory manager there is nothing to count. The code is kept on disk
    within the callers'.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
    return cast(F, numba.njit(function, fastmath={"contract", "arcp", "nsz"}, **options))
