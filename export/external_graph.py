"""A bundle of a third party's single graph: the graph has the method, nominal presses give the threshold.

The graph was not trained on these presses, so their scores need no folds: their quantile is split-conformal.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.fitting.bundle_measurements import (
    check_given,
    contact_range,
    cost_card,
    given_threshold,
    golden_frames,
    measured_tolerance,
    placeholders,
    provenance,
    warnings,
)
from calibration.fitting.fit import Fitted
from calibration.fitting.limits.threshold import check_alpha, conformal_threshold, require_enough
from calibration.fitting.presses.colours import colour_warnings, nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.self_check import apart_warnings, black_warnings
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import Graphs, bundle_files
from edge.model.manifest import Facts, ProfileEntry, RegionEntry, ThresholdEntry, ToleranceEntry
from edge.model.scorer import Scorer
from export.direction import direction_warnings

__all__ = ["WrapConfig", "wrap_files"]


@dataclass(frozen=True)
class WrapConfig:
    """What to make. method: the name in the results. facts: of the graph, for the manifest, such as its licence. The
    other fields are those of `FitConfig`."""

    part: str
    position: str
    profile: SensorProfile
    region: Region
    method: str
    alpha: float = 0.05
    threshold: float | None = None
    threads: int = 2
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        check_given(self.threshold)


@one_blas_thread()
def wrap_files(
    graph: bytes,
    presses: NominalPresses,
    config: WrapConfig,
    *,
    created: str,
    report: Report = lambda stage, fraction: None,
) -> Fitted:
    """The bundle of one graph: uint8 `frames` (n, h, w, 3) to `score_map` (n, h, w) and `score` (n,).

    presses: nominal ones that the graph was not trained on. Errors: BundleCorrupt for a graph that breaks the contract,
    FitError for too few presses, NotScorable.
    """
    region, is_given = config.region, config.threshold is not None
    if not is_given:
        require_enough(len(presses), config.alpha)
    said = warnings(presses, (region.height, region.width), None if is_given else config.alpha)
    colours = nominal_colours(presses.frames)
    said += colour_warnings(colours)
    graphs = Graphs(detector=graph)

    def facts(threshold: ThresholdEntry, tolerance: ToleranceEntry) -> Facts:
        return Facts(
            part=config.part,
            position=config.position,
            method=config.method,
            facts=dict(config.facts),
            profile=ProfileEntry.of(config.profile),
            region=RegionEntry.of(region),
            threshold=threshold,
            tolerance=tolerance,
            contact=contact_range(presses),
            colours=colours,
            provenance=provenance(created, presses, None, said),
        )

    scorer = Scorer(Fitted(*bundle_files(facts(*placeholders()), graphs)).bundle(), config.threads)
    scores = np.empty(len(presses))
    for k, frame in enumerate(presses.frames):
        scores[k] = scorer.score(frame).anomaly_score
        report("score", (k + 1) / len(presses))
    said += direction_warnings(scorer, presses.frames, scores)
    golden = golden_frames(scorer, presses.frames)
    tolerance = measured_tolerance(scorer, golden, config.threads)
    threshold = (
        given_threshold(config.threshold, config.alpha)
        if config.threshold is not None
        else conformal_threshold(
            scores, config.alpha, tolerance.around(float(scores.max())), "split-conformal", presses.specimens
        )
    )
    apart = [] if is_given else apart_warnings(scores, presses.names)
    said += apart
    black = np.zeros_like(presses.frames[0])
    is_refused = refuses(colours, black)
    said += black_warnings(scorer.score(black).anomaly_score, threshold, is_refused, apart)
    manifest_facts = facts(threshold, tolerance).model_copy(
        update={"cost": cost_card(scorer, presses.frames, config.threads, {})}
    )
    fitted = Fitted(*bundle_files(manifest_facts, graphs, golden=golden))
    Scorer(fitted.bundle(), config.threads).check_golden()
    return fitted
