"""The bundle of one point, fitted as `gelgate fit` does, with its accuracy and cost cards in the manifest."""

import datetime
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calibration.experiments.tradeoff.accuracy import measure_accuracy
from calibration.experiments.tradeoff.fitting import content_sha256, detector_of, trunk_of
from calibration.experiments.tradeoff.plan import Run
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint
from calibration.experiments.tradeoff.presses import on_common_grid, see
from calibration.experiments.tradeoff.rows import Row
from calibration.fitting.fit import FitConfig, Fitted, fit_files
from edge.model.archive import MANIFEST
from edge.model.bundle_writer import manifest_bytes
from edge.model.scorer import Scorer

__all__ = ["bundle_of"]

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
