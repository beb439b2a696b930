"""The verb `train-backbone`."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["train_backbone"]


def train_backbone(
    out: Annotated[Path, typer.Argument(help="folder of the run: checkpoints, log and loss figure")],
    resume: Annotated[bool, typer.Option(help="carry on the run in that folder")] = False,
    start: Annotated[
        Path | None, typer.Option(help="begin with the weights of the run in that folder")
    ] = None,
    steps: Annotated[int, typer.Option(help="optimiser steps", min=1)] = 1800,
    pairs: Annotated[int, typer.Option(help="pairs per step", min=1)] = 64,
    side: Annotated[int, typer.Option(help="pixels per side of a frame, a multiple of 32", min=64)] = 224,
    seed: Annotated[int, typer.Option(help="seed of weights and presses", min=0)] = 0,
    geometry: Annotated[float, typer.Option(help="weight of reading slopes and depth", min=0)] = 1.0,
    pair: Annotated[float, typer.Option(help="weight of pulling and pushing pairs", min=0)] = 1.0,
    rank: Annotated[float, typer.Option(help="weight of ranking changes above one per cent", min=0)] = 0.5,
    window_mm: Annotated[
        float, typer.Option(help="half width of the window where a cell's partner is looked for", min=0)
    ] = 0.5,
    finest_weight: Annotated[float, typer.Option(help="weight of layer1 beside 1 of each other stage")] = 2.0,
    distance: Annotated[str, typer.Option(help="between features: euclidean or cosine")] = "euclidean",
    max_rate: Annotated[float, typer.Option(help="peak of the one-cycle learning rate")] = 2e-3,
    high_resolution: Annotated[
        float, typer.Option(help="share of batches at the spacing of 1280x720", min=0, max=1)
    ] = 0.25,
    precision: Annotated[
        str, typer.Option(help="bfloat16, float32, or, with --start, int8: rounded as that variant")
    ] = "bfloat16",
    minutes: Annotated[float, typer.Option(help="stop and save after so long, 0 for never", min=0)] = 0.0,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda")] = "auto",
    threads: Annotated[int, typer.Option(help="of the CPU, for learning; 0 for torch's choice", min=0)] = 1,
    ahead: Annotated[bool, typer.Option(help="on a CPU, draw the next presses in a second process")] = True,
    package: Annotated[
        Path | None, typer.Option(help="when done, write the ONNX trunks and the card here")
    ] = None,
) -> None:
    """Train the touch backbone on simulated presses; interrupt at any time and resume."""
    import sys
    from typing import Any

    from calibration.progress import progress
    from edge.core.errors import ConfigError

    try:
        from calibration.training.checkpoint import weights_sha256
        from calibration.training.recipe import Recipe
        from calibration.training.train import Run, train
    except ImportError as error:
        raise ConfigError(
            f"train-backbone needs torch, found {error}; pip install 'gelgate[train]'"
        ) from error
    settings: dict[str, Any] = {
        "steps": steps,
        "pairs": pairs,
        "side": side,
        "seed": seed,
        "geometry_weight": geometry,
        "pair_weight": pair,
        "rank_weight": rank,
        "window_mm": window_mm,
        "finest_weight": finest_weight,
        "distance": distance,
        "max_rate": max_rate,
        "high_resolution": high_resolution,
        "start": weights_sha256(start) if start else "",
        "precision": precision,
    }
    run = Run(
        out,
        resume=out if resume else None,
        minutes=minutes,
        device=device,
        threads=threads,
        is_drawn_ahead=ahead,
        start=start,
    )
    recipe = Recipe(**settings)
    if sys.stderr.isatty():
        with progress("training", steps) as advance:
            train(recipe, run, say=lambda _: None, advance=advance)
    else:
        train(recipe, run)
    if package is not None:
        from calibration.benchmark.model_card import write_card
        from calibration.training.package import package as make

        make(out, package)
        write_card(package)
