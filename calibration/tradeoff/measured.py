"""A trade-off as its folder holds it: rows that are there are read, others are measured."""

from collections.abc import Callable, Sequence
from pathlib import Path

from calibration.evaluate.report import write_atomically
from calibration.tradeoff.page import page
from calibration.tradeoff.plan import BACKBONES, chosen_points
from calibration.tradeoff.point import OperatingPoint
from calibration.tradeoff.presses import Chosen
from calibration.tradeoff.rows import Row, read_rows, write_rows
from calibration.tradeoff.run import RunSettings, Show, clean, measure, require_same_run
from edge import registry

__all__ = ["ROWS_FILE", "measured_rows", "points_of", "write_page"]

ROWS_FILE = "rows.jsonl"


def points_of(
    chosen: Chosen, methods: Sequence[str] | None, backbones: Sequence[str] | None
) -> tuple[OperatingPoint, ...]:
    """The operating points of these presses; no method or backbone: all of them."""
    return chosen_points(
        tuple(backbones or BACKBONES),
        tuple(methods or registry.names("detectors")),
        has_high_resolution=bool(chosen.high),
        most_presses=len(chosen.fitted),
    )


def measured_rows(
    points: Sequence[OperatingPoint],
    chosen: Chosen,
    settings: RunSettings,
    output: Path,
    *,
    overwrite: bool,
    with_peers: bool,
    show: Show,
    say: Callable[[str], None],
) -> list[Row]:
    """The rows of the folder, measured where it has none. Errors: as `measure`; ConfigError for rows of another run."""
    file = output / ROWS_FILE
    for sentence in chosen.remarks():
        say(sentence)
    if file.is_file() and not overwrite:
        rows = read_rows(file)
        require_same_run(rows, points, chosen, settings, file)
        say(f"{file} holds {len(rows)} points; --overwrite measures them again")
        return rows
    if not chosen.high:
        say("no high-resolution pictures of these presses: one resolution is measured")
    rows = measure(points, chosen, settings, output / "unfinished", show, with_peers=with_peers)
    write_rows(file, rows)
    clean(output / "unfinished")
    return rows


def write_page(rows: Sequence[Row], output: Path) -> Path:
    """`tradeoff.html` in the folder."""
    write_atomically(output / "tradeoff.html", page(rows).encode())
    return output / "tradeoff.html"
