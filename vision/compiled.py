"""Decorators that compile functions with numba and cache the machine code on disk.

`compiled` is for functions called from Python, `compiled_inner` for those called only from compiled code. The disk
cache of a function is keyed by a digest of its bytecode and of every compiled function and constant it uses, because
numba itself checks only the function's own file.
"""

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

# IEEE arithmetic, no fast maths: freshly compiled code is inlined differently from cached code, and with contractions
# the two would differ in the last bits. No C wrapper: nothing calls it from C, and compiling it takes time.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_INNER_OPTIONS = _OPTIONS | {"no_cpython_wrapper": True}
_CONSTANTS = (int, float, str, np.generic, np.ndarray, np.dtype)


def compiled(function: F) -> F:
    """Compile ``function`` at its first call, and cache the machine code on disk where a folder is writable.

    The cache is valid as long as the function and everything it calls are unchanged. In a read-only installation
    without a writable cache folder numba refuses to cache: the code is then compiled in memory, and one log message
    names the setting.
    """
    try:
        dispatcher: Any = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        _warn_of_missing_cache()
        return cast(F, numba.njit(**_OPTIONS)(function))
    # Numba checks only the function's own file; inlined callees may be in others.
    cache_file = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
    if cache_file is not None:  # None where NUMBA_DISABLE_JIT is set
        cache_file._source_stamp = (getattr(cache_file, "_source_stamp", None), _source_digest(function))
    return cast(F, dispatcher)


def _source_digest(function: Callable[..., Any]) -> str:
    """Return a digest of a function's bytecode and of all compiled functions and constants that it uses."""
    digest = sha256()
    stack: list[tuple[CodeType, dict[str, Any]]] = [(function.__code__, function.__globals__)]
    seen = set()
    while stack:
        code, names = stack.pop()
        if code in seen:
            continue
        seen.add(code)
        digest.update(code.co_code + repr((code.co_names, code.co_varnames)).encode())
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                stack.append((constant, names))
            else:
                digest.update(repr(constant).encode())
        for name in code.co_names:
            value = names.get(name)
            callee = getattr(getattr(value, "_dispatcher", value), "py_func", None)
            if callee is not None:
                stack.append((callee.__code__, callee.__globals__))
            elif isinstance(value, _CONSTANTS):
                digest.update(f"{name}={value!r}".encode())
            elif isinstance(value, type):
                digest.update(repr(getattr(value, "_fields", ())).encode())
    return digest.hexdigest()


def compiled_inner(function: F) -> F:
    """Compile a function that only compiled functions call; its machine code is cached as part of theirs.

    Python cannot call it. This saves the wrapper that unpacks Python objects and a cache file, which would take as
    long to create as the code of a small function.
    """
    return cast(F, _Inner(numba.njit(**_INNER_OPTIONS)(function)))


class _Inner:
    """Proxy of a dispatcher for numba's name lookup; called from Python, the dispatcher itself would crash."""

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher  # keeps it alive: its numba type holds no reference
        self._numba_type_ = dispatcher._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        name = self._dispatcher.py_func.__qualname__
        raise TypeError(f"{name} is called by compiled functions only; decorate it with `compiled`")


@cache
def _warn_of_missing_cache() -> None:
    logging.getLogger("vision").warning(
        "every start compiles again, for up to a minute: no folder for compiled code is writable; "
        "set the environment variable NUMBA_CACHE_DIR to one that is"
    )


class _CollectorPaused(event.Listener):
    """Pauses the garbage collector while numba compiles (one thread at a time): it would find little to free."""

    def __init__(self) -> None:
        self._depth, self._was_enabled = 0, False

    def on_start(self, event: event.Event) -> None:
        """Pause at the outermost function; its callees are compiled within."""
        if self._depth == 0:
            self._was_enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """Restore the collector after the outermost function."""
        self._depth -= 1
        if self._depth == 0 and self._was_enabled:
            gc.enable()


cast(Any, event).register("numba:compile", _CollectorPaused())  # has no types
