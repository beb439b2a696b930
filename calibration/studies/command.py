"""The verb `study`: each study a command that can be interrupted and continued."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.studies.options import (
    Backbones,
    Cache,
    DaskAddress,
    DatasetFolder,
    Folder,
    HeldOutCount,
    Jobs,
    Methods,
    Modes,
    Parts,
    Position,
    Seeds,
    Splits,
    chosen_options,
)

if TYPE_CHECKING:
    from calibration.studies.rows import Rows
    from calibration.studies.stable import StableFractions

__all__ = ["study"]

study = typer.Typer(help="Study what accuracy costs, cell by cell.", no_args_is_help=True)

Fraction = Annotated[
    float | None,
    typer.Option(
        help="Share of the pool that every method learns from, in percent. Default: the stable fraction of each, from "
        "the good-fraction rows in the output folder; in paper mode the paper's own.",
        show_default=False,
    ),
]
Presses = Annotated[
    int, typer.Option(min=2, help="Nominal presses of the pool at most: 1280x720 takes memory and time.")
]


def _end(rows: "Rows", name: str) -> None:
    """Where the rows are, and how many cells have no score and why: of this study, also from earlier runs."""
    every = [row for row in rows.read() if row["study"] == name]
    errors = [str(row["error"]) for row in every if row.get("error") is not None]
    if errors:
        typer.echo(f"{len(errors)} of {len(every)} cells have no score, such as: {errors[0]}", err=True)
    typer.echo(f"rows: {rows.path}")


@study.callback()
def _group() -> None:
    """Study what accuracy costs, cell by cell."""


@study.command("good-fraction")
def good_fraction(
    dataset: DatasetFolder,
    output: Folder,
    part: Parts = None,
    position: Position = None,
    method: Methods = None,
    mode: Modes = None,
    backbone: Backbones = None,
    split: Splits = None,
    seeds: Seeds = 10,
    fractions: Annotated[
        str, typer.Option(help="Shares of the pool in percent: FIRST:LAST:STEP, a list, or 'none'.")
    ] = "5:100:5",
    shots: Annotated[str, typer.Option(help="Numbers of presses, or 'none'.")] = "1,2,4,8,16,32",
    held_out: HeldOutCount = 20,
    jobs: Jobs = 1,
    dask: DaskAddress = None,
    cache: Cache = None,
) -> None:
    """Accuracy by the number of nominal presses.

    The same command continues an interrupted study; finished cells are kept."""
    from calibration.studies.good_fraction_study import study_good_fraction
    from calibration.studies.numbers import parsed_counts, parsed_fractions

    options = chosen_options(
        dataset, output, part, position, method, mode, backbone, split, seeds, held_out, jobs, dask, cache
    )
    rows = study_good_fraction(
        options,
        fractions=parsed_fractions(fractions),
        shots=parsed_counts(shots, "--shots"),
    )
    _end(rows, "good-fraction")


@study.command("cross-position")
def cross_position(
    dataset: DatasetFolder,
    output: Folder,
    part: Parts = None,
    position: Position = None,
    target: Annotated[
        str | None, typer.Option(help="The other position; default: the second by name.", show_default=False)
    ] = None,
    fraction: Fraction = None,
    method: Methods = None,
    mode: Modes = None,
    backbone: Backbones = None,
    split: Splits = None,
    seeds: Seeds = 10,
    held_out: HeldOutCount = 20,
    jobs: Jobs = 1,
    dask: DaskAddress = None,
    cache: Cache = None,
) -> None:
    """Accuracy at a second position with few of its presses.

    Default parts: those with two positions. The same command continues an interrupted study."""
    from calibration.studies.cross_position_study import study_cross_position

    options = chosen_options(
        dataset, output, part, position, method, mode, backbone, split, seeds, held_out, jobs, dask, cache
    )
    _end(study_cross_position(options, _fractions(fraction, output), target), "cross-position")


@study.command("resolution")
def resolution(
    dataset: DatasetFolder,
    output: Folder,
    part: Parts = None,
    position: Position = None,
    presses: Presses = 40,
    view: Annotated[
        list[str] | None,
        typer.Option(
            help="lr, hr_tiled, lr_tiled, hr_full or lr_full; may be given several times. Default: all.",
            show_default=False,
        ),
    ] = None,
    fraction: Fraction = None,
    method: Methods = None,
    mode: Modes = None,
    backbone: Backbones = None,
    split: Splits = None,
    seeds: Seeds = 10,
    held_out: HeldOutCount = 20,
    jobs: Jobs = 1,
    dask: DaskAddress = None,
    cache: Cache = None,
) -> None:
    """Accuracy at 320x240 and 1280x720, and why it differs.

    Default parts: those with both resolutions. The same command continues an interrupted study."""
    from calibration.studies.resolution_study import study_resolution

    options = chosen_options(
        dataset, output, part, position, method, mode, backbone, split, seeds, held_out, jobs, dask, cache
    )
    _end(study_resolution(options, _fractions(fraction, output), _views(view), presses), "resolution")


@study.command("bad-presses")
def bad_presses(
    dataset: DatasetFolder,
    output: Folder,
    part: Parts = None,
    position: Position = None,
    fraction: Fraction = None,
    method: Methods = None,
    mode: Modes = None,
    backbone: Backbones = None,
    split: Splits = None,
    seeds: Seeds = 10,
    held_out: HeldOutCount = 20,
    jobs: Jobs = 1,
    dask: DaskAddress = None,
    cache: Cache = None,
) -> None:
    """Accuracy with damaged presses among the nominal ones.

    The same command continues an interrupted study."""
    from calibration.studies.bad_presses import study_bad_presses

    options = chosen_options(
        dataset, output, part, position, method, mode, backbone, split, seeds, held_out, jobs, dask, cache
    )
    _end(study_bad_presses(options, _fractions(fraction, output)), "bad-presses")


@study.command("all")
def every_study(
    dataset: DatasetFolder,
    output: Folder,
    part: Parts = None,
    presses: Presses = 40,
    method: Methods = None,
    mode: Modes = None,
    backbone: Backbones = None,
    split: Splits = None,
    seeds: Seeds = 10,
    held_out: HeldOutCount = 20,
    jobs: Jobs = 1,
    dask: DaskAddress = None,
    cache: Cache = None,
) -> None:
    """Every study in one command, and their pages.

    What the dataset has no presses for is left out, with a sentence. The same command continues."""
    from calibration.studies.every_study import study_all

    options = chosen_options(
        dataset, output, part, None, method, mode, backbone, split, seeds, held_out, jobs, dask, cache
    )
    for line in study_all(options, presses):
        typer.echo(line)


def _fractions(percent: float | None, output: Path) -> "StableFractions":
    from calibration.studies.stable import StableFractions
    from calibration.studies.study import ROWS_FILE
    from edge.core.errors import ConfigError

    if percent is not None and not 0 < percent <= 100:
        raise ConfigError(f"--fraction is a percentage above 0 up to 100, such as 40, found {percent:g}")
    return StableFractions(None if percent is None else percent / 100, output / ROWS_FILE)


def _views(given: list[str] | None) -> tuple[str, ...]:
    from calibration.studies.views import VIEWS
    from edge.core.errors import ConfigError
    from edge.core.suggest import suggestion

    for name in given or ():
        if name not in VIEWS:
            raise ConfigError(f"no view is named '{name}'; {suggestion(name, VIEWS)}")
    return tuple(dict.fromkeys(given or VIEWS))
