"""Compile pixel loops with numba, caching on disk where the disk allows it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile ``function`` at its first call; keep the machine code on disk if any place is writable.

    A read-only installation without a writable cache folder makes numba refuse to cache: compile in memory then.
    """
    fastmath = {"contract", "arcp", "nsz"}  # but NaN and infinity keep their meaning
    try:
        return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=fastmath)(function))
    except RuntimeError:
        return cast(F, numba.njit(nogil=True, error_model="numpy", fastmath=fastmath)(function))
