"""The verb `tradeoff`, and the bundle of one point, with its accuracy and cost cards in the manifest."""

import datetime
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import typer

from calibration.experiments.tradeoff.accuracy import measure_accuracy
from calibration.experiments.tradeoff.figure import say_cost, svg
from calibration.experiments.tradeoff.fitting import content_sha256, detector_of, trunk_of
from calibration.experiments.tradeoff.front import Row, pick, read_limits, table
from calibration.experiments.tradeoff.plan import Run, TradeoffArguments
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint
from calibration.experiments.tradeoff.presses import on_common_grid
from calibration.experiments.tradeoff.run import read_or_measure
from calibration.fitting.command import refuse_existing, summarise
from calibration.fitting.fit import FitConfig, Fitted, fit_files
from calibration.folders import write_atomically
from calibration.progress import Stages, progress
from edge.cli.arguments import flatten
from edge.core.errors import ConfigError
from edge.extras import needs
from edge.model.archive import MANIFEST
from edge.model.bundle_writer import manifest_bytes
from edge.model.scorer import Scorer

__all__ = ["bundle_of", "tradeoff"]


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
    run = Run.of(given)
    if given.point is not None:
        _write_bundle(given.point, run, given.bundle or Path(given.point))
        return
    rows = read_or_measure(run, progress, typer.echo)
    picture = given.output / "tradeoff.svg"
    write_atomically(picture, svg(rows))
    typer.echo(f"{table(rows)}\n{say_cost(rows)}\n{len(rows)} points; the picture is {picture}")
    if limits:
        row, reasons = pick(rows, limits)
        typer.echo("\n".join(reasons))
        _write_bundle(row["key"], run, given.bundle or given.output / "bundle", row)


def _require_sense(given: TradeoffArguments, has_limits: bool) -> None:
    """Check the options before any work. Errors: ConfigError."""
    if given.bundle is not None and not has_limits and given.point is None:
        raise ConfigError("--bundle needs a point: give limits (--within, --under, --presses) or --point")
    if given.bundle is not None and given.bundle.exists() and not given.overwrite:
        raise ConfigError(f"{given.bundle} exists already; choose another name or add --overwrite")
    if given.output.exists() and not given.output.is_dir():
        raise ConfigError(f"--output {given.output} is a file; name a folder")


def _write_bundle(key: str, run: Run, bundle: Path, row: Row | None = None) -> None:
    """Fit the point and write its bundle; says so where its bank differs from the measured one, `row`."""
    point = run.point(key)
    refuse_existing(bundle, run.given.overwrite)
    with Stages() as report:
        fitted = bundle_of(point, run, row=row, report=report)
    made = fitted.manifest.facts["tradeoff"]["content_sha256"]
    if row is not None and made != row["content_sha256"]:
        typer.echo(
            "warning: the fit gave its bank more room than the measured point had; the accuracy in the bundle is its "
            "own, the times are the measured point's",
            err=True,
        )
    fitted.write(bundle, overwrite=run.given.overwrite)
    summarise(fitted, bundle)
    typer.echo(f"trunk, head and bank: {made}")


_COST = (
    "stages", "floor", "bank_bytes", "peak_memory_bytes", "fit_s", "gel_share", "scored", "machine"
)  # fmt: skip
"""The columns of a row that go into the cost card."""


def bundle_of(
    point: OperatingPoint,
    run: Run,
    *,
    row: Row | None = None,
    report: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Fitted:
    """Fit the point's bundle and measure its accuracy again with the bundle itself.

    row: the measured point, whose times and fingerprint go into the manifest as its cost card. Errors: FitError.
    """
    view, chosen, threads = VIEWS[point.view], run.chosen, run.given.threads
    config = FitConfig(
        part=chosen.every.part,
        position=chosen.every.position,
        profile=view.profile,
        region=view.region,
        detector=detector_of(point)[0],
        trunk=trunk_of(point),
        mode=point.mode,
        overrides=point.overrides,
        seed=run.given.seed,
        threads=threads,
        is_scattered=True,
        limit="plain",  # as the point was measured
    )
    presses = chosen.read_nominal(view).first(point.presses)
    fitted = fit_files(presses, config, created=datetime.date.today().isoformat(), report=report)
    scorer = Scorer(fitted.bundle(), threads)
    scored = [scorer.score(frame) for frame in chosen.read(chosen.scored, view)]
    maps, scores = [on_common_grid(one.score_map) for one in scored], [one.anomaly_score for one in scored]
    accuracy = {
        name if part == "value" else f"{name}_{part}": value
        for name, one in measure_accuracy(maps, np.array(scores), run.truth).items()
        for part, value in one.items()
        if value is not None
    }
    card = {"point": point.key, "content_sha256": content_sha256(fitted.manifest)}
    card |= {} if row is None else {name: row[name] for name in _COST}
    manifest = fitted.manifest.model_copy(
        update={"accuracy": accuracy, "facts": {**fitted.manifest.facts, "tradeoff": card}}
    )
    return replace(fitted, manifest=manifest, files={**fitted.files, MANIFEST: manifest_bytes(manifest)})
