"""Compiled loops work where nothing can be cached, and can be loaded beforehand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

from vision.compiled import _say_that_nothing_is_kept, compiled


def test_without_any_place_for_a_cache_it_compiles_in_memory_and_says_once_how_to_mend_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    real, asked = numba.njit, []

    def nowhere_to_write(*args: Any, cache: bool = False, **options: Any) -> Any:
        asked.append(cache)
        if cache:
            raise RuntimeError("cannot cache function 'double': no locator available for file")
        return real(*args, **options)

    monkeypatch.setattr(numba, "njit", nowhere_to_write)

    _say_that_nothing_is_kept.cache_clear()

    @compiled
    def double(x: float) -> float:
        return 2.0 * x

    @compiled
    def triple(x: float) -> float:
        return 3.0 * x

    assert double(21.0) == 42.0
    assert triple(21.0) == 63.0
    (told,) = caplog.messages
    assert "set the environment variable NUMBA_CACHE_DIR" in told
    assert asked[:2] == [True, False]  # numba compiles helpers of its own with it later


WARM = """
import numba.core.event as event
from vision import Camera, measure_frame, warm_up
from vision.images import read_image
camera = Camera.from_fov(320, 240, 1.2)
warm_up(camera)
class Late(event.Listener):
    def on_start(self, event): print("late:", event.data.get("dispatcher"))
    def on_end(self, event): pass
picture = read_image({picture!r})[::2, ::2].copy()
with event.install_listener("numba:compile", Late()):
    m = measure_frame(picture, camera)
print(m.n_lines > 4)
"""


def test_warm_up_leaves_nothing_to_be_compiled_for_the_first_frame() -> None:
    picture = sorted((Path(__file__).parents[2] / "data" / "office" / "mav0" / "cam0" / "data").iterdir())[0]
    done = subprocess.run(
        [sys.executable, "-c", WARM.format(picture=str(picture))], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["True"]
