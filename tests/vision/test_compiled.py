"""Compiled loops work where nothing can be cached, and can be loaded beforehand."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numba
import pytest
from numba.core import event

from vision.compiled import _warn_of_missing_cache, compiled, compiled_inner


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

    _warn_of_missing_cache.cache_clear()

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


def test_an_inner_function_is_kept_within_its_callers_and_refuses_python() -> None:
    @compiled_inner
    def half(x: float) -> float:
        return 0.5 * x

    @compiled
    def quarter(x: float) -> float:
        return half(half(x))

    for _ in range(2):  # before it is compiled, and after
        with pytest.raises(TypeError, match="half is called by compiled functions only"):
            half(10.0)
        assert quarter(10.0) == 2.5


CALLEE = """
from vision.compiled import compiled, compiled_inner
SIZE = {size}
@compiled_inner
def part(x):
    return {factor} * x
@compiled
def whole(x):
    return part(x)
"""
CALLER = """
from callee import SIZE, part, whole
from vision.compiled import compiled
@compiled
def total(x):
    return part(x) + whole(x) + SIZE
print(total(1.0), sum(total.stats.cache_hits.values()))
"""


def test_what_is_kept_is_not_used_after_a_change_in_another_file(tmp_path: Path) -> None:
    """The caller's file stays the same, as after an update of the package; what it calls and uses does not."""
    (tmp_path / "caller.py").write_text(CALLER)

    def run(factor: float, size: float) -> list[str]:
        (tmp_path / "callee.py").write_text(CALLEE.format(factor=factor, size=size))
        environment = os.environ | {
            "NUMBA_CACHE_DIR": str(tmp_path / "kept"),
            "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = [sys.executable, "-c", "import caller"]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        return done.stdout.split()

    assert run(2.0, 10.0) == ["14.0", "0"]
    assert run(2.0, 10.0) == ["14.0", "1"]  # kept
    assert run(3.0, 10.0) == ["16.0", "0"]
    assert run(3.0, 20.0) == ["26.0", "0"]
    assert run(3.0, 20.0) == ["26.0", "1"]


@pytest.mark.parametrize("enabled", [True, False])
def test_the_garbage_collector_is_still_while_numba_compiles_and_then_as_before(enabled: bool) -> None:
    during = []

    class Look(event.Listener):
        def on_start(self, event: event.Event) -> None:
            during.append(gc.isenabled())

        def on_end(self, event: event.Event) -> None:
            pass

    was = gc.isenabled()
    try:
        gc.enable() if enabled else gc.disable()
        with cast(Any, event).install_listener("numba:run_pass", Look()):
            assert numba.njit(lambda x: x + 1.0)(1.0) == 2.0
            with pytest.raises(numba.TypingError):
                numba.njit(lambda x: x.no_such_thing)(1.0)
        assert gc.isenabled() is enabled
        assert set(during) == {False}
    finally:
        gc.enable() if was else gc.disable()


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
