"""Tables as Parquet, each column with its unit, frame and meaning, each file with its conventions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fusion.estimator.tables import Table
from fusion.result.conventions import Frame, column_metadata


def write_parquet(table: Table, path: Path, frame: Frame, facts: Mapping[str, str]) -> None:
    """Write a table; unknown numbers and words become nulls.

    Parameters
    ----------
    table
        Rows of `fusion.estimator.tables.ESTIMATE_DTYPE` or `fusion.estimator.tables.FRAME_DTYPE`, in ``frame``
        already.
    path
        The file.
    frame
        Of the table, for the columns' descriptions.
    facts
        Metadata of the file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays, fields = [], []
    for name in table.dtype.names or ():
        values = table[name]
        if values.dtype.kind == "U":
            array = pa.array([word or None for word in values.tolist()], pa.string())
        else:
            array = pa.array(values, from_pandas=True)  # NaN becomes null
        arrays.append(array)
        fields.append(
            pa.field(name, array.type, nullable=name != "timestamp_ns", metadata=column_metadata(name, frame))
        )
    schema = pa.schema(fields, metadata=dict(facts))
    with path.open("wb") as file:  # pyarrow opens no path that is not UTF-8
        pq.write_table(pa.Table.from_arrays(arrays, schema=schema), file, compression="zstd")
