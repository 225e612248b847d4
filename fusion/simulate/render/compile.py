"""Compilation of the pixel loops and the small functions that they call."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import numba

from vision.compiled import compiled

F = TypeVar("F", bound=Callable[..., Any])


def inner(function: F) -> F:
    """Compile a function that is called only by compiled functions and creates no arrays.

    numba counts the references of array arguments with atomic instructions, which cost more than testing a ray
    against a surface; without its memory manager it counts none. The code is cached on disk as part of the callers'.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
    return cast(F, numba.njit(function, fastmath={"contract", "arcp", "nsz"}, **options))


def outer(*modules: ModuleType) -> Callable[[F], F]:
    """Compile a function that Python calls, and cache the code on disk until it or one of the modules changes.

    numba itself checks only the function's own file, and would keep running old code of the inner functions.
    """

    def decorate(function: F) -> F:
        dispatcher = compiled(function)
        index: Any = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
        if hasattr(index, "_source_stamp"):
            files = [str(module.__file__) for module in modules]
            sources = b"".join(Path(file).read_bytes() for file in files if Path(file).exists())
            index._source_stamp = (index._source_stamp, hashlib.sha256(sources).hexdigest())
        return dispatcher

    return decorate
