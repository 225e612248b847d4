"""The wheel that is built holds all it needs, and runs from anywhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from tests.files import ROOT

SOURCE_SUFFIXES = {".py", ".typed", ".html", ".j2", ".css", ".js", ".json", ".toml", ".svg", ".csv", ".onnx"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build with this environment's hatchling: nothing is fetched."""
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=out)
    assert run.returncode == 0, run.stdout + run.stderr
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel into an empty environment; a path file lends it this environment's dependencies.

    The sources' own editable installation does not come along: its path file is not followed from there.
    """
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    (site,) = folder.glob("lib/python*/site-packages")
    # By --python, never by --prefix: that would take the sources' own installation for an older version.
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python")]
    options = ["--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"]
    subprocess.run([*pip, "install", *options, str(wheel)], check=True, stdin=subprocess.DEVNULL)
    lent = [entry for entry in sys.path if Path(entry).name == "site-packages"]
    (site / "dependencies.pth").write_text("\n".join(lent) + "\n")
    return folder


def run_in(environment: Path, *command: str) -> subprocess.CompletedProcess[str]:
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    program = [str(environment / "bin" / command[0]), *command[1:]]
    return subprocess.run(program, capture_output=True, text=True, cwd=environment, env=clean)


def test_the_wheel_holds_every_file_of_both_packages(wheel: Path) -> None:
    sources = {
        path.relative_to(ROOT).as_posix()
        for package in ("vision", "fusion")
        for path in (ROOT / package).rglob("*")
        if path.suffix in SOURCE_SUFFIXES or path.name == "py.typed"
    }
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert {"vision/py.typed", "fusion/py.typed", "fusion/cli/app.py"} <= inside
    assert inside == sources


def test_the_wheel_says_what_it_is(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    (metadata,) = (name for name in archive.namelist() if name.endswith("METADATA"))
    text = archive.read(metadata).decode()
    for line in ("Name: corridor-fusion", "Requires-Python: >=3.11", "Requires-Dist: filterpy<3,>=2"):
        assert line in text
    assert any(name.endswith("licenses/LICENSE") for name in archive.namelist())


def test_the_installed_packages_are_the_wheels(installed: Path) -> None:
    code = "import fusion, vision; print(fusion.__file__); print(vision.__file__)"
    run = run_in(installed, "python", "-c", code)
    assert run.returncode == 0, run.stderr
    assert all(Path(line).is_relative_to(installed) for line in run.stdout.split())


def test_the_command_runs_from_another_folder(installed: Path) -> None:
    run = run_in(installed, "corridor", "--help")
    assert run.returncode == 0, run.stderr
    assert "fuse" in run.stdout
    assert "measure" in run.stdout
    assert run_in(installed, "corridor", "--version").stdout.startswith("corridor-fusion 0.")


def test_every_library_is_listed_with_its_licence() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    optional = project["optional-dependencies"]
    extras = [name for name in optional if name not in ("test", "dev")]
    wanted = [*project["dependencies"], *(library for extra in extras for library in optional[extra])]
    names = {re.split(r"[<>=\[]", library)[0] for library in wanted} - {"corridor-fusion"}
    rows = re.findall(r"^\| ([\w., -]+) \| \S+", (ROOT / "LICENSES.md").read_text(), re.MULTILINE)
    assert names == {name.strip() for row in rows for name in row.split(",")} - {"library"}
