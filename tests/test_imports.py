"""Importing stays light: what a user does not use is not loaded."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys

import pytest

from tests.files import ROOT

HEAVY = {"numba", "cv2", "scipy", "filterpy", "matplotlib", "pandas", "jinja2", "ruamel", "IPython"}


def loaded_by(code: str) -> set[str]:
    """Top-level modules that a fresh interpreter holds after running the code."""
    report = "; import sys, json; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"
    run = subprocess.run([sys.executable, "-c", code + report], capture_output=True, text=True, check=True)
    return set(json.loads(run.stdout.splitlines()[-1]))


@pytest.mark.parametrize("package", ["vision", "fusion"])
def test_a_package_imports_without_the_heavy_ones(package: str) -> None:
    loaded = loaded_by(f"import {package}")
    assert package in loaded
    assert loaded & HEAVY == set()


@pytest.mark.parametrize("arguments", [["--help"], ["fuse", "--help"], ["measure", "--help"], ["--version"]])
def test_help_comes_without_the_heavy_ones(arguments: list[str]) -> None:
    code = (
        f"import sys; sys.argv = ['corridor', *{arguments!r}]\n"
        "from fusion.cli.app import main\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert not end.code\n"
    )
    loaded = loaded_by(code + "0")
    assert "typer" in loaded
    assert loaded & HEAVY == set()


def test_the_version_is_in_one_place() -> None:
    import fusion

    text = (ROOT / "pyproject.toml").read_text()
    assert f'version = "{fusion.__version__}"' in text


def test_nothing_is_loaded_before_interrupts_are_handled() -> None:
    """Each import before that is time in which Ctrl-C ends in a traceback."""
    code = (
        "import json, signal, sys; before = set(sys.modules); from fusion.__main__ import main; "
        "print(json.dumps(sorted(set(sys.modules) - before)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    ours = {"fusion", "fusion.__main__", "fusion.cli", "fusion.cli.interrupts"}
    assert set(json.loads(run.stdout)) - {"__future__"} == ours


LOOKED_AT = "from fusion import CorridorEstimator; CorridorEstimator().ekf"
FLOWN = """
import numpy as np
from fusion import CorridorEstimator
from vision import Camera, warm_up
camera = Camera.from_fov(160, 120, 1.2)
warm_up(camera)
estimator = CorridorEstimator(camera=camera)
for k in range(200):
    estimator.add_imu(5_000_000 * k, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
    estimator.add_attitude(5_000_000 * k, (1.0, 0.0, 0.0, 0.0))
    if k % 20 == 0:
        estimator.add_frame(5_000_000 * k, np.zeros((120, 160), np.uint8))
estimator.estimate()
"""


def test_an_estimator_in_flight_needs_neither_filterpy_nor_what_it_loads() -> None:
    """They take a sixth of the memory that it holds. ``scipy.linalg`` is loaded by numba."""
    parts = (
        "assert not sys.modules.keys() & {'scipy.stats', 'scipy.ndimage', 'scipy.optimize', 'scipy.spatial'}"
    )
    loaded = loaded_by(f"{FLOWN}\nimport sys; {parts}")
    assert "numba" in loaded
    assert loaded & (HEAVY - {"numba", "cv2", "scipy"}) == set()
    assert "filterpy" in loaded_by(LOOKED_AT)


def test_loading_what_fuses_a_flight_does_not_load_what_aligns_sensors() -> None:
    """Each worker of a fleet would load it: half a second of its processor."""
    code = "from fusion import fuse_flight, load_flight, write_outputs; import sys"
    loaded_by(f"{code}; assert not {{'scipy.optimize', 'scipy.interpolate'}} & sys.modules.keys()")


@pytest.mark.parametrize("name", ["measure_frame", "measure_lines", "extract_lines"])
def test_the_compiled_line_finder_loads_at_its_first_use(name: str) -> None:
    assert "numba" in loaded_by(f"import vision; vision.{name}")


def test_vision_alone_never_loads_fusion() -> None:
    assert "fusion" not in loaded_by(
        "import vision, vision.frame, vision.paper.measure, vision.overlay, vision.images"
    )


@pytest.mark.parametrize("package", ["vision", "fusion"])
def test_every_name_that_a_package_offers_is_there(package: str) -> None:
    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name).__name__ == name


@pytest.mark.parametrize("package", ["vision", "fusion"])
def test_a_package_offers_what_the_reference_lists(package: str) -> None:
    section = (ROOT / "docs" / "api.md").read_text().split(f"\n## {package}\n")[1].split("\n## ")[0]
    listed = re.findall(r"^::: .*\.(\w+)$", section, re.MULTILINE)
    assert listed
    assert set(listed) <= set(importlib.import_module(package).__all__)


def test_the_command_runs_as_a_module() -> None:
    run = subprocess.run([sys.executable, "-m", "fusion", "--help"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split()[:2] == ["Usage:", "corridor"]
