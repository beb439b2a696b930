"""From nominal presses to a bundle: features, bank, out-of-fold threshold, tolerance, golden frames, files.

The detector has the mathematics; the procedure (which presses, which folds, which seed) is here.
"""

import time
from collections.abc import Callable, Container, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.bundle_measurements import (
    contact_range,
    cost_card,
    free_gel_warnings,
    given_threshold,
    golden_frames,
    measured_tolerance,
    placeholders,
    provenance,
    scatter_warnings,
    warnings,
)
from calibration.fitting.features import extract, feature_warnings, trunk_grid
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.limits.covering import covering_bank
from calibration.fitting.limits.folds import held_out_folds
from calibration.fitting.limits.head_limit import bank_with, head_with_limit, limit_arrays
from calibration.fitting.limits.held_out import Learner
from calibration.fitting.limits.kinds import PLAIN
from calibration.fitting.limits.limit_choice import Choice
from calibration.fitting.limits.limit_step import LimitStep
from calibration.fitting.limits.relief_step import ReliefChoice, relief_of, with_relief
from calibration.fitting.limits.threshold import (
    MIN_PRESSES,
    conformal_threshold,
    of_copies,
    require_enough,
)
from calibration.fitting.pose.pose_decision import PoseChoice, chosen_pose
from calibration.fitting.presses.augmentation import (
    EACH,
    Copies,
    augmentation_of,
    rendered_copies,
)
from calibration.fitting.presses.colours import colour_warnings, nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.self_check import apart_warnings, black_warnings, room_warnings, unproven_warnings
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.detector import Bank, Features, Nominal, Progress
from edge.model.bundle import Bundle, GoldenFrame, Graphs, bundle_files, write_bundle
from edge.model.gel_facts import gel_facts
from edge.model.limit_facts import MISSING
from edge.model.manifest import (
    Facts,
    GridEntry,
    Manifest,
    ProfileEntry,
    RegionEntry,
    ThresholdEntry,
    ToleranceEntry,
)
from edge.model.scorer import Scorer
from edge.model.session import TrunkSessions, open_session
from edge.model.tile_runner import most_typical, untouched_tiles

T = TypeVar("T")

__all__ = ["FitConfig", "Fitted", "fit_bundle", "fit_files"]


@dataclass(frozen=True)
class Fitted:
    """A fitted bundle that is not yet on disk."""

    manifest: Manifest
    files: dict[str, bytes]

    def bundle(self, loaded: Container[str] = ()) -> Bundle:
        """The same, loaded through the same checks as from disk. loaded: see `Bundle.load`."""
        return Bundle.in_memory(self.manifest, self.files, loaded=loaded)


def fit_bundle(
    path: Path,
    presses: NominalPresses,
    config: FitConfig,
    *,
    created: str,
    report: Report = lambda stage, fraction: None,
    overwrite: bool = False,
) -> Path:
    """Fit and write a bundle, a folder or (name ending in .zip) a zip; complete or not at all.

    created: the date for the provenance. Errors: FitError, ConfigError, FileExistsError, OSError.
    """
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already; choose another name or allow it to be replaced")
    fitted = fit_files(presses, config, created=created, report=report)
    report("write", 0.0)
    write_bundle(path, fitted.files, overwrite=overwrite)
    report("write", 1.0)
    return path


@one_blas_thread()
def fit_files(
    presses: NominalPresses, config: FitConfig, *, created: str, report: Report = lambda stage, fraction: None
) -> Fitted:
    """Fit a bundle in memory. Errors as `fit_bundle`."""
    return _Fit(presses, config, created, report).run()


class _Fit:
    """One fit. Its stages are the methods in the order in which `run` calls them."""

    def __init__(self, presses: NominalPresses, config: FitConfig, created: str, report: Report) -> None:
        self.presses, self.config, self.created, self.report = presses, config, created, report
        self.detector = config.detector
        self.parameters = self.detector.parameters(config.mode, **config.overrides)
        self.specimens = presses.specimens or (None,) * len(presses)
        promised = config.alpha if config.threshold is None else None
        self.warnings = warnings(presses, (config.region.height, config.region.width), promised)
        self.augmentation = augmentation_of(config.augment, presses, self.detector.name, config.mode)
        self.fewest = 2 if self.augmentation.each and len(presses) < MIN_PRESSES else MIN_PRESSES
        self.is_held_out = config.threshold is None and not (self.augmentation.each and len(presses) == 1)
        if self.is_held_out:
            require_enough(len(presses), config.alpha, self.fewest, self.augmentation.why)
            rng = np.random.default_rng(config.seed)
            self.folds, said = held_out_folds(self.specimens, config.folds, rng, self.fewest)
            self.warnings += said
        self.colours = nominal_colours(presses.frames)
        self.warnings += colour_warnings(self.colours)
        self.warnings += free_gel_warnings(presses)
        self.seconds: dict[str, float] = {}
        self.trunks = TrunkSessions(config.threads)

    def run(self) -> Fitted:
        features, no_contact = self._timed("features", self._features)
        nominal = Nominal(features, self.posed.touched, no_contact)
        self.warnings += feature_warnings(nominal, self.grid)
        self.limits = self._timed("threshold", self._limit_step)
        bank, scores, room = covering_bank(self.learner, nominal, self._learnt, self._limit)
        self.warnings += room_warnings(room)
        self.warnings += bank.facts.get("warnings", ())
        self.choice = self._timed("threshold", lambda: self._choice(bank, replace(nominal, room=room)))
        found = None if self.limits is None else self.limits.found(self.choice, self._unit(scores))
        self.warnings[:0] = unproven_warnings(self.pose.separated, found)
        head = self.learner.head(bank)
        if (chosen := self.choice.chosen) is not None:
            arrays = limit_arrays(chosen.limit)
            head, bank, scores = head_with_limit(head, arrays), bank_with(bank, arrays), chosen.scores
        self.relief = self._timed("threshold", lambda: self._relief(nominal, head))
        head, bank = with_relief(head, bank, self.relief, self._unit(scores))
        self.again = (
            {} if scores is None or self.limits is None else self.limits.known_scores(scores, self.choice)
        )
        self.graphs = Graphs(trunk=self.config.trunk.graph, head=head)
        self.apart = (
            [] if scores is None or len(scores) < MIN_PRESSES else apart_warnings(scores, self.presses.names)
        )
        self.warnings += self.apart
        return self._measured(bank, scores)

    @property
    def why_plain(self) -> str:
        """Why nothing is learnt from held-out presses but a threshold; empty where it is."""
        few = f"of fewer than {MIN_PRESSES} presses nothing can be held out to choose by"
        return self.config.why_plain or (few if len(self.presses) < MIN_PRESSES else "")

    def _limit_step(self) -> LimitStep | None:
        """None where no press is held out."""
        config = self.config
        if not self.is_held_out:
            return None
        view = config.profile, config.region
        return LimitStep(
            self.learner, self.posed, view, self._taken, self.folds, config.alpha, self.why_plain
        )

    def _choice(self, bank: Bank, nominal: Nominal) -> Choice:
        if self.limits is None:
            return Choice(PLAIN, self.why_plain)
        return self.limits.choice(bank, nominal)

    def _relief(self, nominal: Nominal, head: bytes) -> ReliefChoice:
        config = self.config
        if self.limits is None or self.why_plain:
            return ReliefChoice(self.why_plain)
        return relief_of(
            self.posed, (config.profile, config.region), nominal, self._taken, self.folds, self.learner, head
        )

    def _unit(self, scores: NDArray[np.float64] | None) -> float:
        """The score at the limit."""
        if self.choice.chosen is not None or scores is None:
            return 1.0
        return self._limit(scores).value

    def _learnt(self, nominal: Nominal) -> tuple[Bank, NDArray[np.float64] | None]:
        bank = self._timed("fit", lambda: self.learner.bank(nominal, self._progress("bank")))
        return bank, self._timed("threshold", lambda: self._held_out_scores(nominal))

    def _limit(self, scores: NDArray[np.float64], slack: float = 0.0) -> ThresholdEntry:
        return conformal_threshold(
            scores, self.config.alpha, slack, specimens=self.specimens, fewest=self.fewest
        )

    def _timed(self, stage: str, work: Callable[[], T]) -> T:
        start = time.perf_counter()
        result = work()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
        return result

    def _progress(self, stage: str) -> Progress:
        return lambda fraction: self.report(stage, fraction)

    def _features(self) -> tuple[Features, Features | None]:
        self.session = open_session(
            self.config.trunk.graph, self.config.threads, f"trunk '{self.config.trunk.id}'"
        )
        region = self.config.region
        self.grid = trunk_grid(
            self.session,
            self.detector.taps(self.parameters),
            (region.height, region.width),
            self.config.profile.pixels_per_mm,
        )
        self.learner = Learner(
            self.detector, self.grid, self.parameters, self.config.seed, self.config.threads
        )
        self.pose = self._pose()
        self.posed = self.pose.posed(self.presses)
        self.learner = replace(self.learner, copies=self._copies())
        features = extract(self.session, self.posed.frames, self.grid, self._progress("features"))
        free = self.presses.no_contact
        return features, None if free is None else self._taken(free)

    def _copies(self) -> Copies | None:
        config, is_registered = self.config, self.pose.learnt is not None
        self.augmentation = augmentation_of(
            config.augment, self.presses, self.detector.name, config.mode, is_registered
        )
        return Copies.of(
            self.presses,
            self.augmentation.each,
            config.profile.pixels_per_mm,
            config.seed,
            self._taken,
        )

    def _pose(self) -> PoseChoice:
        """How presses are registered; where they are not, a method that compares places needs them at one place."""
        config = self.config
        view = config.profile, config.region
        pose = chosen_pose(config.register, self.presses, self.learner, self._taken, view)
        if pose.learnt is None:
            self.warnings[:0] = scatter_warnings(
                self.presses, config.profile, self.detector, config.is_scattered, pose.why
            )
        return pose

    def _taken(self, frames: NDArray[np.uint8]) -> Features:
        return extract(self.session, frames, self.grid, lambda fraction: None)

    def _held_out_scores(self, nominal: Nominal) -> NDArray[np.float64] | None:
        """Anomaly scores of every press by a bank without it; None where the threshold is given."""
        return None if self.limits is None else self.limits.scores(nominal, self._progress("threshold"))

    def _measured(self, bank: Bank, scores: NDArray[np.float64] | None) -> Fitted:
        """Score with the bundle as it will be loaded, then record the measurements."""
        self.report("golden", 0.0)
        provisional = Fitted(*self._files(bank, self._facts(bank, *placeholders()), ()))
        scorer = Scorer(provisional.bundle(), self.config.threads, self.trunks)
        golden = golden_frames(scorer, self.posed.frames)
        black = np.zeros_like(self.presses.frames[0])
        black_score = scorer.score_in_pose(black).anomaly_score
        tolerance = measured_tolerance(scorer, golden, self.config.threads)
        cost = cost_card(scorer, self.posed.frames, self.config.threads, self.seconds)
        threshold = self._threshold(scores, tolerance, scorer)
        is_refused = refuses(self.colours, black)
        self.warnings += black_warnings(black_score, threshold, is_refused, self.apart)
        facts = self._facts(bank, threshold, tolerance).model_copy(update={"cost": cost})
        fitted = Fitted(*self._files(bank, facts, golden))
        Scorer(fitted.bundle(self.trunks), self.config.threads, self.trunks).check_golden()
        self.report("golden", 1.0)
        return fitted

    def _threshold(
        self, scores: NDArray[np.float64] | None, tolerance: ToleranceEntry, scorer: Scorer
    ) -> ThresholdEntry:
        alpha = self.config.alpha
        if self.config.threshold is not None:
            return given_threshold(self.config.threshold, alpha)
        if self.choice.chosen is not None:
            return self.choice.chosen.threshold
        if scores is None:  # one press: copies that the bank has not learnt
            rng = np.random.default_rng(self.config.seed + 1)
            fresh, _ = rendered_copies(self.presses, EACH, self.config.profile.pixels_per_mm, rng)
            return of_copies([scorer.score_in_pose(rgb).anomaly_score for rgb in fresh], alpha)
        return self._limit(scores, tolerance.around(float(scores.max())))

    def _files(
        self, bank: Bank, facts: Facts, golden: Sequence[GoldenFrame]
    ) -> tuple[Manifest, dict[str, bytes]]:
        with_trunk = self.config.with_trunk or not golden
        return bundle_files(
            facts,
            self.graphs,
            bank,
            golden,
            backbone=self.config.trunk.id,
            with_trunk=with_trunk,
            free_gel=self._free_gel(),
            free_view=self.presses.free_view,
            registration=None if self.pose.learnt is None else self.pose.learnt.part,
        )

    def _skipped(self) -> tuple[int, ...]:
        """The tiles that a press without contact there may skip: those that no nominal press touches."""
        tiles, touched = self.grid.tiles, self.posed.touched
        if tiles is None or touched is None or self.presses.no_contact is None:
            return ()
        return untouched_tiles(tiles, touched)

    def _free_gel(self) -> NDArray[np.uint8] | None:
        free = self.presses.no_contact
        return most_typical(free) if free is not None and self._skipped() else None

    def _facts(self, bank: Bank, threshold: ThresholdEntry, tolerance: ToleranceEntry) -> Facts:
        config = self.config
        return Facts(
            part=config.part,
            position=config.position,
            revision=config.revision,
            method=self.detector.name,
            mode=config.mode,
            parameters=_plain(self.parameters),
            repairs=tuple(bank.facts.get("repairs", ())),
            facts={
                "backbone": config.trunk.facts,
                **config.choice_facts,
                "limit": self.choice.facts(),
                MISSING: self.relief.facts(),
                **self.pose.facts,
                **self.augmentation.facts,
                **self.again,
                **gel_facts(config.gel_id),
                **{k: v for k, v in bank.facts.items() if k != "repairs"},
            },
            profile=ProfileEntry.of(config.profile),
            region=RegionEntry.of(config.region),
            grid=GridEntry.of(self.grid, self._skipped()),
            threshold=threshold,
            tolerance=tolerance,
            contact=contact_range(self.presses),
            colours=self.colours,
            provenance=provenance(self.created, self.presses, config.seed, self.warnings),
        )


def _plain(parameters: object) -> dict[str, Any]:
    if is_dataclass(parameters) and not isinstance(parameters, type):
        return asdict(parameters)
    return dict(vars(parameters))
