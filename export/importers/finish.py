"""`import_detector`: an imported model is measured on nominal presses and becomes a complete bundle."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

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
from calibration.fitting.features import extract
from calibration.fitting.fit import Fitted
from calibration.fitting.limits.threshold import check_alpha, conformal_threshold, require_enough
from calibration.fitting.presses.colours import colour_warnings, nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.self_check import apart_warnings, black_warnings
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.detector import Bank, ScoreMaps
from edge.core.errors import BundleCorrupt, ConfigError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import Graphs, bundle_files
from edge.model.licence import LICENCE
from edge.model.manifest import Facts, GridEntry, ProfileEntry, RegionEntry, ThresholdEntry, ToleranceEntry
from edge.model.packing import pack
from edge.model.scorer import Scorer
from edge.model.session import open_session
from export.importers.contract import Imported
from export.parity import Stage, compare, rank_correlation
from export.weights_file import file_sha256

__all__ = ["ImportConfig", "Losses", "import_files"]

# Presses on which the full form of the model is compared with the stored one.
COMPARED_PRESSES = 8
# What packing may change: maps and scores, of the largest; the order of the presses is not checked where all are alike.
PACKED_MOST = 0.05


@dataclass(frozen=True)
class ImportConfig:
    """What to make. threshold: `presses` finds it from the presses, `model` takes the model's own, a number is itself.
    licence: of the weights, as their author states it. The other fields are those of `FitConfig`."""

    part: str
    position: str
    profile: SensorProfile
    region: Region
    licence: str
    threshold: float | Literal["presses", "model"] = "presses"
    alpha: float = 0.05
    threads: int = 2

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        check_given(self.threshold if isinstance(self.threshold, float) else None)


@dataclass(frozen=True)
class Losses:
    """What making the bank smaller costs, on the caller's presses, relative to the largest value. reduction: of raw
    distances, thin form against the file's own; None where nothing was reduced. packing: of scores, packing_map: of
    maps, and order: the rank correlation of the scores of packed and unpacked bank."""

    reduction: float | None
    packing: float
    packing_map: float
    order: float
    bytes_stored: int
    bytes_unpacked: int

    def words(self) -> str:
        """Say it in a sentence."""
        first = (
            ""
            if self.reduction is None
            else f"the reduction changes distances by at most {self.reduction:.2g} of the largest; "
        )
        return (
            f"{first}packing changes scores by at most {self.packing:.2g} and maps by {self.packing_map:.2g} of the "
            f"largest (rank correlation {self.order:.4f}); "
            f"the bank has {self.bytes_stored / 1e6:.2f} MB stored, {self.bytes_unpacked / 1e6:.2f} MB in use"
        )


@one_blas_thread()
def import_files(
    model: Imported,
    presses: NominalPresses,
    config: ImportConfig,
    source: Path,
    *,
    created: str,
    report: Report = lambda stage, fraction: None,
) -> tuple[Fitted, Losses]:
    """The bundle of an imported model, and what its smaller bank costs on these presses.

    presses: nominal ones that the model was not trained on. Errors: ConfigError, FitError for too few presses,
    BundleCorrupt where the packed bank does not score as the full one.
    """
    return _Import(model, presses, config, source, created, report).run()


class _Import:
    def __init__(
        self,
        model: Imported,
        presses: NominalPresses,
        config: ImportConfig,
        source: Path,
        created: str,
        report: Report,
    ) -> None:
        self.model, self.presses, self.config, self.source = model, presses, config, source
        self.created, self.report = created, report
        promised = config.alpha if config.threshold == "presses" else None
        if promised is not None:
            require_enough(len(presses), promised)
        self.warnings = warnings(presses, (config.region.height, config.region.width), promised)
        self.colours = nominal_colours(presses.frames)
        self.warnings += colour_warnings(self.colours)
        self.graphs = Graphs(trunk=model.trunk.graph, head=model.head)

    def run(self) -> tuple[Fitted, Losses]:
        bare = self._make_files(self._facts(*placeholders(), None), ())
        scorer = Scorer(bare.bundle(), self.config.threads)
        scores = self._scores(scorer)
        losses = self._losses(scorer)
        golden = golden_frames(scorer, self.presses.frames)
        tolerance = measured_tolerance(scorer, golden, self.config.threads)
        threshold = self._threshold(scores, tolerance)
        apart = apart_warnings(scores, self.presses.names) if self.config.threshold == "presses" else []
        self.warnings += apart
        black = np.zeros_like(self.presses.frames[0])
        self.warnings += black_warnings(
            scorer.score(black).anomaly_score, threshold, refuses(self.colours, black), apart
        )
        facts = self._facts(threshold, tolerance, losses)
        facts = facts.model_copy(
            update={"cost": cost_card(scorer, self.presses.frames, self.config.threads, {})}
        )
        fitted = self._make_files(facts, golden)
        Scorer(fitted.bundle(), self.config.threads).check_golden()
        return fitted, losses

    def _scores(self, scorer: Scorer) -> NDArray[np.float64]:
        scores = np.empty(len(self.presses))
        for k, frame in enumerate(self.presses.frames):
            scores[k] = scorer.score(frame).anomaly_score
            self.report("score", (k + 1) / len(self.presses))
        return scores

    def _losses(self, scorer: Scorer) -> Losses:
        """Measure what the smaller bank costs. Errors: BundleCorrupt where packing changes maps or scores too much."""
        stored = sum(self._count_bytes(name) for name in self.model.bank.arrays)
        used = sum(array.nbytes for array in self.model.bank.arrays.values())
        if not self.model.bank.packing:
            return Losses(self._reduction(), 0.0, 0.0, 1.0, stored, used)
        whole = replace(self.model, bank=Bank(self.model.bank.arrays))
        files = bundle_files(
            self._facts(*placeholders(), None), self.graphs, whole.bank, (), backbone=self.model.trunk.id
        )
        full = self._score_presses(Scorer(Fitted(*files).bundle(), self.config.threads))
        packed = self._score_presses(scorer)
        stages = [
            Stage("map of the packed bank", full.score_map, packed.score_map, "map", PACKED_MOST),
            Stage("score of the packed bank", full.score, packed.score, "score", PACKED_MOST),
        ]
        report = compare(stages)
        if report.first_different is not None:
            raise BundleCorrupt(
                f"the packed bank of {self.source} differs from the full one: {report.first_different.sentence()}; "
                "store it with --packing none, or float16 in place of int8; nothing is imported"
            )
        of_map, of_score = (result.difference for result in report.results)
        order = rank_correlation(full.score, packed.score)
        return Losses(self._reduction(), of_score, of_map, order, stored, used)

    def _score_presses(self, scorer: Scorer) -> ScoreMaps:
        """Score the presses that are compared."""
        scored = [scorer.score(frame) for frame in self.presses.frames[:COMPARED_PRESSES]]
        return ScoreMaps(
            np.stack([press.score_map for press in scored]).astype(np.float64),
            np.array([press.anomaly_score for press in scored]),
        )

    def _count_bytes(self, name: str) -> int:
        packed = pack(self.model.bank.arrays[name], self.model.bank.packing.get(name, "none"))
        return packed.data.nbytes + (0 if packed.scale is None else packed.scale.nbytes)

    def _reduction(self) -> float | None:
        if self.model.exact is None:
            return None
        session = open_session(self.model.trunk.graph, self.config.threads, f"the trunk of {self.source}")
        frames = self.presses.frames[:COMPARED_PRESSES]
        full, thin = self.model.exact(extract(session, frames, self.model.grid, lambda fraction: None))
        return float(np.abs(full - thin).max() / max(float(full.max()), 1e-12))

    def _threshold(self, scores: NDArray[np.float64], tolerance: ToleranceEntry) -> ThresholdEntry:
        config = self.config
        if config.threshold == "presses":
            slack = tolerance.around(float(scores.max()))
            return conformal_threshold(scores, config.alpha, slack, "split-conformal", self.presses.specimens)
        if config.threshold == "model":
            if self.model.threshold is None:
                raise ConfigError(
                    f"{self.source} has no threshold of its own; leave --threshold out to find one from the presses"
                )
            return given_threshold(self.model.threshold, config.alpha)
        return given_threshold(config.threshold, config.alpha)

    def _make_files(self, facts: Facts, golden: Any) -> Fitted:
        files = bundle_files(
            facts,
            self.graphs,
            self.model.bank,
            golden,
            backbone=self.model.trunk.id,
            free_view=self.presses.free_view,
        )
        return Fitted(*files)

    def _facts(self, threshold: ThresholdEntry, tolerance: ToleranceEntry, losses: Losses | None) -> Facts:
        config, model = self.config, self.model
        return Facts(
            part=config.part,
            position=config.position,
            method=model.method,
            parameters=dict(model.parameters),
            facts={
                "backbone": dict(model.trunk.facts),
                LICENCE: config.licence,
                "imported": self._describe_import(losses),
                "warnings": [],
            },
            profile=ProfileEntry.of(config.profile),
            region=RegionEntry.of(config.region),
            grid=GridEntry.of(model.grid, ()),
            threshold=threshold,
            tolerance=tolerance,
            contact=contact_range(self.presses),
            colours=self.colours,
            provenance=provenance(self.created, self.presses, None, self.warnings),
        )

    def _describe_import(self, losses: Losses | None) -> Mapping[str, Any]:
        facts: dict[str, Any] = {"source": self.model.source, "file": self.source.name, **self.model.facts}
        facts["says"] = list(self.model.says)
        if losses is not None:
            facts["losses"] = losses.words()
            facts["file_sha256"] = file_sha256(self.source)
        return facts
