"""What a run of the command leaves behind, and how it refuses."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import NamedTuple


class Run(NamedTuple):
    """Exit code, standard output and standard error."""

    code: int
    out: str
    err: str


Corridor = Callable[..., Run]


def refused(run: Run, *words: str) -> None:
    """One line on stderr that holds these words, exit code 2, nothing on stdout, nothing left behind."""
    assert run.code == 2, run
    assert run.err.count("\n") == 1, run.err
    assert run.err.startswith("corridor: error: ")
    for word in words:
        assert word in run.err
    assert run.out == ""
    assert os.listdir() == []
