"""The rules of the house that no linter knows: who may import whom, and how long a module may be."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
MODULES = sorted([*(ROOT / "vision").rglob("*.py"), *(ROOT / "fusion").rglob("*.py")])
ESTIMATOR = sorted((ROOT / "fusion" / "estimator").glob("*.py"))
MAX_LINES = 400


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imports_of(path: Path) -> set[str]:
    """Every module that a file imports, wherever in it, as a dotted name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = name_of(path).split(".")
            above = package[: len(package) - node.level + (path.name == "__init__.py")] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    return found


def test_the_modules_are_found() -> None:
    names = {name_of(path) for path in MODULES}
    assert {"vision", "vision.frame", "fusion", "fusion.cli.app"} <= names
    assert "fusion.estimator.engine" in names


@pytest.mark.parametrize("path", [p for p in MODULES if name_of(p).startswith("vision")], ids=name_of)
def test_vision_never_imports_fusion(path: Path) -> None:
    assert not {name for name in imports_of(path) if name.split(".")[0] == "fusion"}


@pytest.mark.parametrize("path", ESTIMATOR, ids=name_of)
def test_the_estimator_knows_no_logs_reports_or_command_line(path: Path) -> None:
    forbidden = {
        *(
            f"fusion.{name}"
            for name in ("logs", "report", "cli", "progress", "outputs", "simulate", "offline", "summary")
        ),
        *("matplotlib", "typer", "rich", "jinja2", "ruamel", "pandas"),
    }
    imported = imports_of(path)
    assert not {name for name in imported if any(name == f or name.startswith(f + ".") for f in forbidden)}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_can_be_read_in_one_sitting(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MAX_LINES


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_nothing_but_the_command_line_prints(path: Path) -> None:
    if name_of(path) in ("fusion.progress", "fusion.cli.app"):
        pytest.skip("the command line's own voice")
    calls = [
        node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)
    ]
    assert not [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"]
