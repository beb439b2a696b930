"""A trade-off as its folder holds it: rows that are there are read, others are measured."""

from collections.abc import Callable
from pathlib import Path

from calibration.studies.rows import ROWS_FILE
from calibration.studies.runner import Show
from calibration.tradeoff.plan import Run
from calibration.tradeoff.rows import Row, read_rows, write_rows
from calibration.tradeoff.run import clean, measure, require_same_run

__all__ = ["measured_rows"]


def measured_rows(
    run: Run, output: Path, overwrite: bool, with_peers: bool, show: Show, say: Callable[[str], None]
) -> list[Row]:
    """The rows of the folder, measured where it has none. Errors: as `measure`; ConfigError for rows of another run."""
    file = output / ROWS_FILE
    for sentence in run.chosen.remarks():
        say(sentence)
    if file.is_file() and not overwrite:
        rows = read_rows(file)
        require_same_run(rows, run, file)
        say(f"{file} holds {len(rows)} points; --overwrite measures them again")
        return rows
    if not run.chosen.high:
        say("no high-resolution pictures of these presses: one resolution is measured")
    rows = measure(run, output / "unfinished", show, with_peers=with_peers)
    write_rows(file, rows)
    clean(output / "unfinished")
    return rows
