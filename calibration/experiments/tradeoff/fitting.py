"""The points of one view and one backbone: features once, then a bank, score maps and a bundle for each point."""

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.harness.pictures import tile
from calibration.experiments.harness.scoring import run_head
from calibration.experiments.tradeoff.floor import Work, work_of
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint, View
from calibration.experiments.tradeoff.presses import Chosen, Seen
from calibration.fitting.bundle_measurements import placeholders, provenance
from calibration.fitting.limits.held_out import Learner, TapReader
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk, open_trunk
from edge import registry
from edge.core.detector import Bank, Detector, Features, Nominal
from edge.core.errors import FitError, NotScorable
from edge.core.imaging.smoothing import smooth
from edge.core.imaging.tiles import tiling
from edge.model.bundle import Bundle, Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.manifest import Facts, GridEntry, Manifest
from edge.model.session import open_session

__all__ = ["FittedPoint", "content_sha256", "fit_points", "trunk_of"]

TILE = 224
"""Side of a tile in pixels, the input side of the seed paper's backbone."""


@dataclass(frozen=True)
class FittedPoint:
    """A point with its bundle and what it gives on the scored presses.

    features_s, bank_s: seconds for the trunk over the fitted presses, and for the bank.
    """

    point: OperatingPoint
    trunk: Trunk
    manifest: Manifest
    files: Mapping[str, bytes]
    """The files of a bundle without its trunk and without golden frames."""
    maps: NDArray[np.float32]
    """float32 (n, h, w) of the region."""
    scores: NDArray[np.float64]
    """float64 (n,)."""
    features_s: float
    bank_s: float
    work: Work


def trunk_of(point: OperatingPoint) -> Trunk:
    """The trunk of a point, cut after the deepest tap that the method reads, and tiled where the view is.

    Errors: ConfigError, FitError.
    """
    detector, parameters = detector_of(point)
    return _tile(open_trunk(point.backbone, detector.taps(parameters)), VIEWS[point.view])


def detector_of(point: OperatingPoint) -> tuple[Detector, Any]:
    """The detector of a point and its parameters. Errors: ConfigError, FitError."""
    detector = registry.detector(point.method)
    return detector, detector.parameters(point.mode, **point.overrides)


def _tile(trunk: Trunk, view: View) -> Trunk:
    if view.overlap is None:
        return trunk
    return tile(trunk, tiling((view.region.height, view.region.width), TILE, view.overlap))


def fit_points(
    points: Sequence[OperatingPoint],
    chosen: Chosen,
    seen: Seen,
    *,
    threads: int,
    seed: int,
) -> Iterator[FittedPoint]:
    """Fit and score points of one view and one backbone, which share their features.

    Errors: FitError, with the point.
    """
    view, nominal = VIEWS[points[0].view], seen.nominal.first(max(point.presses for point in points))
    taps = sorted({tap for point in points for tap in detector_of(point)[0].taps(detector_of(point)[1])})
    trunk = _tile(open_trunk(points[0].backbone, taps), view)
    frame = view.region.height, view.region.width
    reader = TapReader(trunk.graph, taps, frame, view.profile.pixels_per_mm, threads)
    frames = np.concatenate([nominal.frames, seen.frames])
    start = time.perf_counter()
    taken = {
        is_smoothed: reader.take(np.stack([smooth(rgb) for rgb in frames]) if is_smoothed else frames)
        for is_smoothed in {_is_smoothed(point) for point in points}
    }
    seconds = (time.perf_counter() - start) / len(frames) / len(taken)
    for point in points:
        learner = reader.learner(*detector_of(point), seed)
        try:
            yield _fit(point, chosen, nominal, learner, taken[_is_smoothed(point)], seconds)
        except (FitError, NotScorable) as error:
            raise FitError(f"operating point {point.key}: {error}") from error


def _is_smoothed(point: OperatingPoint) -> bool:
    """Tell whether a fit smooths its presses."""
    return point.mode != "paper"


def _fit(
    point: OperatingPoint,
    chosen: Chosen,
    nominal: NominalPresses,
    learner: Learner,
    features: Features,
    seconds: float,
) -> FittedPoint:
    """Fit one point. nominal: the presses of the largest fit. features: of these, then of the scored presses."""
    taps = list(learner.grid.taps)
    start = time.perf_counter()
    bank = learner.bank(Nominal({tap: features[tap][: point.presses] for tap in taps}))
    head = learner.head(bank)
    bank_s = time.perf_counter() - start
    trunk = trunk_of(point)
    facts = _facts(point, chosen, nominal, learner, bank, trunk)
    graphs = Graphs(trunk=trunk.graph, head=head)
    manifest, files = bundle_files(facts, graphs, bank, backbone=trunk.id, with_trunk=False)
    loaded = Bundle.in_memory(manifest, files, loaded=(trunk.sha256,))
    maps = {tap: [one[None] for one in features[tap][len(nominal) :]] for tap in taps}
    session = open_session(loaded.graphs.head or b"", learner.threads, f"head of {point.method}")
    scored = run_head(session, loaded.bank, maps, point.method)
    features_s, work = seconds * point.presses, work_of(trunk.graph, loaded)
    return FittedPoint(point, trunk, manifest, files, scored.maps, scored.scores, features_s, bank_s, work)


def _facts(
    point: OperatingPoint,
    chosen: Chosen,
    nominal: NominalPresses,
    learner: Learner,
    bank: Bank,
    trunk: Trunk,
) -> Facts:
    """The manifest's facts; with the placeholder threshold every press fails: this bundle is only measured."""
    threshold, tolerance = placeholders()
    view = VIEWS[point.view]
    return Facts(
        part=chosen.part,
        position=chosen.position,
        method=point.method,
        mode=point.mode,
        parameters=json.loads(json.dumps(vars(learner.parameters))),
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
