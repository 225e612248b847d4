"""Output of the command line: notes, progress and errors to stderr, one line each; results to stdout."""

from __future__ import annotations

import errno
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from fusion.cli import interrupts
from fusion.printable import printable
from fusion.progress import Progress
from vision.errors import InputError

#: click's `UsageError`; newer versions of typer have their own copy.
USAGE_ERROR: Any = typer.BadParameter.__base__
MAX_LINE = 2000  # characters: a message may quote a long value from a file


def say(text: str) -> None:
    """Print a note or an error to stderr, in one line."""
    line = printable(" ".join(text.split()))
    if len(line) > MAX_LINE:
        line = f"{line[: MAX_LINE // 2]} ... {line[-MAX_LINE // 2 :]}"
    print(f"corridor: {line}", file=sys.stderr, flush=True)


def command_line() -> str:
    """Return the command line as typed, quoted for a shell."""
    return shlex.join(["corridor", *sys.argv[1:]])


def echo(text: str) -> None:
    """Print a result to stdout."""
    typer.echo(printable(text, keep="\n"))


class OneLineErrors(TyperGroup):
    """Commands that report errors of input and usage in one line on stderr with exit code 2, without a traceback."""

    def main(self, *args: Any, **settings: Any) -> Any:
        """Run the command line; report usage errors like errors in files."""
        try:
            code = super().main(*args, **settings | {"standalone_mode": False})
        except USAGE_ERROR as error:
            code = error.exit_code
            if type(error).__name__ == "NoArgsIsHelpError":
                error.show()
            else:
                command = "corridor" if error.ctx is None else error.ctx.command_path
                say(f"error: {error.format_message().rstrip('.')} (see {command} --help)")
        raise SystemExit(code if isinstance(code, int) else 0)

    def invoke(self, ctx: Any) -> Any:
        """Run the command, and convert errors to a line and an exit code."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            say(f"error: {error}")
        except OSError as error:
            if error.errno == errno.EPIPE:  # the reader has closed the pipe: end without a message
                raise
            where = f"{error.filename}: " if error.filename else ""
            say(f"error: {where}{error.strerror or error}")
        except (Exception, KeyboardInterrupt) as error:
            if not interrupts.was_interrupted(error):
                raise
            say("interrupted")
            raise typer.Exit(interrupts.EXIT_CODE) from None
        raise typer.Exit(2)


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """Provide a function to call with (done, total) that updates a progress bar; silent without a terminal."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console, period_s = Console(stderr=True), 600.0  # a step may take minutes
    with Bar(*columns, console=console, transient=True, speed_estimate_period=period_s) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def compile_notice(what: str) -> Iterator[None]:
    """Print a note, once, if the block compiles the pixel loops, which takes far longer than running them.

    numba announces each compilation; code taken from its cache on disk is not announced.
    """
    from numba.core import event

    class Notice(event.Listener):
        announced = False

        def on_start(self, event: Any) -> None:
            if not self.announced:
                self.announced = True
                say(f"compiling {what} (once, up to a minute) ...")

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Notice()):
        yield
