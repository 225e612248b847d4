"""The notebooks run from top to bottom, started from the repository's root or from their own folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.files import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

nbformat = pytest.importorskip("nbformat", reason="nbformat comes with the dev extra")
nbclient = pytest.importorskip("nbclient", reason="nbclient comes with the dev extra")


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def text_of(cell: Any) -> str:
    return "".join(output.get("text", "") for output in cell.get("outputs", []))


def pictures_of(cell: Any) -> list[Any]:
    return [output for output in cell.get("outputs", []) if "image/png" in output.get("data", {})]


def test_there_is_a_quickstart() -> None:
    assert "quickstart.ipynb" in [path.name for path in NOTEBOOKS]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: str(path.name))
def test_a_notebook_is_kept_without_outputs(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)


def test_the_quickstart_runs_and_shows_what_it_promises() -> None:
    notebook = read(ROOT / "notebooks" / "quickstart.ipynb")
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(ROOT)}}
    ).execute()
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    told = "\n".join(text_of(cell) for cell in code)
    assert "frames used" in told
    assert "pass        Heading against truth" in told
    for name in ("filter", "smoother", "frames alone", "paper, filter"):
        assert f"\n{name} " in told
    assert sum(len(pictures_of(cell)) for cell in code) == 3
