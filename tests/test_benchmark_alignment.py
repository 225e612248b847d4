"""The alignment's benchmark runs, and its table holds what was injected and found."""

from __future__ import annotations

import subprocess
import sys

from tests.files import ROOT


def test_the_table_of_the_sample_flight() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "alignment.py"), "--quick", "--only", "office"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    (row,) = [line for line in done.stdout.splitlines() if line.startswith("   1200.0")]
    clock, focal, yaw = ([float(word) for word in part.split()] for part in row.split("|")[:3])
    assert abs(clock[1] - 1200.0) < 5.0
    assert abs(focal[1] - 0.9) < 0.01
    assert abs(yaw[1] - 3.0) < 1.5
    for injected, found, sigma, z in (clock, focal, yaw):
        assert abs((found - injected) / sigma - z) < 0.2
    assert "2 of which tell the offset" in done.stdout
