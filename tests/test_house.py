"""Rules that ruff and mypy do not check: who may import whom, and who may print."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.files import ROOT

MODULES = sorted([*(ROOT / "vision").rglob("*.py"), *(ROOT / "fusion").rglob("*.py")])
LINT = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()", "--no-cache"]


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_nothing_but_the_command_line_prints(path: Path) -> None:
    calls = [
        node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)
    ]
    prints = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"]
    assert len(prints) == (name_of(path) == "fusion.cli.console")


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("fusion/estimator/new.py", "from fusion.logs import load_flight"),
        ("fusion/estimator/new.py", "import matplotlib"),
        ("fusion/estimator/new.py", "def late() -> None:\n    import matplotlib"),
        ("vision/new.py", "from fusion.flight import Flight"),
        ("fusion/logs/new.py", "from fusion.estimator.state import Estimate"),
        ("fusion/evaluation/new.py", "from fusion import write_outputs"),
        ("fusion/new_room/__init__.py", ""),
    ],
)
def test_a_new_module_that_imports_what_lies_above_it_fails_the_lint(
    tmp_path: Path, module: str, line: str
) -> None:
    for package in ("fusion", "vision"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    new = tmp_path / module
    new.parent.mkdir(exist_ok=True)
    new.write_text(line + "\n")
    run = subprocess.run(LINT, cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 1, run.stdout + run.stderr
    assert module.removesuffix(".py").removesuffix("/__init__").replace("/", ".") in run.stdout
