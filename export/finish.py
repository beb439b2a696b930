"""A detector that is trained already becomes a complete bundle: nominal presses measure it and give its threshold.

It was not trained on these presses, so their scores need no folds: their quantile is split-conformal.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.bundle_measurements import (
    check_given,
    contact_range,
    cost_card,
    golden_frames,
    measure_tolerance,
    placeholders,
    provenance,
    state_threshold,
    warnings,
)
from calibration.fitting.fit import Fitted
from calibration.fitting.limits.threshold import check_alpha, conformal_threshold, require_enough
from calibration.fitting.presses.colours import colour_warnings, nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.self_check import apart_warnings, black_warnings
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.detector import Bank, Grid
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import GoldenFrame, Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.manifest import Facts, GridEntry, ProfileEntry, RegionEntry, ThresholdEntry, ToleranceEntry
from edge.model.scorer import Scorer
from export.direction import direction_warnings

__all__ = ["Measure", "Parts", "WrapConfig", "finish_bundle", "wrap_files"]

Measure = Callable[[Scorer, NDArray[np.float64]], tuple[list[str], Mapping[str, Any]]]
"""Gives warnings and facts for the manifest, from the bundle without threshold and the scores of the presses."""


@dataclass(frozen=True)
class WrapConfig:
    """What to make of a trained detector. The fields that are not explained are those of `FitConfig`."""

    part: str
    position: str
    profile: SensorProfile
    region: Region
    method: str
    """The name in results."""
    alpha: float = 0.05
    threshold: float | None = None
    """A raw score; None finds it from the presses."""
    threads: int = 2
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Facts of the model for the manifest, such as its licence."""

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        check_given(self.threshold)


@dataclass(frozen=True)
class Parts:
    """What the trained detector brings to its bundle."""

    graphs: Graphs
    bank: Bank | None = None
    backbone: str = ""
    """The trunk's id."""
    grid: Grid | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    free_view: NDArray[np.uint8] | None = None


def wrap_files(
    graph: bytes,
    presses: NominalPresses,
    config: WrapConfig,
    *,
    created: str,
    report: Report = lambda stage, fraction: None,
) -> Fitted:
    """Make the bundle of one graph: uint8 `frames` (n, h, w, 3) to `score_map` (n, h, w) and `score` (n,).

    presses, errors: as `finish_bundle`; BundleCorrupt for a graph that breaks the contract.
    """

    def measure(scorer: Scorer, scores: NDArray[np.float64]) -> tuple[list[str], Mapping[str, Any]]:
        return direction_warnings(scorer, presses.frames, scores), {}

    return finish_bundle(
        Parts(Graphs(detector=graph)), presses, config, measure, created=created, report=report
    )


@one_blas_thread()
def finish_bundle(
    parts: Parts,
    presses: NominalPresses,
    config: WrapConfig,
    measure: Measure,
    *,
    created: str,
    report: Report = lambda stage, fraction: None,
) -> Fitted:
    """Make the bundle of these parts.

    presses: nominal ones that the model was not trained on. measure: called once. Errors: FitError for too few presses,
    NotScorable.
    """
    alpha = config.alpha if config.threshold is None else None
    if alpha is not None:
        require_enough(len(presses), alpha)
    said = warnings(presses, (config.region.height, config.region.width), alpha)
    colours = nominal_colours(presses.frames)
    said += colour_warnings(colours)

    def facts(threshold: ThresholdEntry, tolerance: ToleranceEntry, **more: Any) -> Facts:
        return Facts(
            part=config.part,
            position=config.position,
            method=config.method,
            parameters=dict(parts.parameters),
            facts={**config.facts, **more},
            profile=ProfileEntry.of(config.profile),
            region=RegionEntry.of(config.region),
            grid=None if parts.grid is None else GridEntry.of(parts.grid),
            threshold=threshold,
            tolerance=tolerance,
            contact=contact_range(presses),
            colours=colours,
            provenance=provenance(created, presses, None, said),
        )

    scorer = Scorer(_pack(parts, facts(*placeholders())).bundle(), config.threads)
    scores = _score(scorer, presses, report)
    doubts, found = measure(scorer, scores)
    said += doubts
    golden = golden_frames(scorer, presses.frames)
    tolerance = measure_tolerance(scorer, golden, config.threads)
    if config.threshold is None:
        slack = tolerance.around(float(scores.max()))
        threshold = conformal_threshold(scores, config.alpha, slack, "split-conformal", presses.specimens)
    else:
        threshold = state_threshold(config.threshold, config.alpha)
    apart = [] if alpha is None else apart_warnings(scores, presses.names)
    said += apart
    black = np.zeros_like(presses.frames[0])
    said += black_warnings(scorer.score(black).anomaly_score, threshold, refuses(colours, black), apart)
    cost = cost_card(scorer, presses.frames, config.threads, {})
    fitted = _pack(parts, facts(threshold, tolerance, **found).model_copy(update={"cost": cost}), golden)
    Scorer(fitted.bundle(), config.threads).check_golden()
    return fitted


def _pack(parts: Parts, facts: Facts, golden: Sequence[GoldenFrame] = ()) -> Fitted:
    trunk, view = parts.backbone, parts.free_view
    return Fitted(*bundle_files(facts, parts.graphs, parts.bank, golden, backbone=trunk, free_view=view))


def _score(scorer: Scorer, presses: NominalPresses, report: Report) -> NDArray[np.float64]:
    scores = np.empty(len(presses))
    for k, frame in enumerate(presses.frames):
        scores[k] = scorer.score(frame).anomaly_score
        report("score", (k + 1) / len(presses))
    return scores
