"""Compile pixel loops with numba, caching on disk where the disk allows it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile ``function`` at its first call; keep the machine code on disk if any place is writable.

    A read-only installation without a writable cache folder makes numba refuse to cache: compile in memory then, and
    log once how to mend it.

    IEEE arithmetic, no fast maths: code that has just been compiled is inlined otherwise than code from the cache,
    and with contractions the two would differ in the last bits.
    """
    # Nobody calls it from C: without a wrapper for that it is compiled in less time.
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        return cast(F, numba.njit(cache=True, **options)(function))
    except RuntimeError:
        _say_that_nothing_is_kept()
        return cast(F, numba.njit(**options)(function))


@cache
def _say_that_nothing_is_kept() -> None:
    logging.getLogger("vision").warning(
        "every start compiles anew, for half a minute: no folder for compiled code is writable; "
        "set the environment variable NUMBA_CACHE_DIR to one that is"
    )
