"""The verb `tradeoff`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calibration.tradeoff.options import (
    Backbones,
    Bootstrap,
    BundlePath,
    Check,
    DatasetFolder,
    Methods,
    Minutes,
    Output,
    Overwrite,
    Part,
    Peers,
    Picture,
    Point,
    Position,
    Presses,
    Rounds,
    Seed,
    Threads,
    Under,
    Within,
)

if TYPE_CHECKING:
    from calibration.tradeoff.point import OperatingPoint
    from calibration.tradeoff.presses import Chosen
    from calibration.tradeoff.run import RunSettings

__all__ = ["tradeoff"]

LOSS = 7
"""The exit code of `--check` where something became worse."""


def tradeoff(
    dataset: DatasetFolder,
    output: Output = Path("tradeoff"),
    part: Part = None,
    position: Position = None,
    method: Methods = None,
    backbone: Backbones = None,
    within: Within = None,
    under: Under = None,
    presses: Presses = None,
    point: Point = None,
    bundle: BundlePath = None,
    check: Check = None,
    picture: Picture = None,
    peers: Peers = False,
    rounds: Rounds = 25,
    minutes: Minutes = 12.0,
    bootstrap: Bootstrap = 200,
    seed: Seed = 0,
    threads: Threads = 2,
    overwrite: Overwrite = False,
) -> None:
    """Measure what accuracy costs: time, memory, presses.

    Some 80 operating points in one run: detectors, trunks, precisions, bank sizes, resolutions, numbers of presses.
    Writes a row for each and a page to explore them. With limits it chooses a point and writes its bundle. A folder
    that holds rows is not measured again; an interrupted run goes on.
    """
    from calibration.progress import progress
    from calibration.tradeoff.measured import measured_rows, points_of
    from calibration.tradeoff.pick import Limits, size, time_ms
    from calibration.tradeoff.run import RunSettings, presses_of
    from edge.extras import needs

    needs("studies", "tradeoff")
    if peers:
        _require_models()
    limits = Limits(time_ms(within) if within else None, size(under) if under else None, presses)
    is_choosing = bool(limits.names) or point is not None
    _check_options(output, bundle, overwrite, is_choosing, check)
    settings = RunSettings(
        dataset,
        part,
        position,
        seed=seed,
        threads=threads,
        rounds=rounds,
        replicates=bootstrap,
        minutes=minutes,
    )
    chosen = presses_of(settings)
    points = points_of(chosen, method, backbone)
    if point is not None:
        _write_bundle(point, points, chosen, settings, bundle or Path(point), overwrite, None)
        return
    rows = measured_rows(
        points, chosen, settings, output, overwrite=overwrite, with_peers=peers, show=progress, say=typer.echo
    )
    _report(rows, output, picture)
    if limits.names:
        _choose(rows, limits, points, chosen, settings, bundle or output / "bundle", overwrite)
    if check is not None:
        _check(rows, check)


def _require_models() -> None:
    from calibration.tradeoff.peers import require_models

    require_models()


def _check_options(
    output: Path, bundle: Path | None, overwrite: bool, is_choosing: bool, check: Path | None
) -> None:
    """Before any work. Errors: ConfigError."""
    from calibration.tradeoff.rows import read_rows
    from edge.core.errors import ConfigError

    if bundle is not None and not is_choosing:
        raise ConfigError("--bundle needs a point: give limits (--within, --under, --presses) or --point")
    if bundle is not None and bundle.exists() and not overwrite:
        raise ConfigError(f"{bundle} exists already; choose another name or add --overwrite")
    if output.exists() and not output.is_dir():
        raise ConfigError(f"--output {output} is a file; name a folder")
    if check is not None:
        read_rows(check)


def _report(rows: list[dict[str, Any]], output: Path, picture: Path | None) -> None:
    """The page, the picture where wanted, and a table of the front."""
    from calibration.evaluate.report import write_atomically
    from calibration.tradeoff.measured import write_page
    from calibration.tradeoff.table import table

    page = write_page(rows, output)
    if picture is not None:
        from calibration.tradeoff.figure import svg

        write_atomically(picture, svg(rows))
    typer.echo(table(rows))
    typer.echo(f"{len(rows)} points; the page is {page}")


def _choose(
    rows: list[dict[str, Any]],
    limits: Any,
    points: "tuple[OperatingPoint, ...]",
    chosen: "Chosen",
    settings: "RunSettings",
    bundle: Path,
    overwrite: bool,
) -> None:
    from calibration.tradeoff.pick import pick
    from edge.core.errors import ConfigError

    picked = pick(rows, limits)
    if picked.row is None:
        raise ConfigError(picked.reasons[0])
    typer.echo("\n".join(picked.reasons))
    _write_bundle(picked.row["key"], points, chosen, settings, bundle, overwrite, picked.row)


def _write_bundle(
    key: str,
    points: "tuple[OperatingPoint, ...]",
    chosen: "Chosen",
    settings: "RunSettings",
    bundle: Path,
    overwrite: bool,
    row: dict[str, Any] | None,
) -> None:
    """Fit the point and write its bundle; says so where its bank differs from the measured one."""
    from calibration.fitting.command import refuse_existing, summary, write
    from calibration.progress import Stages
    from calibration.tradeoff.chosen_bundle import bundle_of, point_of

    found = point_of(key, points)
    refuse_existing(bundle, overwrite)
    with Stages() as report:
        fitted = bundle_of(found, chosen, settings, row=row, report=report)
    made = fitted.manifest.facts["tradeoff"]["content_sha256"]
    if row is not None and made != row["content_sha256"]:
        typer.echo(
            "warning: the fit gave its bank more room than the measured point had; the accuracy in the bundle is its "
            "own, the times are the measured point's",
            err=True,
        )
    write(fitted, bundle, overwrite)
    summary(fitted, bundle)
    typer.echo(f"trunk, head and bank: {made}")


def _check(rows: list[dict[str, Any]], earlier: Path) -> None:
    from calibration.tradeoff.check import check, same_front
    from calibration.tradeoff.rows import read_rows

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
