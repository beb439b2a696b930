"""The verb `tradeoff`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calibration.experiments.tradeoff.options import TradeoffArguments
from edge.cli.arguments import flatten

if TYPE_CHECKING:
    from calibration.experiments.tradeoff.plan import Run

__all__ = ["tradeoff"]

LOSS = 7
"""The exit code of `--check` where something became worse."""


@flatten
def tradeoff(given: TradeoffArguments) -> None:
    """Measure what accuracy costs: time, memory, presses.

    Some 80 operating points in one run: detectors, trunks, precisions, bank sizes, resolutions, numbers of presses.
    Writes a row for each and a page to explore them. With limits it chooses a point and writes its bundle. A folder
    that holds rows is not measured again; an interrupted run goes on.
    """
    from calibration.experiments.tradeoff.pick import pick
    from calibration.experiments.tradeoff.plan import Run
    from calibration.experiments.tradeoff.run import read_or_measure
    from calibration.progress import progress
    from edge.core.errors import ConfigError
    from edge.extras import needs

    needs("studies", "tradeoff")
    limits = given.limits()
    _require_sense(given, bool(limits.names))
    run = Run.of(given.settings(), given.method or (), given.backbone or ())
    if given.point is not None:
        _write_bundle(given.point, run, given.bundle or Path(given.point), given.overwrite)
        return
    rows = read_or_measure(run, given.output, given.overwrite, progress, typer.echo)
    _report(rows, given.output, given.picture)
    if limits.names:
        picked = pick(rows, limits)
        if picked.row is None:
            raise ConfigError(picked.reasons[0])
        typer.echo("\n".join(picked.reasons))
        bundle = given.bundle or given.output / "bundle"
        _write_bundle(picked.row["key"], run, bundle, given.overwrite, picked.row)
    if given.check is not None:
        _check(rows, given.check)


def _require_sense(given: TradeoffArguments, has_limits: bool) -> None:
    """Check the options before any work. Errors: ConfigError."""
    from calibration.experiments.tradeoff.rows import read_rows
    from edge.core.errors import ConfigError

    if given.bundle is not None and not has_limits and given.point is None:
        raise ConfigError("--bundle needs a point: give limits (--within, --under, --presses) or --point")
    if given.bundle is not None and given.bundle.exists() and not given.overwrite:
        raise ConfigError(f"{given.bundle} exists already; choose another name or add --overwrite")
    if given.output.exists() and not given.output.is_dir():
        raise ConfigError(f"--output {given.output} is a file; name a folder")
    if given.check is not None:
        read_rows(given.check)


def _report(rows: list[dict[str, Any]], output: Path, picture: Path | None) -> None:
    """Write the page, and the picture where wanted; print the front."""
    from calibration.evaluate.report import write_atomically
    from calibration.experiments.tradeoff.figure import svg
    from calibration.experiments.tradeoff.page import table, write_page

    page = write_page(rows, output)
    if picture is not None:
        write_atomically(picture, svg(rows))
    typer.echo(table(rows))
    typer.echo(f"{len(rows)} points; the page is {page}")


def _write_bundle(
    key: str, run: "Run", bundle: Path, overwrite: bool, row: dict[str, Any] | None = None
) -> None:
    """Fit the point and write its bundle; says so where its bank differs from the measured one, `row`."""
    from calibration.experiments.tradeoff.chosen_bundle import bundle_of
    from calibration.fitting.command import refuse_existing, summarise, write
    from calibration.progress import Stages

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


def _check(rows: list[dict[str, Any]], earlier: Path) -> None:
    from calibration.experiments.tradeoff.check import check, same_front
    from calibration.experiments.tradeoff.rows import read_rows

    before = read_rows(earlier)
    losses, remarks = check(before, rows)
    for line in (*remarks, *losses):
        typer.echo(line, err=True)
    typer.echo(
        f"{100 * same_front(before, rows):.0f} % of the points are on the front in both runs or in neither"
    )
    if losses:
        typer.echo(f"{len(losses)} {'loss' if len(losses) == 1 else 'losses'} against {earlier}", err=True)
        raise typer.Exit(LOSS)
    typer.echo(f"no loss against {earlier}")
