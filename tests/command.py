"""What a run of the command leaves behind."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Run(NamedTuple):
    """Exit code, standard output and standard error."""

    code: int
    out: str
    err: str


Corridor = Callable[..., Run]
