"""The options that the studies have in common, each with its help."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calibration.studies.study import Options

__all__ = [
    "Backbones",
    "Cache",
    "DaskAddress",
    "DatasetFolder",
    "Folder",
    "HeldOutCount",
    "Jobs",
    "Methods",
    "Modes",
    "Parts",
    "Position",
    "Seeds",
    "Splits",
    "chosen_options",
]

DatasetFolder = Annotated[Path, typer.Argument(help="The folder of presses, nominal and defective.")]
Folder = Annotated[
    Path,
    typer.Option("--output", "-o", help="Output folder: rows.jsonl and the report; new, or one to continue."),
]
Parts = Annotated[
    list[str] | None,
    typer.Option(
        "--part", help="A part; may be given several times. Default: all of the dataset.", show_default=False
    ),
]
Position = Annotated[
    str | None,
    typer.Option(help="The reference position; default: each part's first by name.", show_default=False),
]
Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        help="A detector; may be given several times. Default: all but the baselines.",
        show_default=False,
    ),
]
Modes = Annotated[
    list[str] | None,
    typer.Option(
        "--mode", help="corrected or paper; may be given twice. Default: corrected.", show_default=False
    ),
]
Backbones = Annotated[
    list[str] | None,
    typer.Option(
        "--backbone",
        help="An installed backbone, or a trunk .onnx file; may be given several times. Default: tactile_resnet18.",
        show_default=False,
    ),
]
Splits = Annotated[
    list[str] | None,
    typer.Option(
        "--split",
        help="How test presses are held out: press (one by one, as in the paper) or specimen (all presses of a piece "
        "together); may be given twice. Default: press.",
        show_default=False,
    ),
]
Seeds = Annotated[int, typer.Option(min=1, max=1000, help="Repetitions, each with other training presses.")]
HeldOutCount = Annotated[int, typer.Option("--held-out", min=1, help="Nominal presses kept for the test.")]
Jobs = Annotated[int, typer.Option(min=1, max=256, help="Processes on this machine.")]
DaskAddress = Annotated[
    str | None,
    typer.Option("--dask", help="Address of a Dask scheduler, such as tcp://host:8786.", show_default=False),
]
Cache = Annotated[
    Path | None,
    typer.Option(
        help="Folder of extracted features; default: 'features' in the output folder.", show_default=False
    ),
]


def chosen_options(
    dataset: Path,
    output: Path,
    part: list[str] | None,
    position: str | None,
    method: list[str] | None,
    mode: list[str] | None,
    backbone: list[str] | None,
    split: list[str] | None,
    seeds: int,
    held_out: int,
    jobs: int,
    dask: str | None,
    cache: Path | None,
) -> "Options":
    """What was given on the command line. Errors: ConfigError for an unknown mode or split."""
    from calibration.studies.study import Options, as_modes, as_splits

    return Options(
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
    )
