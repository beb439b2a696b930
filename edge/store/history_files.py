"""The history of presses as a file: CSV for spreadsheets, Parquet for programs.

The file appears complete or not at all, and rows are written as they are read.
"""

import csv
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import astuple
from itertools import islice
from pathlib import Path
from typing import Final

from edge.core.errors import StoreError
from edge.store.history import COLUMNS, HistoryRow

__all__ = ["FORMATS", "write_history"]

# Rows of one row group of a Parquet file; all of them are in memory at once.
GROUP_ROWS: Final = 50_000


def write_history(path: Path, rows: Iterable[HistoryRow]) -> int:
    """Write the rows to a file whose ending names its format; returns their number. A file of that name is replaced.

    Errors: StoreError for an ending that is no format, or a folder that cannot be written.
    """
    write = FORMATS.get(path.suffix.lower())
    if write is None:
        raise StoreError(f"the ending of {path} names no format; known are {', '.join(FORMATS)}")
    part = path.with_name(path.name + ".part")
    try:
        number = write(part, rows)
        os.replace(part, path)
    except OSError as error:
        raise StoreError(
            f"file {path} cannot be written: {error.strerror or error}; check its folder and the free space"
        ) from error
    finally:
        part.unlink(missing_ok=True)
    return number


def _write_csv(path: Path, rows: Iterable[HistoryRow]) -> int:
    """Write a row of column names, then the presses. An empty cell is a missing value."""
    number = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow(astuple(row))
            number += 1
    return number


def _write_parquet(path: Path, rows: Iterable[HistoryRow]) -> int:
    """Column `time_ns` is a moment in UTC, so that programs need no conversion."""
    import pyarrow as pa
    from pyarrow import parquet

    types = {"number": pa.int64(), "time_ns": pa.timestamp("ns", "UTC")}
    types |= {name: pa.float64() for name in ("running_s", "score", "threshold")}
    schema = pa.schema([(name, types.get(name, pa.string())) for name in COLUMNS])
    number = 0
    with parquet.ParquetWriter(path, schema) as writer:
        remaining = iter(rows)
        while group := list(islice(remaining, GROUP_ROWS)):
            columns = zip(*map(astuple, group), strict=True)
            arrays = [pa.array(values, field.type) for values, field in zip(columns, schema, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            number += len(group)
    return number


FORMATS: Final[Mapping[str, Callable[[Path, Iterable[HistoryRow]], int]]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
}
"""Ending of a file's name to what writes it."""
