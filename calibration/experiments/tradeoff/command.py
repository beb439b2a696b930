"""The verb `tradeoff`, and the bundle of one point, with its accuracy and cost cards in the manifest."""

import datetime
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import typer

from calibration.experiments.tradeoff.accuracy import measure_accuracy
from calibration.experiments.tradeoff.figure import say_cost, svg
from calibration.experiments.tradeoff.fitting import content_sha256, detector_of, trunk_of
from calibration.experiments.tradeoff.front import Row, pick, read_limits, table
from calibration.experiments.tradeoff.plan import Run, RunSettings
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint
from calibration.experiments.tradeoff.presses import on_common_grid, see
from calibration.experiments.tradeoff.run import read_or_measure
from calibration.fitting.command import refuse_existing, summarise, write
from calibration.fitting.fit import FitConfig, Fitted, fit_files
from calibration.folders import write_atomically
from calibration.progress import Stages, progress
from edge.cli.arguments import add_argument, add_option, flatten
from edge.core.errors import ConfigError
from edge.extras import needs
from edge.model.archive import MANIFEST
from edge.model.bundle_writer import manifest_bytes
from edge.model.scorer import Scorer

__all__ = ["bundle_of", "tradeoff"]


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
    view, chosen, settings = VIEWS[point.view], run.chosen, run.settings
    seen = see(chosen, view)
    detector, _ = detector_of(point)
    config = FitConfig(
        part=chosen.part,
        position=chosen.position,
        profile=view.profile,
        region=view.region,
        detector=detector,
        trunk=trunk_of(point),
        mode=point.mode,
        overrides=point.overrides,
        seed=settings.seed,
        threads=settings.threads,
        is_scattered=True,
        limit="plain",  # as the point was measured
    )
    presses = seen.nominal.first(point.presses)
    fitted = fit_files(presses, config, created=datetime.date.today().isoformat(), report=report)
    scorer = Scorer(fitted.bundle(), settings.threads)
    scored = [scorer.score(frame) for frame in seen.frames]
    maps = [on_common_grid(one.score_map) for one in scored]
    accuracy = measure_accuracy(maps, np.array([one.anomaly_score for one in scored]), run.truth)
    return add_cards(fitted, accuracy, point, row)


def add_cards(
    fitted: Fitted, accuracy: dict[str, dict[str, float | None]], point: OperatingPoint, row: Row | None
) -> Fitted:
    """The bundle with the accuracy card, and, from a measured row, the cost card; its scores are the same."""
    values = {
        f"{name}_{part}" if part != "value" else name: value
        for name, one in accuracy.items()
        for part, value in one.items()
        if value is not None
    }
    cost = {} if row is None else {name: row[name] for name in _COST}
    card = {"point": point.key, "content_sha256": content_sha256(fitted.manifest)} | cost
    manifest = fitted.manifest.model_copy(
        update={"accuracy": values, "facts": {**fitted.manifest.facts, "tradeoff": card}}
    )
    return replace(fitted, manifest=manifest, files={**fitted.files, MANIFEST: manifest_bytes(manifest)})
