"""Compile pixel loops with numba, caching on disk where the disk allows it."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

import numba
from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])

# IEEE arithmetic, no fast maths: code that has just been compiled is inlined otherwise than code from the cache,
# and with contractions the two would differ in the last bits. Nobody calls it from C: without a wrapper for that it
# is compiled in less time.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_INNER_OPTIONS = _OPTIONS | {"no_cpython_wrapper": True}


def compiled(function: F) -> F:
    """Compile ``function`` at its first call; keep the machine code on disk if any place is writable.

    A read-only installation without a writable cache folder makes numba refuse to cache: compile in memory then, and
    log once how to mend it.
    """
    try:
        return cast(F, numba.njit(cache=True, **_OPTIONS)(function))
    except RuntimeError:
        _say_that_nothing_is_kept()
        return cast(F, numba.njit(**_OPTIONS)(function))


def compiled_inner(function: F) -> F:
    """Compile a function that only compiled functions call; its machine code is kept within theirs.

    Python cannot call it: what takes Python's objects apart, and a file of its own, would take as long to make as
    the code of a small function.
    """
    return cast(F, _Inner(numba.njit(**_INNER_OPTIONS)(function)))


class _Inner:
    """Stands for a dispatcher where numba looks up a name. Called from Python, the dispatcher would crash."""

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher  # its type does not keep it
        self._numba_type_ = dispatcher._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        name = self._dispatcher.py_func.__qualname__
        raise TypeError(f"{name} is called by compiled functions only; decorate it with `compiled`")


@cache
def _say_that_nothing_is_kept() -> None:
    logging.getLogger("vision").warning(
        "every start compiles anew, for half a minute: no folder for compiled code is writable; "
        "set the environment variable NUMBA_CACHE_DIR to one that is"
    )


class _CollectorPaused(event.Listener):
    """Keeps the garbage collector still while numba compiles, in one thread at a time: it would find little."""

    def __init__(self) -> None:
        self._depth, self._was_enabled = 0, False

    def on_start(self, event: event.Event) -> None:
        """Pause with the outermost function; those that it calls are compiled within."""
        if self._depth == 0:
            self._was_enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """Go on as before."""
        self._depth -= 1
        if self._depth == 0 and self._was_enabled:
            gc.enable()


cast(Any, event).register("numba:compile", _CollectorPaused())  # has no types
