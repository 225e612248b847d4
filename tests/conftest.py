"""What all tests share: no deadlines, and the command line run in the test's own process."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from fusion.cli import app as cli
from tests.command import Corridor, Run

# The first example may compile, and machines are noisy: time is measured in benchmarks, not in tests.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# Files whose single tests take longest.
BEGIN_WITH = ("test_notebooks.py", "test_compare_configurations.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest tests: at the end, a worker that has nothing left would wait for the other's."""
    items.sort(key=lambda item: item.path.name not in BEGIN_WITH)


@pytest.fixture
def corridor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Corridor:
    """Run the command in an empty folder of its own, in this process."""
    folder = tmp_path / "cwd"
    folder.mkdir()
    monkeypatch.chdir(folder)

    def run(*arguments: str | Path) -> Run:
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main([str(argument) for argument in arguments])
        code = end.value.code
        return Run(code if isinstance(code, int) else 0, *capfd.readouterr())

    return run
