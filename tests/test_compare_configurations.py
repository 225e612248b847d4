"""The example of a fleet and its benchmark run, and print what they say."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from tests.files import ROOT


def run(script: str, *arguments: str | Path) -> str:
    command = [sys.executable, str(ROOT / script), *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_example_finds_the_noisy_gyroscope(tmp_path: Path) -> None:
    out = run(
        "examples/compare_configurations.py",
        "--flights",
        "4",
        "--seconds",
        "2",
        "--jobs",
        "1",
        "--out",
        tmp_path / "fleet",
    )
    over_sigma = [float(number) for number in re.findall(r"^mav2: .* over sigma ([\d.]+)", out, re.MULTILINE)]
    assert len(over_sigma) == 2
    assert over_sigma[1] < 0.7 * over_sigma[0]
    assert out.count("worst: ") == 2
    assert "data.csv: is empty" in out
    assert "0 worse, 2 better" in out
    page = (tmp_path / "fleet" / "after" / "fleet.html").read_text(encoding="utf-8")
    assert "2 better" in page


def test_the_benchmark_prints_its_numbers() -> None:
    out = run("benchmarks/fleet.py", "--flights", "2", "--distinct", "1", "--seconds", "1", "--rows", "50")
    assert [line.split()[0] for line in out.splitlines()[2:6]] == ["plainly", "as", "1", "2"]
    assert re.search(r"two workers are \d\.\d\d times as fast as one", out)
    assert re.search(r"overhead in the worker, processor: -?[\d.]+ ms a flight", out)
    assert "rows of one and two workers: the same" in out
    assert "tables, per row" in out
