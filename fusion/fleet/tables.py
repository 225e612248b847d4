"""The fleet's table as CSV and Parquet, written atomically and read back."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path

from fusion.files import replacing
from fusion.fleet.row import FleetRow, Value, column_facts, flat, row_from
from vision.errors import InputError

CSV, PARQUET = "fleet.csv", "fleet.parquet"
NEEDS_PARQUET = 'pip install "corridor-fusion[parquet]"'


def has_parquet() -> bool:
    """Whether the library for Parquet is installed."""
    return find_spec("pyarrow") is not None


def write_tables(rows: Sequence[FleetRow], folder: Path) -> None:
    """Write ``fleet.csv``, and ``fleet.parquet`` if its library is installed, each atomically.

    Raises
    ------
    InputError
        If one cannot be written.
    """
    values = [flat(row) for row in rows]
    names = [name for name, *_ in column_facts()]
    with replacing(folder / CSV) as draft, draft.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([_text(row[name]) for name in names] for row in values)
    if has_parquet():
        _write_parquet(values, folder / PARQUET)


def _text(value: Value) -> str:
    if value is None:
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _write_parquet(rows: Sequence[dict[str, Value]], path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    schema = pa.schema(
        [
            pa.field(
                name,
                types[kind],
                metadata={"unit": unit, "description": meaning} if unit else {"description": meaning},
            )
            for name, kind, unit, meaning in column_facts()
        ],
        metadata={"software": "corridor-fusion", "table": "fleet"},
    )
    arrays = [
        pa.array([None if row[name] == "" else row[name] for row in rows], type=schema.field(name).type)
        for name in schema.names
    ]
    with replacing(path) as draft, draft.open("wb") as file:  # pyarrow opens no path that is not UTF-8
        pq.write_table(pa.Table.from_arrays(arrays, schema=schema), file, compression="zstd")


def read_fleet(path: str | Path) -> list[FleetRow]:
    """Read a fleet's table back, Parquet or CSV; a folder means the table in it.

    Raises
    ------
    InputError
        If it does not exist, or is something else.
    """
    path = Path(path)
    if path.is_dir():
        path = path / (PARQUET if has_parquet() and (path / PARQUET).is_file() else CSV)
    if not path.is_file():
        raise InputError(
            "there is no such table", file=path, remedy="give the fleet.parquet of an earlier batch"
        )
    try:
        rows = [row_from(values) for values in _read(path)]
    except InputError:
        raise
    except Exception as error:  # pyarrow, csv and text decoding raise various errors
        raise InputError(
            f"cannot be read: {error}", file=path, remedy="give a batch's fleet.parquet"
        ) from error
    if not rows or not all(row.flight for row in rows):
        raise InputError(
            "is not a fleet table", file=path, remedy="give the fleet.parquet of an earlier batch"
        )
    return rows


def _read(path: Path) -> Iterable[dict[str, Value]]:
    if path.suffix.lower() != ".parquet":
        with path.open(encoding="utf-8", newline="") as file:
            return [dict(row) for row in csv.DictReader(file)]
    if not has_parquet():
        raise InputError(
            "Parquet needs the library pyarrow", file=path, remedy=f"{NEEDS_PARQUET}, or give fleet.csv"
        )
    import pyarrow.parquet as pq

    with path.open("rb") as file:
        found: list[dict[str, Value]] = pq.read_table(file).to_pylist()
    return found
