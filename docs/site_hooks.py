"""What MkDocs does besides: notebooks and files of the repository as pages, and equations without a script.

The pages of ``docs/`` link to ``../notebooks/...`` and ``../examples/...`` so that the links hold in the repository;
in the site these files lie beside the pages, and the links are turned.
"""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("CONTRIBUTING.md", "CHANGELOG.md")
LINK = re.compile(r"\]\((?:\.\./)+([^)#]+)(#[^)]*)?\)")
CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", flags=re.DOTALL | re.MULTILINE)
EQUATION = re.compile(r"\$\$(.+?)\$\$|(?<![\w$])\$([^$\n]+?)\$(?!\w)", flags=re.DOTALL)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Give pages that the menu in ``mkdocs.yml`` does not name a place in it."""
    listed = str(config.nav)
    (use,) = (part["Use"] for part in config.nav or [] if "Use" in part)
    use += [page.name for page in sorted((ROOT / "docs").glob("*.md")) if page.name not in listed]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add notebooks as pages with their pictures, and every file of the repository that a page links to."""
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for name, content in _pages_of(path).items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")]
    linked = {name for page in pages for name, _ in LINK.findall(page.read_text(encoding="utf-8"))}
    for name in sorted(linked | set(PAGES)):
        if (ROOT / name).is_file() and not name.startswith(("docs/", "notebooks/")):
            files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Any, config: MkDocsConfig, files: Files) -> str:
    """Turn links that leave ``docs/``, and equations into MathML."""
    name = page.file.src_uri
    if name in PAGES:
        markdown = markdown.replace("](docs/", "](")
    elif not name.startswith("notebooks/"):
        markdown = LINK.sub(lambda m: f"]({_placed(m[1])}{m[2] or ''})", markdown)
    parts = CODE.split(markdown)
    return "".join(part if i % 2 else EQUATION.sub(_mathml, part) for i, part in enumerate(parts))


def _placed(name: str) -> str:
    return f"{name}.md" if name.endswith(".ipynb") else name


def _mathml(match: re.Match[str]) -> str:
    if match[1] is not None:
        return f"\n\n{convert(match[1].strip(), display='block')}\n\n"
    return f"<span>{convert(match[2])}</span>"  # a line must not begin with <math>: Markdown takes it for a block


def _pages_of(path: Path) -> dict[str, str | bytes]:
    """Return a notebook as a page, and its pictures, by name."""
    found: dict[str, str | bytes] = {}
    text = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            source = re.sub(r"\]\((\w+\.ipynb)\)", r"](\1.md)", source)
            text.append(LINK.sub(lambda m: f"](../{m[1].removeprefix('docs/')})", source))
            continue
        text.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                picture = f"{path.stem}_{len(found)}.png"
                found[picture] = base64.b64decode(data["image/png"])
                text.append(f"![Figure of the cell above]({picture})")
            elif "text/html" in data:
                html = "".join(data["text/html"])
                text.append(re.sub(r"<style.*?</style>|\n\s*", "", html, flags=re.DOTALL))
            else:
                printed = "".join(output.get("text", data.get("text/plain", "")))
                text.append(f"```text\n{printed.rstrip()}\n```")
    return {f"{path.name}.md": "\n\n".join(text), **found}
