"""Compiled loops work where nothing can be cached."""

from __future__ import annotations

from typing import Any

import numba
import pytest

from vision.compiled import compiled


def test_without_any_place_for_a_cache_it_compiles_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    real, asked = numba.njit, []

    def nowhere_to_write(*args: Any, cache: bool = False, **options: Any) -> Any:
        asked.append(cache)
        if cache:
            raise RuntimeError("cannot cache function 'double': no locator available for file")
        return real(*args, **options)

    monkeypatch.setattr(numba, "njit", nowhere_to_write)

    @compiled
    def double(x: float) -> float:
        return 2.0 * x

    assert double(21.0) == 42.0
    assert asked[:2] == [True, False]  # numba compiles helpers of its own with it later
