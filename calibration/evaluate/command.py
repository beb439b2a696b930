"""The verb `evaluate`."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["evaluate"]


def evaluate(
    bundle: Annotated[Path, typer.Argument(help="the bundle: a folder or a .zip")],
    dataset: Annotated[Path, typer.Argument(help="the folder of presses")],
    part: Annotated[str | None, typer.Option(help="the part, '*' for all; by default the bundle's")] = None,
    position: Annotated[
        str | None, typer.Option(help="the position, '*' for all; by default the bundle's")
    ] = None,
    limit: Annotated[float, typer.Option(help="false-positive rate up to which AU-PRO is integrated")] = 0.01,
    bootstrap: Annotated[
        int, typer.Option(help="bootstrap replicates per interval, 0 for none", min=0)
    ] = 1000,
    seed: Annotated[int, typer.Option(help="seed of the replicates", min=0)] = 0,
    json: Annotated[
        Path | None, typer.Option(help="write the report with every press to this JSON file")
    ] = None,
    sheet: Annotated[
        Path | None, typer.Option(help="write the worst and best score maps to this PNG")
    ] = None,
) -> None:
    """Score a bundle on a dataset: metrics and report.

    Image and pixel AUROC, AUPRC, AU-PRO and AUPIMO with intervals."""
    from calibration.evaluate.report import as_json, as_table, draw_sheet
    from calibration.evaluate.scoring import evaluate_bundle
    from calibration.folders import require_folder, write_atomically
    from calibration.progress import progress
    from edge.core.errors import ConfigError

    if not 0 < limit <= 1:
        raise ConfigError(f"--limit is a false-positive rate in (0, 1], found {limit}")
    for path in (json, sheet):
        require_folder(path)
    evaluation = evaluate_bundle(
        bundle,
        dataset,
        part=part,
        position=position,
        limit=limit,
        replicates=bootstrap,
        seed=seed,
        show=progress,
    )
    typer.echo(as_table(evaluation))
    if json is not None:
        write_atomically(json, as_json(evaluation).encode())
    if sheet is not None:
        write_atomically(sheet, draw_sheet(evaluation))
