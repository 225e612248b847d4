"""Journal of a batch: each row is written as a line of JSON when it is ready, so that a batch can be resumed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

from fusion.files import replacing
from fusion.fleet.row import FleetRow, flat, row_from

JOURNAL = "fleet.jsonl"


def read_journal(folder: Path) -> dict[str, FleetRow]:
    """Return the last row of each flight by name; truncated lines are skipped."""
    found: dict[str, FleetRow] = {}
    path = folder / JOURNAL
    if not path.is_file():
        return found
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            try:
                row = row_from(json.loads(line))
            except (ValueError, TypeError, AttributeError):
                continue
            found[row.flight] = row
    return found


class Journal:
    """Adds rows to a batch's journal; each is flushed to the system before `add` returns."""

    def __init__(self, folder: Path, rows: Iterable[FleetRow]) -> None:
        """Start with these rows, which replace the existing ones at once."""
        with replacing(folder / JOURNAL) as draft:
            draft.write_text("".join(map(_line, rows)), encoding="utf-8")
        self._file = (folder / JOURNAL).open("a", encoding="utf-8")

    def add(self, row: FleetRow) -> None:
        """Add a row."""
        self._file.write(_line(row))
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _line(row: FleetRow) -> str:
    return json.dumps(flat(row), ensure_ascii=True) + "\n"
