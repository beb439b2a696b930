"""The verb `tradeoff`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from calibration.experiments.tradeoff.chosen_bundle import bundle_of
from calibration.experiments.tradeoff.figure import say_cost, svg
from calibration.experiments.tradeoff.front import table
from calibration.experiments.tradeoff.pick import pick, read_limits
from calibration.experiments.tradeoff.plan import Run, RunSettings
from calibration.experiments.tradeoff.rows import Row
from calibration.experiments.tradeoff.run import read_or_measure
from calibration.fitting.command import refuse_existing, summarise, write
from calibration.folders import write_atomically
from calibration.progress import Stages, progress
from edge.cli.arguments import flatten
from edge.core.errors import ConfigError
from edge.extras import needs

__all__ = ["tradeoff"]


@dataclass(frozen=True)
class TradeoffArguments:
    """What the command line says."""

    dataset: Annotated[
        Path, typer.Argument(help="the folder of presses, good ones and defective ones with masks")
    ]
    output: Annotated[
        Path, typer.Option("--output", "-o", help="the folder for rows.jsonl and tradeoff.svg")
    ] = Path("tradeoff")
    part: Annotated[str | None, typer.Option(help="the part; optional for a dataset of one part")] = None
    position: Annotated[str | None, typer.Option(help="the position; optional for one position")] = None
    method: Annotated[
        list[str] | None, typer.Option(help="a detector, again for more; by default every installed one")
    ] = None
    backbone: Annotated[
        list[str] | None,
        typer.Option(
            help="an installed backbone or a trunk .onnx file, the first varied in every axis, again for more"
        ),
    ] = None
    within: Annotated[
        str | None,
        typer.Option(help="choose a point: most time from the settled frame to the verdict, such as 20ms"),
    ] = None
    under: Annotated[str | None, typer.Option(help="choose a point: largest bank, such as 8MB")] = None
    presses: Annotated[int | None, typer.Option(help="choose a point: most nominal presses", min=1)] = None
    point: Annotated[str | None, typer.Option(help="make only the bundle of the point of this name")] = None
    bundle: Annotated[
        Path | None,
        typer.Option(help="where the chosen bundle is written, a folder or a name ending in .zip"),
    ] = None
    rounds: Annotated[int, typer.Option(help="rounds of timing", min=7)] = 25
    minutes: Annotated[float, typer.Option(help="after this many no new round of timing begins", min=0)] = (
        12.0
    )
    bootstrap: Annotated[int, typer.Option(help="bootstrap replicates per accuracy interval", min=20)] = 200
    seed: Annotated[int, typer.Option(help="fixes every random choice", min=0)] = 0
    threads: Annotated[int, typer.Option(help="threads of the runtime", min=1, max=64)] = 2
    overwrite: Annotated[
        bool, typer.Option(help="measure again although the folder has rows; replace the bundle")
    ] = False

    def settings(self) -> RunSettings:
        """Return what the run depends on."""
        named = {name: getattr(self, name) for name in ("seed", "threads", "rounds", "minutes")}
        return RunSettings(self.dataset, self.part, self.position, replicates=self.bootstrap, **named)


@flatten
def tradeoff(given: TradeoffArguments) -> None:
    """Measure what accuracy costs: time, memory, presses.

    Some 80 operating points in one run: detectors, trunks, precisions, bank sizes, resolutions, numbers of presses.
    Writes a row for each and a picture of them. With limits it chooses a point and writes its bundle. A folder
    that holds rows is not measured again; an interrupted run goes on.
    """
    needs("studies", "tradeoff")
    limits = read_limits(given.within, given.under, given.presses)
    _require_sense(given, bool(limits))
    run = Run.of(given.settings(), given.method or (), given.backbone or ())
    if given.point is not None:
        _write_bundle(given.point, run, given.bundle or Path(given.point), given.overwrite)
        return
    rows = read_or_measure(run, given.output, given.overwrite, progress, typer.echo)
    picture = given.output / "tradeoff.svg"
    write_atomically(picture, svg(rows))
    typer.echo(f"{table(rows)}\n{say_cost(rows)}\n{len(rows)} points; the picture is {picture}")
    if limits:
        picked = pick(rows, limits)
        if picked.row is None:
            raise ConfigError(picked.reasons[0])
        typer.echo("\n".join(picked.reasons))
        bundle = given.bundle or given.output / "bundle"
        _write_bundle(picked.row["key"], run, bundle, given.overwrite, picked.row)


def _require_sense(given: TradeoffArguments, has_limits: bool) -> None:
    """Check the options before any work. Errors: ConfigError."""
    if given.bundle is not None and not has_limits and given.point is None:
        raise ConfigError("--bundle needs a point: give limits (--within, --under, --presses) or --point")
    if given.bundle is not None and given.bundle.exists() and not given.overwrite:
        raise ConfigError(f"{given.bundle} exists already; choose another name or add --overwrite")
    if given.output.exists() and not given.output.is_dir():
        raise ConfigError(f"--output {given.output} is a file; name a folder")


def _write_bundle(key: str, run: Run, bundle: Path, overwrite: bool, row: Row | None = None) -> None:
    """Fit the point and write its bundle; says so where its bank differs from the measured one, `row`."""
    point = run.point(key)
    refuse_existing(bundle, overwrite)
    with Stages() as report:
        fitted = bundle_of(point, run, row=row, report=report)
    made = fitted.manifest.facts["tradeoff"]["content_sha256"]
    if row is not None and made != row["content_sha256"]:
        typer.echo(
            "warning: the fit gave its bank more room than the measured point had; the accuracy in the bundle is its "
            "own, the times are the measured point's",
            err=True,
        )
    write(fitted, bundle, overwrite)
    summarise(fitted, bundle)
    typer.echo(f"trunk, head and bank: {made}")
