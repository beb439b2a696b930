"""The complete rows of a run as JSON lines, one per point."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from calibration.evaluate.report import write_atomically
from edge.core.errors import ConfigError

__all__ = ["FORMAT", "Row", "read_rows", "write_rows"]

FORMAT: Final = 1
"""The version of a row's fields; rows of another version are refused."""

Row = dict[str, Any]


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """All rows or none; numbers with six digits. Errors: GelgateError."""
    write_atomically(
        path, "".join(json.dumps(_rounded(row), allow_nan=False) + "\n" for row in rows).encode()
    )


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _rounded(one) for name, one in value.items()}
    return float(f"{value:.6g}") if isinstance(value, float) else value


def read_rows(path: Path) -> list[Row]:
    """The rows of a finished run. Errors: ConfigError for a file that is none, or is of another version."""
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        formats = {row["format"] for row in rows}
        # A study's rows have the same format number, and not these columns.
        points = [(row["key"], row["dataset_sha256"]) for row in rows if row["format"] == FORMAT]
    except OSError as error:
        raise ConfigError(
            f"'{path}' cannot be read: {error.strerror}; give the rows.jsonl of a finished run"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"'{path}' does not hold the rows of a trade-off ({type(error).__name__}); give the rows.jsonl of a "
            "finished run"
        ) from error
    if len(points) < len(rows) or not rows:
        found = ", ".join(map(str, sorted(formats))) or "none"
        raise ConfigError(
            f"'{path}' has rows of format {found}, this program reads format {FORMAT}; measure again"
        )
    return rows
