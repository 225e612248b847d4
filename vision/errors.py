"""The exception raised for unusable user input."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Unusable input, described in one line: file, field, value and remedy.

    The command line prints it and exits with code 2; a library caller catches it.

    Parameters
    ----------
    problem
        What is wrong, naming the field and the offending value.
    file
        The file that contains it, if any.
    remedy
        What the user can do about it.
    """

    def __init__(self, problem: str, *, file: str | Path | None = None, remedy: str | None = None) -> None:
        self.problem = problem
        self.file = None if file is None else Path(file)
        self.remedy = remedy
        prefix = "" if file is None else f"{file}: "
        suffix = "" if remedy is None else f" ({remedy})"
        super().__init__(f"{prefix}{problem}{suffix}")
