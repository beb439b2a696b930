"""The studies by their names, and `gelgate lab study all`: every one into one file of rows, then their pages."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from calibration.experiments.harness.rows import TIMES, Rows, read_rows
from calibration.experiments.harness.study import ROWS_FILE, Options
from calibration.experiments.studies.bad_presses_study import study_bad_presses
from calibration.experiments.studies.cross_position_study import find_pairs, study_cross_position
from calibration.experiments.studies.good_fraction_study import study_good_fraction
from calibration.experiments.studies.report import write_report
from calibration.experiments.studies.resolution_study import fine_places, study_resolution
from edge.core.errors import DatasetError

__all__ = ["STUDIES", "study_all"]

STUDIES: Mapping[str, Callable[[Options], Rows]] = {
    "good-fraction": study_good_fraction,
    "cross-position": study_cross_position,
    "resolution": study_resolution,
    "bad-presses": study_bad_presses,
}
"""What runs each study, or continues it, in the order in which they need each other's rows."""

_PLACES: Mapping[str, Callable[[Options], object]] = {"cross-position": find_pairs, "resolution": fine_places}
"""What finds the places of a study that not every part has."""


def study_all(options: Options) -> Iterator[str]:
    """Run the studies one after the other; gives a line for each, with its time.

    A study for which the dataset has no presses, such as a second position, is left out with its sentence; the first
    one must run. Errors: as the studies.
    """
    began = time.monotonic()
    for name, study in STUDIES.items():
        start = time.monotonic()
        try:
            rows = [row for row in study(_fitting(options, name)).read() if row["study"] == name]
        except DatasetError as error:
            if name == "good-fraction":
                raise
            yield f"{name}: left out: {error}"
            continue
        failed = sum(row.get("error") is not None for row in rows)
        took = _write_time(time.monotonic() - start)
        yield f"{name}: {len(rows)} rows, {failed} of them without a score, in {took}"
    file = options.output / ROWS_FILE
    yield from (f"page: {page}" for page in write_report(file, options.output / "report"))
    yield f"all: {_write_time(time.monotonic() - began)}; {_spent(read_rows(file))}"


def _fitting(options: Options, study: str) -> Options:
    """The options with those of the given parts that a study can use. Errors: DatasetError where it can use none."""
    kept, refusal = [], None
    for part in options.parts:
        try:
            _PLACES.get(study, id)(replace(options, parts=(part,)))
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


def _write_time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
