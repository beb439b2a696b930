"""The verb `tradeoff`."""

from dataclasses import dataclass
from pathlib import Path

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
from edge.cli.arguments import add_argument, add_option, flatten
from edge.core.errors import ConfigError
from edge.extras import needs

__all__ = ["tradeoff"]


@dataclass(frozen=True)
class TradeoffArguments:
    """What the command line says."""

    dataset: Path = add_argument(..., "the folder of presses, good ones and defective ones with masks")
    output: Path = add_option(
        Path("tradeoff"), "the folder for rows.jsonl and tradeoff.svg", "--output", "-o"
    )
    part: str | None = add_option(None, "the part; optional for a dataset of one part")
    position: str | None = add_option(None, "the position; optional for one position")
    method: list[str] | None = add_option(None, "a detector, again for more; by default every installed one")
    backbone: list[str] | None = add_option(
        None, "an installed backbone or a trunk .onnx file, the first varied in every axis, again for more"
    )
    within: str | None = add_option(
        None, "choose a point: most time from the settled frame to the verdict, such as 20ms"
    )
    under: str | None = add_option(None, "choose a point: largest bank, such as 8MB")
    presses: int | None = add_option(None, "choose a point: most nominal presses", min=1)
    point: str | None = add_option(None, "make only the bundle of the point of this name")
    bundle: Path | None = add_option(
        None, "where the chosen bundle is written, a folder or a name ending in .zip"
    )
    rounds: int = add_option(25, "rounds of timing", min=7)
    minutes: float = add_option(12.0, "after this many no new round of timing begins", min=0)
    bootstrap: int = add_option(200, "bootstrap replicates per accuracy interval", min=20)
    seed: int = add_option(0, "fixes every random choice", min=0)
    threads: int = add_option(2, "threads of the runtime", min=1, max=64)
    overwrite: bool = add_option(False, "measure again although the folder has rows; replace the bundle")

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
