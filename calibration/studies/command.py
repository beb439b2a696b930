"""The verb `study`: the paper's validations, each a command that can be interrupted and continued."""

from typing import Annotated

import typer

from calibration.studies.further_commands import bad_presses, cross_position, every_study, resolution
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
)

__all__ = ["study"]

study = typer.Typer(help="Study what accuracy costs, cell by cell.", no_args_is_help=True)


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
    from calibration.studies.study import Options, as_modes, as_splits

    study_good_fraction(
        Options(
            dataset=dataset,
            output=output,
            cache=cache,
            parts=tuple(part or ()),
            position=position,
            methods=tuple(method or ()),
            modes=as_modes(mode or ()),
            backbones=tuple(backbone or ()),
            splits=as_splits(split or ()),
            seeds=seeds,
            held_out=held_out,
            jobs=jobs,
            dask=dask,
        ),
        fractions=parsed_fractions(fractions),
        shots=parsed_counts(shots, "--shots"),
    )
    typer.echo(f"rows: {output / 'rows.jsonl'}")


study.command("cross-position")(cross_position)
study.command("resolution")(resolution)
study.command("bad-presses")(bad_presses)
study.command("all")(every_study)
