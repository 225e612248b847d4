"""The documentation's site builds without a warning, and its pages load nothing from elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.files import ROOT

for _needed in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
    pytest.importorskip(_needed, reason="comes with the docs extra")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert run.returncode == 0, run.stdout + run.stderr
    return folder


def test_every_page_and_notebook_is_there(site: Path) -> None:
    for page in (ROOT / "docs").glob("*.md"):
        assert (site / f"{page.stem}.html").is_file(), page
    for notebook in (ROOT / "notebooks").glob("*.ipynb"):
        page_text = (site / "notebooks" / f"{notebook.name}.html").read_text(encoding="utf-8")
        assert "<img" in page_text


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    """Neither scripts, pictures and styles of a page, nor what the styles name."""
    loading = re.compile(r'(?:src|srcset)="(?:https?:)?//|<link[^>]+href="(?:https?:)?//(?![^"]*canonical)')
    for page in site.rglob("*.html"):
        assert not loading.search(page.read_text(encoding="utf-8")), page
    for style in site.rglob("*.css"):
        assert not re.search(r"url\([\"']?(?:https?:)?//", style.read_text(encoding="utf-8")), style


def test_links_between_pages_lead_somewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        if page.name == "404.html":
            continue
        for link in re.findall(r'(?:href|src)="([^"#?:]+)(?:#[^"]*)?"', page.read_text(encoding="utf-8")):
            target = (page.parent / link).resolve()
            assert target.exists(), f"{page.name}: {link}"


def test_equations_are_drawn_without_a_script(site: Path) -> None:
    text = (site / "method.html").read_text(encoding="utf-8")
    assert text.count("<math") > 20
    assert "$" not in re.sub(r"<(script|code|pre)\b.*?</\1>", "", text, flags=re.DOTALL)


def test_the_reference_describes_what_is_offered(site: Path) -> None:
    import fusion
    import vision

    text = (site / "api.html").read_text(encoding="utf-8")
    for name in (*fusion.__all__, "measure_frame", "extract_lines", *vision.__all__):
        if name not in ("LineClass", "Position"):
            assert re.search(rf'id="[\w.]+\.{name}"', text), name
