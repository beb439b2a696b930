"""The verb `train-backbone`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calibration.training.train import TrainingRun
    from calibration.training.train_config import TrainConfig

__all__ = ["train_backbone"]


def train_backbone(
    out: Annotated[Path, typer.Argument(help="folder of the run: checkpoints, log and loss figure")],
    resume: Annotated[bool, typer.Option(help="continue the run in that folder")] = False,
    start: Annotated[
        Path | None, typer.Option(help="start from the weights of the run in that folder")
    ] = None,
    recipe: Annotated[
        Path | None,
        typer.Option(help="a TOML file of settings; others are as in the run that ships"),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="one setting, over the file's; docs/backbone.md lists them"
        ),
    ] = None,
    minutes: Annotated[float, typer.Option(help="stop and save after this time, 0 for never", min=0)] = 0.0,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda")] = "auto",
    threads: Annotated[int, typer.Option(help="of the CPU, for learning; 0 for torch's choice", min=0)] = 1,
    ahead: Annotated[bool, typer.Option(help="on a CPU, draw the next presses in a second process")] = True,
    package: Annotated[
        Path | None, typer.Option(help="when done, write the ONNX trunks and their facts here")
    ] = None,
) -> None:
    """Train the tactile backbone on simulated presses. An interrupted run can be resumed."""
    from edge.extras import needs

    needs("train", "train-backbone")
    from calibration.training.train import TrainingRun

    run = TrainingRun(
        out,
        resume=out if resume else None,
        minutes=minutes,
        device=device,
        threads=threads,
        is_drawn_ahead=ahead,
        start=start,
    )
    _train(_recipe(recipe, settings or [], start), run)
    if package is not None:
        from calibration.training.package import package as make

        make(out, package)


def _recipe(file: Path | None, settings: list[str], start: Path | None) -> "TrainConfig":
    """The run that ships, with the changes of the file and of the command line. Errors: ConfigError."""
    from calibration.training.checkpoint import weights_sha256
    from calibration.training.train_config import TrainConfig
    from edge.cli.arguments import parse_values

    changes = (TrainConfig.read(file) if file else {}) | parse_values("--set", settings)
    if start:
        changes["start"] = weights_sha256(start)
    return TrainConfig.shipped(**changes)


def _train(recipe: "TrainConfig", run: "TrainingRun") -> None:
    import sys

    from calibration.progress import progress
    from calibration.training.train import train

    if not sys.stderr.isatty():
        train(recipe, run)
        return
    with progress("training", recipe.steps) as advance:
        train(recipe, run, say=lambda _: None, advance=advance)
