"""The verb `study`: each study a command that can be interrupted and continued."""

from functools import partial
from typing import TYPE_CHECKING

import typer

from calibration.experiments.studies.options import StudyArguments, parse_counts, parse_fractions
from edge.cli.arguments import flatten

if TYPE_CHECKING:
    from calibration.experiments.harness.rows import Rows

__all__ = ["study"]

study = typer.Typer(help="Study what accuracy costs, cell by cell.", no_args_is_help=True)


def _end(rows: "Rows", name: str) -> None:
    """Say where the rows are, and how many cells have no score and why: of this study, also from earlier runs."""
    every = [row for row in rows.read() if row["study"] == name]
    errors = [str(row["error"]) for row in every if row.get("error") is not None]
    if errors:
        typer.echo(f"{len(errors)} of {len(every)} cells have no score, such as: {errors[0]}", err=True)
    typer.echo(f"rows: {rows.path}")


@study.callback()
def _group() -> None:
    """Study what accuracy costs, cell by cell."""


@study.command("good-fraction")
@partial(flatten, without=("target", "presses", "view", "fraction"))
def good_fraction(given: StudyArguments) -> None:
    """Accuracy by the number of nominal presses.

    The same command continues an interrupted study; finished cells are kept."""
    from calibration.experiments.studies.good_fraction_study import study_good_fraction

    rows = study_good_fraction(
        given.options(),
        fractions=parse_fractions(given.fractions),
        shots=parse_counts(given.shots, "--shots"),
    )
    _end(rows, "good-fraction")


@study.command("cross-position")
@partial(flatten, without=("presses", "view", "fractions", "shots"))
def cross_position(given: StudyArguments) -> None:
    """Accuracy at a second position with few of its presses.

    Default parts: those with two positions. The same command continues an interrupted study."""
    from calibration.experiments.studies.cross_position_study import study_cross_position

    _end(study_cross_position(given.options(), given.target), "cross-position")


@study.command("resolution")
@partial(flatten, without=("target", "fractions", "shots"))
def resolution(given: StudyArguments) -> None:
    """Accuracy at 320x240 and 1280x720, and why it differs.

    Default parts: those with both resolutions. The same command continues an interrupted study."""
    from calibration.experiments.studies.resolution_study import study_resolution

    _end(study_resolution(given.options(), given.view or (), given.presses), "resolution")


@study.command("bad-presses")
@partial(flatten, without=("target", "presses", "view", "fractions", "shots"))
def bad_presses(given: StudyArguments) -> None:
    """Accuracy with damaged presses among the nominal ones.

    The same command continues an interrupted study."""
    from calibration.experiments.studies.bad_presses_study import study_bad_presses

    _end(study_bad_presses(given.options()), "bad-presses")


@study.command("all")
@partial(flatten, without=("position", "target", "view", "fraction", "fractions", "shots"))
def every_study(given: StudyArguments) -> None:
    """Every study in one command, and their pages.

    What the dataset has no presses for is left out, with a sentence. The same command continues."""
    from calibration.experiments.studies.every_study import study_all

    for line in study_all(given.options(), given.presses):
        typer.echo(line)
