"""Ctrl-C ends every command at once, with one line and exit code 130, and leaves nothing half written."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.files import OFFICE, ROOT

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
FUSE = ("fuse", str(OFFICE), "-o", "out")
SIMULATE = ("simulate", "out", "--duration", "600", "--size", "160x120")


@pytest.fixture(autouse=True)
def interrupts_are_not_ignored() -> Iterator[None]:
    """A shell without a terminal has its background jobs ignore interrupts, and theirs do, too."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def processor_s(pid: int) -> float:
    """Processor time that a process has had, seconds: unlike the clock it says how far a process has come."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.skipif(sys.platform != "linux", reason="processor time is read from /proc")
@pytest.mark.parametrize(
    ("command", "after_s"), [(FUSE, 0.15), (FUSE, 0.3), (FUSE, 0.6), (FUSE, 0.9), (SIMULATE, 2.0)]
)
def test_an_interrupt_is_one_line_and_leaves_nothing(
    command: tuple[str, ...], after_s: float, tmp_path: Path
) -> None:
    line = [sys.executable, "-m", "fusion", *command]
    with subprocess.Popen(line, cwd=tmp_path, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT) as run:
        while run.poll() is None and processor_s(run.pid) < after_s:
            time.sleep(0.005)
        run.send_signal(signal.SIGINT)
        assert run.stderr is not None
        said = run.stderr.read()
    assert run.returncode == 130
    assert said.endswith("corridor: interrupted\n")
    assert "Traceback" not in said
    assert os.listdir(tmp_path) == []


INTERRUPTED = """
import os, signal
from pathlib import Path
from fusion.cli.interrupts import leave_at_once
import fusion.files as files
leave_at_once()

class Swallows:  # as a callback of a library would: what is raised in it is lost
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

here = Path.cwd()
"""


def interrupted(code: str, folder: Path) -> str:
    """Run code after `INTERRUPTED` in a folder, and return what it says on stderr; it has to end with 130."""
    run = subprocess.run(
        [sys.executable, "-c", INTERRUPTED + code],
        cwd=folder,
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
    )
    assert run.returncode == 130, run.stderr
    return run.stderr


class TestWhereWhatIsRaisedIsLost:
    def test_a_file_stays_as_it_was(self, tmp_path: Path) -> None:
        (tmp_path / "table.csv").write_text("before")
        code = (
            'with files.replacing(here / "table.csv") as draft:\n    draft.write_text("half"); Swallows()\n'
        )
        assert interrupted(code, tmp_path) == "corridor: interrupted\n"
        assert os.listdir(tmp_path) == ["table.csv"]
        assert (tmp_path / "table.csv").read_text() == "before"

    def test_a_folder_set_aside_is_put_back(self, tmp_path: Path) -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "table.csv").write_text("before")
        code = (
            'with files.replacing_folder(here / "out") as draft:\n'
            '    (draft / "table.csv").write_text("half")\n'
            '    (here / "out").rename(draft.with_suffix(".old")); Swallows()\n'
        )
        interrupted(code, tmp_path)
        assert os.listdir(tmp_path) == ["out"]
        assert (tmp_path / "out" / "table.csv").read_text() == "before"
