"""The complete rows of a run as JSON lines, one per point."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.experiments.harness.rows import read_rows as read_lines
from calibration.folders import write_atomically
from edge.core.errors import ConfigError

__all__ = ["Row", "read_rows", "write_rows"]

Row = dict[str, Any]


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write all rows or none; numbers with six digits. Errors: GelgateError."""
    write_atomically(path, "".join(json.dumps(_round(row), allow_nan=False) + "\n" for row in rows).encode())


def _round(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _round(one) for name, one in value.items()}
    return float(f"{value:.6g}") if isinstance(value, float) else value


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a finished run. Errors: ConfigError for a file without them."""
    rows = read_lines(path)
    # A study's rows have the same format number, and not these columns.
    if not rows or any("dataset_sha256" not in row for row in rows):
        raise ConfigError(
            f"'{path}' does not hold the rows of a trade-off; give the rows.jsonl of a finished run"
        )
    return rows
