"""A detector that is trained already becomes a complete bundle: nominal presses measure it and give its threshold.

It was not trained on these presses, so their scores need no folds: their quantile is split-conformal. Whether scores
rise with damage is tried with a painted square: a graph of another author may give a likelihood, which falls.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.fitting.bundle_measurements import (
    check_given,
    contact_range,
    cost_card,
    golden_frames,
    measure_tolerance,
    placeholders,
    provenance,
    rate_warnings,
    state_threshold,
    strength_range,
    warnings,
)
from calibration.fitting.fit import Fitted
from calibration.fitting.limits.threshold import check_alpha, conformal_threshold, require_enough
from calibration.fitting.presses.colours import colour_warnings, nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.self_check import apart_warnings, black_warnings, unproven_first
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.arrays import F64, U8
from edge.core.detector import Bank, Grid
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import GoldenFrame, Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.manifest import Facts, GridEntry, ThresholdEntry, ToleranceEntry
from edge.model.scorer import Scorer

__all__ = ["Measure", "Parts", "WrapConfig", "finish_bundle", "paint_square", "wrap_files"]

Measure = Callable[[Scorer, F64], tuple[list[str], Mapping[str, Any]]]
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
    free_view: U8 | None = None


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

    def measure(scorer: Scorer, scores: F64) -> tuple[list[str], Mapping[str, Any]]:
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
    sentences = warnings(presses, (config.region.height, config.region.width), alpha)
    colours = nominal_colours(presses.frames)
    sentences += [*rate_warnings(presses.specimens, alpha), *colour_warnings(colours)]
    sentences = unproven_first(sentences)

    def facts(threshold: ThresholdEntry, tolerance: ToleranceEntry, **more: Any) -> Facts:
        return Facts(
            part=config.part,
            position=config.position,
            method=config.method,
            parameters=dict(parts.parameters),
            facts={**config.facts, **more},
            profile=config.profile,
            region=config.region,
            grid=None if parts.grid is None else GridEntry.of(parts.grid),
            threshold=threshold,
            tolerance=tolerance,
            contact=contact_range(presses),
            strength=strength_range(presses),
            colours=colours,
            provenance=provenance(created, presses, None, sentences),
        )

    scorer = Scorer(_pack(parts, facts(*placeholders())).bundle(), config.threads)
    scores = _score(scorer, presses, report)
    doubts, more = measure(scorer, scores)
    sentences += doubts
    golden = golden_frames(scorer, presses.frames)
    tolerance = measure_tolerance(scorer, golden, config.threads)
    if config.threshold is None:
        slack = tolerance.around(float(scores.max()))
        threshold = conformal_threshold(scores, config.alpha, slack, "split-conformal", presses.specimens)
    else:
        threshold = state_threshold(config.threshold, config.alpha)
    apart = [] if alpha is None else apart_warnings(scores, presses.names)
    sentences += apart
    black = np.zeros_like(presses.frames[0])
    sentences += black_warnings(scorer.score(black).anomaly_score, threshold, refuses(colours, black), apart)
    cost = cost_card(scorer, presses.frames, config.threads, {})
    fitted = _pack(parts, facts(threshold, tolerance, **more).model_copy(update={"cost": cost}), golden)
    Scorer(fitted.bundle(), config.threads).check_golden()
    return fitted


def _pack(parts: Parts, facts: Facts, golden: Sequence[GoldenFrame] = ()) -> Fitted:
    trunk, view = parts.backbone, parts.free_view
    return Fitted(*bundle_files(facts, parts.graphs, parts.bank, golden, backbone=trunk, free_view=view))


def _score(scorer: Scorer, presses: NominalPresses, report: Report) -> F64:
    scores = np.empty(len(presses))
    for k, frame in enumerate(presses.frames):
        scores[k] = scorer.score(frame).anomaly_score
        report("score", (k + 1) / len(presses))
    return scores


MOST_FRAMES = 8
SATURATED_SHARE = 0.5
# Of the painted presses, that must score higher, or lower, for a direction to be known.
AGREEING_SHARE = 0.75


def direction_warnings(scorer: Scorer, frames: U8, scores: F64) -> list[str]:
    """Check the direction on some nominal frames, uint8 (n, h, w, 3) with their scores (n,).

    Errors: FitError where most painted frames score lower; a warning where most do not score higher, or where half of
    the nominal scores have one value, as scores that are limited to 0..1 do.
    """
    chosen = np.linspace(0, len(frames) - 1, min(MOST_FRAMES, len(frames))).astype(int)
    change = np.array([scorer.score(paint_square(frames[k])).anomaly_score - scores[k] for k in chosen])
    room = scorer.bundle.manifest.tolerance.around(float(np.abs(scores).max()))
    rising, falling, count = int((change > room).sum()), int((change < -room).sum()), len(change)
    if falling >= AGREEING_SHARE * count:
        raise FitError(
            f"scores fall where a press is damaged: a painted square lowers {falling} of {count} "
            f"nominal scores, their median change is {float(np.median(change)):.3g}; pass --negate if lower scores are "
            "more anomalous in this graph, or choose another output with --score-output"
        )
    sentences = []
    if rising < AGREEING_SHARE * count:
        sentences.append(
            f"a painted square raises {rising} and lowers {falling} of {count} nominal scores: whether higher scores "
            "are more anomalous is not known; score a damaged press before use"
        )
    largest = max(float((scores == value).mean()) for value in (scores.min(), scores.max()))
    if len(scores) >= 4 and largest > SATURATED_SHARE:
        sentences.append(
            f"{largest:.0%} of the nominal presses have one score: the graph limits its scores, so the threshold tells "
            "little; export it without its normalisation"
        )
    return sentences


def paint_square(rgb: U8) -> U8:
    """Copy a frame, uint8 (h, w, 3), with a square of a quarter of its side in the middle: half dark, half bright."""
    h, w = rgb.shape[:2]
    frame, half = rgb.copy(), max(1, min(h, w) // 8)
    frame[h // 2 - half : h // 2, w // 2 - half : w // 2 + half] = 20
    frame[h // 2 : h // 2 + half, w // 2 - half : w // 2 + half] = 235
    return frame
