"""The notebooks run from top to bottom, and what they keep is what they print."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tests.files import ROOT

NOTEBOOKS = {path.stem: path for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
MAX_BYTES = 1_500_000
MAX_SECONDS = 1500  # of a cell, against one that never ends

nbformat = pytest.importorskip("nbformat", reason="nbformat comes with the dev extra")
nbclient = pytest.importorskip("nbclient", reason="nbclient comes with the dev extra")
each_notebook = pytest.mark.parametrize("name", NOTEBOOKS)


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def text_of(notebook: Any) -> str:
    """All that the cells print or show as text."""
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    return "\n".join(o.get("text", "") + o.get("data", {}).get("text/plain", "") for o in outputs)


def pictures_of(notebook: Any) -> int:
    return sum(
        "image/png" in output.get("data", {}) for cell in code_cells(notebook) for output in cell.outputs
    )


def test_the_notebooks_that_the_readme_promises_are_there() -> None:
    promised = {"quickstart", "one_frame", "a_flight", "article", "consistency", "controller", "phone"}
    assert set(NOTEBOOKS) == promised


@each_notebook
def test_outputs_are_kept_and_free_of_what_is_private(name: str) -> None:
    path = NOTEBOOKS[name]
    notebook = read(path)
    nbformat.validate(notebook)
    assert path.stat().st_size < MAX_BYTES
    assert [cell.execution_count for cell in code_cells(notebook)] == list(
        range(1, len(code_cells(notebook)) + 1)
    )
    kinds = {output.output_type for cell in code_cells(notebook) for output in cell.outputs}
    assert "error" not in kinds
    assert not re.search(r"/(root|home|tmp|work|Users)/|Warning", text_of(notebook))


@each_notebook
def test_every_figure_states_its_finding_and_every_axis_its_unit(name: str) -> None:
    for cell in code_cells(read(NOTEBOOKS[name])):
        if "plt.show()" in cell.source:
            assert re.search(r"title=|set_title|suptitle", cell.source), cell.source
            assert "xlabel" in cell.source or 'axis("off")' in cell.source, cell.source


@each_notebook
def test_numbers_in_the_text_are_those_that_the_cells_print(name: str) -> None:
    """Numbers with a decimal point; those of the code itself (what was set) count too."""
    notebook = read(NOTEBOOKS[name])
    known = text_of(notebook) + "".join(cell.source for cell in code_cells(notebook))
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            for number in re.findall(r"(?<![\w.])\d+\.\d+(?![\w.])", cell.source):
                assert number in known, f"{number} in: {cell.source}"


@each_notebook
def test_links_lead_somewhere(name: str) -> None:
    for cell in read(NOTEBOOKS[name]).cells:
        if cell.cell_type == "markdown":
            for link in re.findall(r"\]\(([^)#]+)\)", cell.source):
                assert link.startswith("http") or (NOTEBOOKS[name].parent / link).exists(), link


@each_notebook
def test_a_notebook_runs(name: str) -> None:
    """As it stands, started from its own folder; as many pictures come out as are kept."""
    notebook = read(NOTEBOOKS[name])
    kept = pictures_of(notebook)
    client = nbclient.NotebookClient(
        notebook,
        timeout=MAX_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(ROOT / "notebooks")}},
    )
    client.execute()
    assert pictures_of(notebook) == kept > 0
