"""`gelgate lab study all`: every study into one file of rows, then their pages, with the time that each took."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from calibration.experiments.harness.presses import open_presses
from calibration.experiments.harness.rows import TIMES, Rows, read_rows
from calibration.experiments.harness.study import ROWS_FILE, Options
from calibration.experiments.studies.bad_presses_study import study_bad_presses
from calibration.experiments.studies.cross_position_study import find_pairs, study_cross_position
from calibration.experiments.studies.good_fraction_study import FRACTIONS, SHOTS, study_good_fraction
from calibration.experiments.studies.report import write_report
from calibration.experiments.studies.resolution_study import MOST_PRESSES, fine_places, study_resolution
from edge.core.errors import DatasetError

__all__ = ["study_all"]


def study_all(
    options: Options,
    most_presses: int = MOST_PRESSES,
    *,
    fractions: Sequence[float] = FRACTIONS,
    shots: Sequence[int] = SHOTS,
    views: Sequence[str] = (),
) -> Iterator[str]:
    """Run the studies in the order in which they need each other's rows; gives a line for each, with its time.

    A study for which the dataset has no presses, such as a second position, is left out with its sentence; the first
    one must run. Errors: as the studies.
    """
    began = time.monotonic()
    yield _run_timed("good-fraction", lambda: study_good_fraction(options, fractions=fractions, shots=shots))
    for name, study in {
        "cross-position": lambda: study_cross_position(_fitting(options, _check_pairs)),
        "resolution": lambda: study_resolution(_fitting(options, fine_places), views, most_presses),
        "bad-presses": lambda: study_bad_presses(options),
    }.items():
        try:
            yield _run_timed(name, study)
        except DatasetError as error:
            yield f"{name}: left out: {error}"
    rows = options.output / ROWS_FILE
    yield from (f"page: {page}" for page in write_report(rows, options.output / "report"))
    yield f"all: {_write_time(time.monotonic() - began)}; {_spent(read_rows(rows))}"


def _check_pairs(options: Options) -> object:
    return find_pairs(open_presses(options.dataset), options, None)


def _fitting(options: Options, places: Callable[[Options], object]) -> Options:
    """The options with those of the given parts that a study can use. Errors: DatasetError where it can use none."""
    kept, refusal = [], None
    for part in options.parts:
        try:
            places(replace(options, parts=(part,)))
            kept.append(part)
        except DatasetError as error:
            refusal = error
    if refusal is not None and not kept:
        raise refusal
    return replace(options, parts=tuple(kept))


def _spent(rows: Sequence[Mapping[str, Any]]) -> str:
    """Write the time of all cells: an interrupted run's clock shows only what it did itself."""
    seconds = sum(row[name] for row in rows for name in TIMES if row.get(name) is not None)
    return f"its {len(rows)} cells took {_write_time(seconds)} of one core"


def _run_timed(name: str, study: Callable[[], Rows]) -> str:
    start = time.monotonic()
    rows = [row for row in study().read() if row["study"] == name]
    failed = sum(row.get("error") is not None for row in rows)
    return f"{name}: {len(rows)} rows, {failed} of them without a score, in {_write_time(time.monotonic() - start)}"


def _write_time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
