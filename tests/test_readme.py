"""What README and documentation show runs as it stands there, and their links lead somewhere."""

from __future__ import annotations

import re
import shlex
import shutil
import tomllib
from collections.abc import Callable, Iterator
from glob import glob
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from fusion import FusionConfig
from fusion.cli import app as cli
from fusion.estimator.faults import Fault
from fusion.estimator.tables import ESTIMATE_COLUMNS, FRAME_COLUMNS
from fusion.fleet.discovery import _FlightList
from fusion.logs.manifest.file import make_manifest
from fusion.simulate import SimulationConfig
from tests.files import OFFICE, ROOT, written
from vision.errors import InputError
from vision.measurement import Reason

PAGES = {"README.md": ROOT / "README.md"} | {
    path.relative_to(ROOT).as_posix(): path for path in sorted((ROOT / "docs").glob("*.md"))
}
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in PAGES.items()}
FRAMES = 80  # of the sample flight, in the copy that the pages' code runs on
FUSE_OFFICE = "corridor fuse data/office -o out/office"
# Files that stand for a user's own in examples; with them only the options are looked at.
NOT_AT_HAND = {
    *(
        "flights",
        "out/fleet",
        "march.toml",
        "other.toml",
        "log.ulg",
        "hall.mp4",
        "cam.yaml",
        "imu.csv",
        "mocap.tum",
    ),
    *("hall_fused", "flights/hall", "geometric", "paper"),
}


class Block(NamedTuple):
    page: str
    code: str


def blocks(language: str) -> list[Block]:
    fence = re.compile(rf"^```{language}\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
    return [Block(page, code) for page, text in TEXTS.items() for code in fence.findall(text)]


def lines_of(block: Block) -> list[str]:
    """Lines of shell without their comments; one whose quotes go on is one line with the next."""
    found: list[str] = []
    for line in block.code.splitlines():
        if found and found[-1].count('"') % 2:
            found[-1] += "\n" + line
        else:
            found.append(line.split("#")[0].strip())
    return [line for line in found if line]


def shell_lines(start: str) -> list[Block]:
    lines = [Block(b.page, line) for b in blocks("sh") for line in lines_of(b)]
    return [line for line in lines if line.code.startswith(start)]


def named(block: Block) -> str:
    return f"{block.page}: {block.code.splitlines()[0]}"


def _cut(source: Path, to: Path, last_ns: int) -> None:
    """Copy a CSV with its times in the first column, up to a time."""
    head, *rows = source.read_text().splitlines()
    written(to, "\n".join([head, *(row for row in rows if int(row.split(",")[0]) <= last_ns)]) + "\n")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the first seconds of the sample flight where the pages say it is, and some pictures."""
    folder = tmp_path_factory.mktemp("user")
    pictures = sorted((OFFICE / "mav0/cam0/data").glob("*.jpg"))[:FRAMES]
    for source in OFFICE.rglob("*"):
        target = folder / "data/office" / source.relative_to(OFFICE)
        if source.suffix == ".csv":
            _cut(source, target, int(pictures[-1].stem))
        elif source.is_file() and source.suffix != ".jpg":
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target)
    (folder / "data/office/mav0/cam0/data").mkdir()
    for picture in pictures:
        (folder / "data/office/mav0/cam0/data" / picture.name).symlink_to(picture)
    shutil.copy(ROOT / "data" / "office.toml", folder / "data")
    for name in ("picture.jpg", "hall/a.jpg", "hall/b.jpg", "hall/a.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(pictures[0], folder / name)
    written(folder / "tilt.csv", "image,roll_rad,pitch_rad\na.png,0.0,0.0\n")
    return folder


@pytest.fixture
def here(place: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(place)
    yield place
    for output in ("out", "flight", "flight_fused", "drawn", "hall.toml", "office_fused", "turn", "dark"):
        path = place / output
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def run(line: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Run a line of shell that begins with ``corridor``; patterns and ``> FILE`` mean what they do in a shell."""
    command, _, target = line.partition(">")
    words = [found for word in shlex.split(command)[1:] for found in (sorted(glob(word)) or [word])]
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    out = capsys.readouterr().out
    if target:
        Path(target.strip()).write_text(out)
    return int(end.value.code or 0), out


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where `fuse_office` keeps its output."""
    return tmp_path_factory.mktemp("kept") / "office"


def fuse_office(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Put ``out/office`` there for code that reads it; it is made once."""
    if kept.exists():
        shutil.copytree(kept, "out/office")
        return
    assert run(FUSE_OFFICE, capsys)[0] == 0
    shutil.copytree("out/office", kept)


def test_there_is_something_to_run() -> None:
    assert sum(block.page == "README.md" for block in blocks("python")) >= 3
    assert len(shell_lines("corridor ")) > 20


@pytest.mark.parametrize("block", blocks("python"), ids=named)
def test_python_runs(block: Block, here: Path, kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if "out/office" in block.code:
        fuse_office(kept, capsys)
    code = block.code.split("if __name__ ==")[0]  # what starts worker processes has tests of its own
    exec(compile(code, block.page, "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("block", shell_lines("corridor "), ids=named)
def test_commands_run(block: Block, here: Path, kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(block.code.split("|")[0])
    if NOT_AT_HAND & {word.rstrip("/") for word in words}:
        code, text = run(f"corridor {words[1]} --help", capsys)
        assert code == 0
        for word in words:
            assert not word.startswith("-") or re.search(rf"(^|\s){re.escape(word)}\b", text), word
        return
    for needed, made_by in {
        "out/office": FUSE_OFFICE,
        "my.toml": "corridor config > my.toml",
        "dark.toml": "corridor config --simulate > dark.toml",
        "flight": "corridor simulate flight --duration 1",
    }.items():
        if needed in words[2:] and not {"simulate", ">", "-o"} & set(words[: words.index(needed)]):
            if made_by == FUSE_OFFICE:
                fuse_office(kept, capsys)
            else:
                assert run(made_by, capsys)[0] == 0
    if words[1] == "simulate" and "dark.toml" not in words:  # as long as it takes, and no longer
        block = block._replace(
            code=re.sub(r" --duration \S+", "", block.code) + " --duration 1 --size 160x120"
        )
    elif words[1] == "simulate":
        block = block._replace(code=block.code.replace("640x480", "160x120") + " --duration 1")
    assert run(block.code, capsys)[0] == 0


@pytest.mark.parametrize("block", blocks("toml"), ids=named)
def test_settings_are_ones(block: Block) -> None:
    values: dict[str, Any] = tomllib.loads(block.code)
    readers: tuple[Callable[..., Any], ...] = (
        FusionConfig.model_validate,
        make_manifest,
        SimulationConfig.model_validate,
        _FlightList.model_validate,
    )
    refusals = []
    for reader in readers:
        try:
            reader(values)
        except (ValueError, InputError) as refusal:
            refusals.append(str(refusal))
    assert len(refusals) < len(readers), refusals


@pytest.mark.parametrize("block", shell_lines("make "), ids=named)
def test_make_targets_exist(block: Block) -> None:
    assert re.search(rf"^{block.code.split()[1]}:", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)


@pytest.mark.parametrize("block", shell_lines("pip install"), ids=named)
def test_extras_exist(block: Block) -> None:
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for extras in re.findall(r"\[([\w,]+)\]", block.code):
        assert set(extras.split(",")) <= known.keys()


@pytest.mark.parametrize("block", shell_lines(".venv/bin/python "), ids=named)
def test_programs_exist_with_their_options(block: Block) -> None:
    _, program, *options = block.code.split()
    source = (ROOT / program).read_text()
    assert all(f'"{option}"' in source for option in options if option.startswith("--"))


def test_every_kind_of_shell_line_is_looked_at() -> None:
    starts = (
        "corridor ",
        "make ",
        "pip install",
        ".venv/bin/python ",
        "dask ",
    )  # dask: of docs/fleet.md, as its own
    assert [line for b in blocks("sh") for line in lines_of(b) if not line.startswith(starts)] == []


@pytest.mark.parametrize("page", PAGES)
def test_programs_that_a_page_names_exist(page: str) -> None:
    for program in re.findall(r"\b((?:benchmarks|examples|docs)/\w+\.py)", TEXTS[page]):
        assert (ROOT / program).is_file(), program


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", TEXTS[page]):
        if link.startswith("http"):
            continue
        target, _, anchor = link.partition("#")
        path = (PAGES[page].parent / target).resolve() if target else PAGES[page]
        assert path.exists(), link
        if anchor:
            heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
            assert anchor in {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}, link


def test_the_columns_page_has_every_column_and_reason() -> None:
    page = TEXTS["docs/columns.md"]
    for column in (*ESTIMATE_COLUMNS, *FRAME_COLUMNS):
        assert f"| `{column.name}` | {column.unit} | {column.meaning.format(side='right')} |" in page
    assert all(f"`{reason}`" in page for reason in Reason)


def test_the_controllers_page_has_every_fault() -> None:
    page = TEXTS["docs/controller.md"]
    for fault in Fault:
        assert f"| {fault.value.bit_length() - 1} | `{fault.name}` |" in page


def test_each_command_has_a_manual_and_a_help_that_begins_shortly(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The manual is a section of docs/commands.md, or a page of its own that names the command."""
    run_help = run("corridor --help", capsys)[1]
    commands = re.findall(r"^  (\w+)  +[A-Z]", run_help.split("Commands:")[1], flags=re.MULTILINE)
    assert {"fuse", "inspect", "measure", "align", "simulate", "evaluate", "config"} <= set(commands)
    for command in commands:
        has_section = f"\n## corridor {command}\n" in TEXTS["docs/commands.md"]
        pages = [
            page for page, text in TEXTS.items() if f"corridor {command}" in text and page != "README.md"
        ]
        assert has_section or pages, command
        text = run(f"corridor {command} --help", capsys)[1]
        assert f"\n    corridor {command} " in text
        if has_section:
            assert len(text.split("Usage:")[1].split("Examples:")[0].splitlines()) <= 10, command


def test_versions_agree() -> None:
    from fusion import __version__

    assert f"version: {__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {__version__}\n" in (ROOT / "CHANGELOG.md").read_text()


def test_the_read_me_keeps_no_picture_that_is_gone() -> None:
    drawn = {path.name for path in (ROOT / "docs" / "img").iterdir()}
    shown = {name for text in TEXTS.values() for name in re.findall(r"img/(\w+\.\w+)\)", text)}
    assert drawn == shown
