"""What the command line says while it works, on stderr: notes, progress, the wait for a first compile."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Progress = Callable[[int, int], None]


def say(text: str) -> None:
    """Tell the user something that is not a result, one line."""
    print(f"corridor: {text}", file=sys.stderr, flush=True)


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """Show a bar while the block calls what it is given with (done, total); silent without a terminal."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def compile_notice(what: str) -> Iterator[None]:
    """Say so, once, if the block has to compile the pixel loops, which takes far longer than running them.

    numba announces each compilation; code taken from its cache on disk is not announced.
    """
    from numba.core import event

    class Notice(event.Listener):
        told = False

        def on_start(self, event: Any) -> None:
            if not self.told:
                self.told = True
                say(f"compiling {what} (once, some seconds) ...")

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Notice()):
        yield
