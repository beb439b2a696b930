"""The points of one view and one backbone: features once, then for each point a bundle and what it finds."""

import hashlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from calibration.experiments.harness.pictures import tile
from calibration.experiments.harness.rows import ROW_FORMAT
from calibration.experiments.harness.scoring import score_presses
from calibration.experiments.tradeoff.accuracy import measure_accuracy
from calibration.experiments.tradeoff.floor import work_of
from calibration.experiments.tradeoff.front import Row
from calibration.experiments.tradeoff.plan import Run
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint
from calibration.experiments.tradeoff.presses import on_common_grid
from calibration.fitting.bundle_measurements import placeholders, provenance
from calibration.fitting.limits.held_out import Learner, TapReader
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk, open_trunk
from edge import registry
from edge.core.detector import Bank, Detector, Features, Nominal
from edge.core.errors import FitError, NotScorable
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES
from edge.core.imaging.smoothing import smooth
from edge.core.imaging.tiles import tiling
from edge.model.bundle import Bundle, Graphs
from edge.model.bundle_writer import bundle_files, write_bundle
from edge.model.manifest import Facts, GridEntry, Manifest

__all__ = ["content_sha256", "detector_of", "fit_points", "trunk_of"]

TILE: Final = 224
"""Side of a tile in pixels, the input side of the seed paper's backbone."""


def detector_of(point: OperatingPoint) -> tuple[Detector, Any]:
    """The detector of a point and its parameters. Errors: ConfigError, FitError."""
    detector = registry.detector(point.method)
    return detector, detector.parameters(point.mode, **point.overrides)


def trunk_of(*points: OperatingPoint) -> Trunk:
    """The trunk of points of one view and backbone, cut after the deepest tap that they read, tiled where the view is.

    Errors: ConfigError, FitError.
    """
    view, trunk = VIEWS[points[0].view], open_trunk(points[0].backbone, _taps(points))
    if view.overlap is None:
        return trunk
    return tile(trunk, tiling((view.region.height, view.region.width), TILE, view.overlap))


def _taps(points: Sequence[OperatingPoint]) -> list[str]:
    return sorted({tap for detector, values in map(detector_of, points) for tap in detector.taps(values)})


def fit_points(points: Sequence[OperatingPoint], run: Run, folder: Path) -> Iterator[Row]:
    """Fit and score points of one view and one backbone, which share their features; write their bundles.

    Gives of each point the columns that do not depend on the machine's speed, and the seconds of the fit. Errors:
    FitError, with the point.
    """
    view, trunk, threads = VIEWS[points[0].view], trunk_of(*points), run.given.threads
    nominal = run.chosen.read_nominal(view).first(max(point.presses for point in points))
    frame = view.region.height, view.region.width
    reader = TapReader(trunk.graph, _taps(points), frame, view.profile.pixels_per_mm, threads)
    frames = np.concatenate([nominal.frames, run.chosen.read(run.chosen.scored, view)])
    start = time.perf_counter()
    taken = {
        is_smoothed: reader.take(np.stack([smooth(rgb) for rgb in frames]) if is_smoothed else frames)
        for is_smoothed in {_is_smoothed(point) for point in points}
    }
    seconds = (time.perf_counter() - start) / len(frames) / len(taken)
    for point in points:
        learner, features = reader.learner(*detector_of(point), run.given.seed), taken[_is_smoothed(point)]
        try:
            row = _fit(point, run, nominal, learner, features, folder)
        except (FitError, NotScorable) as error:
            raise FitError(f"operating point {point.key}: {error}") from error
        row["fit_s"]["features"] = seconds * point.presses
        yield row


def _is_smoothed(point: OperatingPoint) -> bool:
    """Tell whether a fit smooths its presses."""
    return point.mode != "paper"


def _fit(
    point: OperatingPoint,
    run: Run,
    nominal: NominalPresses,
    learner: Learner,
    features: Features,
    folder: Path,
) -> Row:
    """Fit one point. nominal: the presses of the largest fit. features: of these, then of the scored presses."""
    taps = list(learner.grid.taps)
    start = time.perf_counter()
    bank = learner.bank(Nominal({tap: features[tap][: point.presses] for tap in taps}))
    head = learner.head(bank)
    bank_s = time.perf_counter() - start
    trunk = trunk_of(point)
    facts = _facts(point, run, nominal, learner, bank, trunk)
    manifest, files = bundle_files(
        facts, Graphs(trunk=trunk.graph, head=head), bank, backbone=trunk.id, with_trunk=False
    )
    loaded = Bundle.in_memory(manifest, files, loaded=(trunk.sha256,))
    scored = score_presses(
        learner, bank, features, range(len(nominal), len(nominal) + len(run.chosen.scored))
    )
    shared = folder / "trunks" / f"{trunk.sha256}.onnx"  # once for all points that share it
    if not shared.is_file():
        shared.parent.mkdir(parents=True, exist_ok=True)
        shared.write_bytes(trunk.graph)
    write_bundle(folder / point.key, files, overwrite=True)
    return {
        "format": ROW_FORMAT,
        "key": point.key,
        "method": point.method,
        "mode": point.mode,
        "backbone": point.backbone,
        "view": point.view,
        "settings": point.overrides,
        "presses": point.presses,
        "gel_share": point.presses / DEFAULT_LIMIT_PRESSES,
        "accuracy": measure_accuracy(
            [on_common_grid(score_map) for score_map in scored.maps], scored.scores, run.truth
        ),
        "bank_bytes": sum(entry.bytes_stored for entry in manifest.bank.values()),
        "bank_bytes_unpacked": sum(entry.bytes_unpacked for entry in manifest.bank.values()),
        "trunk_bytes": len(trunk.graph),
        "trunk_sha256": trunk.sha256,
        "content_sha256": content_sha256(manifest),
        "fit_s": {"features": 0.0, "bank": bank_s},
        "work": asdict(work_of(trunk.graph, loaded)),
    }


def _facts(
    point: OperatingPoint, run: Run, nominal: NominalPresses, learner: Learner, bank: Bank, trunk: Trunk
) -> Facts:
    """The manifest's facts; with the placeholder threshold every press fails: this bundle is only measured."""
    threshold, tolerance = placeholders()
    view = VIEWS[point.view]
    return Facts(
        part=run.chosen.every.part,
        position=run.chosen.every.position,
        method=point.method,
        mode=point.mode,
        parameters=dict(vars(learner.parameters)),
        repairs=tuple(bank.facts.get("repairs", ())),
        facts={"backbone": trunk.facts},
        profile=view.profile,
        region=view.region,
        grid=GridEntry.of(learner.grid),
        is_smoothed=_is_smoothed(point),
        threshold=threshold,
        tolerance=tolerance,
        provenance=provenance("measured", nominal.first(point.presses), learner.seed, ()),
    )


def content_sha256(manifest: Manifest) -> str:
    """Hash trunk, head and bank: everything that decides a score, and nothing that differs between two fits.

    A manifest also holds dates and measured times, so its own hash changes with every fit.
    """
    trunk = [manifest.backbone.trunk] if manifest.backbone else []
    graphs = [graph for graph in (manifest.head, manifest.detector) if graph]
    arrays = [entry for array in manifest.bank.values() for entry in (array.data, array.scale) if entry]
    lines = sorted(f"{entry.file} {entry.sha256}" for entry in (*trunk, *graphs, *arrays))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
