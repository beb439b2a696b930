"""The verb `study`: each study a command that can be interrupted and continued, and all of them into one file."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import typer

from calibration.experiments.harness.rows import TIMES, Rows, read_rows
from calibration.experiments.harness.study import ROWS_FILE, Options
from calibration.experiments.studies.bad_presses_study import study_bad_presses
from calibration.experiments.studies.cross_position_study import find_pairs, study_cross_position
from calibration.experiments.studies.good_fraction_study import study_good_fraction
from calibration.experiments.studies.report import write_report
from calibration.experiments.studies.resolution_study import fine_places, study_resolution
from edge.cli.arguments import add_argument, add_option, flatten
from edge.core.errors import ConfigError, DatasetError

__all__ = ["study", "study_all"]

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


@dataclass(frozen=True)
class StudyArguments:
    """What the command line says."""

    dataset: Path = add_argument(..., "The folder of presses, nominal and defective.")
    output: Path = add_option(
        ..., "Output folder: rows.jsonl and the report; new, or one to continue.", "--output", "-o"
    )
    parts: list[str] | None = add_option(
        None, "A part; may be given several times. Default: all of the dataset.", "--part", show_default=False
    )
    position: str | None = add_option(
        None, "The reference position; default: each part's first by name.", show_default=False
    )
    target: str | None = add_option(
        None, "The other position; default: the second by name.", show_default=False
    )
    presses: int = add_option(
        40, "Nominal presses of the pool at most: 1280x720 takes memory and time.", min=2
    )
    views: list[str] | None = add_option(
        None,
        "lr, hr_tiled, lr_tiled, hr_full or lr_full; may be given several times. Default: all.",
        "--view",
        show_default=False,
    )
    fraction: float | None = add_option(
        None,
        "Share of the pool that every method learns from, in percent. Default: the stable fraction of each, "
        "from the good-fraction rows in the output folder; in paper mode the paper's own.",
        show_default=False,
    )
    methods: list[str] | None = add_option(
        None,
        "A detector; may be given several times. Default: all but the baselines.",
        "--method",
        show_default=False,
    )
    modes: list[str] | None = add_option(
        None, "corrected or paper; may be given twice. Default: corrected.", "--mode", show_default=False
    )
    backbones: list[str] | None = add_option(
        None,
        "An installed backbone, or a trunk .onnx file; may be given several times. Default: tactile_resnet18.",
        "--backbone",
        show_default=False,
    )
    splits: list[str] | None = add_option(
        None,
        "How test presses are held out: press (one by one, as in the paper) or specimen (all presses of a piece "
        "together); may be given twice. Default: press.",
        "--split",
        show_default=False,
    )
    seeds: int = add_option(10, "Repetitions, each with other training presses.", min=1, max=1000)
    fractions: str = add_option(
        "5:100:5", "Shares of the pool in percent: FIRST:LAST:STEP, a list, or 'none'."
    )
    shots: str = add_option("1,2,4,8,16,32", "Numbers of presses, or 'none'.")
    held_out: int = add_option(20, "Nominal presses kept for the test.", min=1)
    jobs: int = add_option(1, "Processes on this machine.", min=1, max=256)
    dask: str | None = add_option(
        None, "Address of a Dask scheduler, such as tcp://host:8786.", show_default=False
    )
    cache: Path | None = add_option(
        None, "Folder of extracted features; default: 'features' in the output folder.", show_default=False
    )

    def options(self) -> Options:
        """Return what is asked of the study. Errors: ConfigError, as `Options`, and for an impossible fraction."""
        if self.fraction is not None and not 0 < self.fraction <= 100:
            raise ConfigError(
                f"--fraction is a percentage above 0 up to 100, such as 40, found {self.fraction:g}"
            )
        given: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in vars(self).items()
            if value is not None
        }
        share = None if self.fraction is None else self.fraction / 100
        fractions, shots = parse_fractions(self.fractions), parse_shots(self.shots)
        given |= {"fraction": share, "fractions": fractions, "shots": shots}
        return Options(**given)


def parse_fractions(text: str) -> tuple[float, ...]:
    """Return shares in (0, 1] from percentages: `5:100:5`, `5,10,20`, or `none`. Errors: ConfigError."""
    try:
        percent = _parse(text)
    except ValueError:
        percent = [math.nan]
    if not all(0 < value <= 100 for value in percent):
        raise ConfigError(
            f"--fractions are percentages above 0 up to 100, such as 5:100:5 or 5,10,20, found '{text}'"
        )
    return tuple(sorted({round(value / 100, 6) for value in percent}))


def parse_shots(text: str) -> tuple[int, ...]:
    """Return whole numbers of at least 1: `1,2,4`, or `none`. Errors: ConfigError."""
    try:
        counts = _parse(text)
    except ValueError:
        counts = [0]
    if not all(value >= 1 and value.is_integer() for value in counts):
        raise ConfigError(f"--shots are whole numbers of at least 1, such as 1,2,4, found '{text}'")
    return tuple(sorted({int(value) for value in counts}))


def _parse(text: str) -> list[float]:
    """Return the numbers of a list or a range, at least one; none for `none`. Errors: ValueError."""
    if text.strip() == "none":
        return []
    if ":" not in text:
        return [float(word) for word in text.split(",")]
    first, last, step = (float(word) for word in text.split(":"))
    if step <= 0 or first > last:
        raise ValueError(text)
    return [first + k * step for k in range(int((last - first) / step + 1e-9) + 1)]


study = typer.Typer(help="Study what accuracy costs, cell by cell.", no_args_is_help=True)

_VERBS = {
    "good-fraction": (
        "Accuracy by the number of nominal presses.\n\n"
        "The same command continues an interrupted study; finished cells are kept.",
        ("target", "presses", "views", "fraction"),
    ),
    "cross-position": (
        "Accuracy at a second position with few of its presses.\n\nDefault parts: those with two positions. "
        "The same command continues an interrupted study.",
        ("presses", "views", "fractions", "shots"),
    ),
    "resolution": (
        "Accuracy at 320x240 and 1280x720, and why it differs.\n\nDefault parts: those with both resolutions. "
        "The same command continues an interrupted study.",
        ("target", "fractions", "shots"),
    ),
    "bad-presses": (
        "Accuracy with damaged presses among the nominal ones.\n\n"
        "The same command continues an interrupted study.",
        ("target", "presses", "views", "fractions", "shots"),
    ),
}
"""What a study's help says, and the options that it has no use for."""


def _add(name: str, text: str, without: tuple[str, ...]) -> None:
    """Add the command of a study; it says where the rows are, and how many of its cells have no score and why."""

    def verb(given: StudyArguments) -> None:
        rows = STUDIES[name](given.options())
        every = [row for row in rows.read() if row["study"] == name]
        errors = [str(row["error"]) for row in every if row.get("error") is not None]
        if errors:
            typer.echo(f"{len(errors)} of {len(every)} cells have no score, such as: {errors[0]}", err=True)
        typer.echo(f"rows: {rows.path}")

    verb.__doc__ = text
    study.command(name)(flatten(verb, without))


for _name, (_text, _without) in _VERBS.items():
    _add(_name, _text, _without)


def _study_all(given: StudyArguments) -> None:
    """Every study in one command, and their pages.

    What the dataset has no presses for is left out, with a sentence. The same command continues."""
    for line in study_all(given.options()):
        typer.echo(line)


study.command("all")(flatten(_study_all, ("position", "target", "views", "fraction", "fractions", "shots")))
