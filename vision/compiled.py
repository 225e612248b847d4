"""Compile pixel loops with numba, caching on disk where the disk allows it."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from types import CodeType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])

# IEEE arithmetic, no fast maths: code that has just been compiled is inlined otherwise than code from the cache,
# and with contractions the two would differ in the last bits. Nobody calls it from C: without a wrapper for that it
# is compiled in less time.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_INNER_OPTIONS = _OPTIONS | {"no_cpython_wrapper": True}
_CONSTANTS = (int, float, str, np.generic, np.ndarray, np.dtype)


def compiled(function: F) -> F:
    """Compile ``function`` at its first call; keep the machine code on disk if any place is writable.

    What is kept is used only as long as the function, and all that it calls, are the same.

    A read-only installation without a writable cache folder makes numba refuse to cache: compile in memory then, and
    log once what to set.
    """
    try:
        dispatcher: Any = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        _say_that_nothing_is_kept()
        return cast(F, numba.njit(**_OPTIONS)(function))
    # Numba looks only whether the function's own file is the same; what it calls and is inlined may be in another.
    kept = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
    if kept is not None:  # it is not where numba is told to compile nothing
        kept._source_stamp = (getattr(kept, "_source_stamp", None), _source_of(function))
    return cast(F, dispatcher)


def _source_of(function: Callable[..., Any]) -> str:
    """Return a digest of a function's code, and of all compiled functions and constants that it uses."""
    digest = sha256()
    waiting: list[tuple[CodeType, dict[str, Any]]] = [(function.__code__, function.__globals__)]
    seen = set()
    while waiting:
        code, names = waiting.pop()
        if code in seen:
            continue
        seen.add(code)
        digest.update(code.co_code + repr((code.co_names, code.co_varnames)).encode())
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                waiting.append((constant, names))
            else:
                digest.update(repr(constant).encode())
        for name in code.co_names:
            value = names.get(name)
            callee = getattr(getattr(value, "_dispatcher", value), "py_func", None)
            if callee is not None:
                waiting.append((callee.__code__, callee.__globals__))
            elif isinstance(value, _CONSTANTS):
                digest.update(f"{name}={value!r}".encode())
            elif isinstance(value, type):
                digest.update(repr(getattr(value, "_fields", ())).encode())
    return digest.hexdigest()


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
        "every start compiles again, for up to a minute: no folder for compiled code is writable; "
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
