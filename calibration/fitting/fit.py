"""From nominal presses to a bundle: features, bank, out-of-fold threshold, tolerance, golden frames, files.

A detector's mathematics is its own; the procedure (which presses, which folds, which seed) is here.
"""

import time
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from calibration.fitting.bundle_measurements import (
    contact_range,
    cost_card,
    given_threshold,
    golden_frames,
    measured_tolerance,
    placeholders,
    provenance,
    scatter_warnings,
    warnings,
)
from calibration.fitting.colours import colour_warnings, nominal_colours
from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.heads import check_head, head_of
from calibration.fitting.nominal_presses import NominalPresses
from calibration.fitting.threshold import check_alpha, conformal_threshold, folds
from calibration.fitting.trunks import Trunk
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.detector import Bank, Detector, Features, Mode, Nominal, Progress
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import Bundle, GoldenFrame, Graphs, bundle_files, write_bundle
from edge.model.manifest import (
    Facts,
    GridEntry,
    Manifest,
    ProfileEntry,
    RegionEntry,
    ThresholdEntry,
    ToleranceEntry,
)
from edge.model.packing import pack, unpack
from edge.model.scorer import Scorer
from edge.model.session import RUNTIME_ERRORS, TrunkSessions, open_session
from edge.model.tile_runner import plainest, untouched_tiles

T = TypeVar("T")

__all__ = ["Fitted", "Recipe", "fit_bundle", "fit_files"]


@dataclass(frozen=True)
class Recipe:
    """What is to be made.

    overrides: the detector's parameters that differ from the mode's. alpha: the false-alarm rate asked for.
    threshold: a value to use instead of one found from presses. seed: fixes every random choice. folds: banks fitted
    to find the threshold; each costs about as much as the bank itself. with_trunk: False leaves it to the store.
    is_scattered: contacts that lie anywhere are meant, also for a method that compares place with place.
    """

    part: str
    position: str
    profile: SensorProfile
    region: Region
    detector: Detector
    trunk: Trunk
    mode: Mode = "corrected"
    overrides: Mapping[str, object] = field(default_factory=dict)
    alpha: float = 0.05
    threshold: float | None = None
    seed: int = 0
    threads: int = 2
    folds: int = 5
    with_trunk: bool = True
    is_scattered: bool = False

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        if self.folds < 2:
            raise FitError(f"a threshold needs at least 2 folds, found {self.folds}")


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
    recipe: Recipe,
    *,
    created: str,
    report: Report = lambda stage, fraction: None,
    overwrite: bool = False,
) -> Path:
    """Fit and write a bundle, a folder or (name ending in .zip) a zip; whole or not at all.

    created: the date for the provenance. Errors: FitError, ConfigError, FileExistsError, OSError.
    """
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already; choose another name or allow it to be replaced")
    fitted = fit_files(presses, recipe, created=created, report=report)
    report("write", 0.0)
    write_bundle(path, fitted.files, overwrite=overwrite)
    report("write", 1.0)
    return path


@one_blas_thread()
def fit_files(
    presses: NominalPresses, recipe: Recipe, *, created: str, report: Report = lambda stage, fraction: None
) -> Fitted:
    """Fit a bundle in memory. Errors as `fit_bundle`."""
    return _Fit(presses, recipe, created, report).run()


class _Fit:
    """One fit. Its stages are the methods in the order in which `run` calls them."""

    def __init__(self, presses: NominalPresses, recipe: Recipe, created: str, report: Report) -> None:
        self.presses, self.recipe, self.created, self.report = presses, recipe, created, report
        self.detector = recipe.detector
        self.parameters = self.detector.parameters(recipe.mode, **recipe.overrides)
        promised = recipe.alpha if recipe.threshold is None else None
        self.warnings = warnings(presses, (recipe.region.height, recipe.region.width), promised)
        if recipe.threshold is None:
            conformal_threshold(
                np.zeros(len(presses)), recipe.alpha
            )  # refuses too few before any work is done
        self.colours = nominal_colours(presses.frames)
        self.warnings += colour_warnings(self.colours)
        self.warnings += scatter_warnings(presses, recipe.profile, self.detector, recipe.is_scattered)
        self.seconds: dict[str, float] = {}
        self.trunks = TrunkSessions(recipe.threads)

    def run(self) -> Fitted:
        features, no_contact = self._timed("features", self._features)
        nominal = Nominal(features, self.presses.touched, no_contact)
        bank = self._timed("fit", lambda: self._bank(nominal, self._progress("bank")))
        self.warnings += bank.facts.get("warnings", ())
        head = head_of(self.detector, self.grid, bank, self.parameters)
        self.graphs = Graphs(trunk=self.recipe.trunk.graph, head=head)
        scores = self._timed("threshold", lambda: self._held_out_scores(nominal))
        return self._measured(bank, scores)

    def _timed(self, stage: str, work: Callable[[], T]) -> T:
        start = time.perf_counter()
        result = work()
        self.seconds[stage] = time.perf_counter() - start
        return result

    def _progress(self, stage: str) -> Progress:
        return lambda fraction: self.report(stage, fraction)

    def _features(self) -> tuple[Features, Features | None]:
        session = open_session(
            self.recipe.trunk.graph, self.recipe.threads, f"trunk '{self.recipe.trunk.id}'"
        )
        region = self.recipe.region
        self.grid = trunk_grid(
            session,
            self.detector.taps(self.parameters),
            (region.height, region.width),
            self.recipe.profile.pixels_per_mm,
        )
        check_head(self.detector, self.grid, self.parameters)
        features = extract(session, self.presses.frames, self.grid, self._progress("features"))
        free = self.presses.no_contact
        return features, None if free is None else extract(session, free, self.grid, lambda fraction: None)

    def _bank(self, nominal: Nominal, progress: Progress) -> Bank:
        rng = np.random.default_rng(self.recipe.seed)
        return self.detector.fit(nominal, self.grid, self.parameters, rng, progress)

    def _held_out_scores(self, nominal: Nominal) -> NDArray[np.float64] | None:
        """Anomaly scores of every press by a bank that did not know it; None where the threshold is given."""
        if self.recipe.threshold is not None:
            return None
        specimens = self.presses.specimens or (None,) * len(self.presses)
        if None not in specimens and len(set(specimens)) < 2:
            self.warnings.append(
                "all presses are of one specimen: the threshold knows nothing of other parts"
            )
            specimens = (None,) * len(self.presses)
        parts = folds(specimens, self.recipe.folds, np.random.default_rng(self.recipe.seed))
        scores = np.empty(len(self.presses))
        for number, held in enumerate(parts):
            scores[held] = self._scores_without(nominal, held)
            self.report("threshold", (number + 1) / len(parts))
        return scores

    def _scores_without(self, nominal: Nominal, held: NDArray[np.int64]) -> NDArray[np.float64]:
        kept = np.setdiff1d(np.arange(len(self.presses)), held)
        rest = Nominal(_chosen(nominal.features, kept), nominal.touched, nominal.no_contact)
        bank = self._bank(rest, lambda fraction: None)
        head = open_session(
            head_of(self.detector, self.grid, bank, self.parameters),
            self.recipe.threads,
            f"head of {self.detector.name}",
        )
        wanted = {i.name for i in head.get_inputs()}
        stored = {name: _as_stored(bank, name) for name in bank.arrays if name in wanted}
        taps = {tap: maps for tap, maps in nominal.features.items() if tap in wanted}
        return np.array([_head_score(head, {**_chosen(taps, np.array([k])), **stored}) for k in held])

    def _measured(self, bank: Bank, scores: NDArray[np.float64] | None) -> Fitted:
        """Score with the bundle as it will be loaded, then write down what it measured."""
        self.report("golden", 0.0)
        provisional = Fitted(*self._files(bank, self._facts(bank, *placeholders()), ()))
        scorer = Scorer(provisional.bundle(), self.recipe.threads, self.trunks)
        golden = golden_frames(scorer, self.presses.frames)
        tolerance = measured_tolerance(scorer, golden, self.recipe.threads)
        cost = cost_card(scorer, self.presses.frames, self.recipe.threads, self.seconds)
        threshold = self._threshold(scores, tolerance)
        facts = self._facts(bank, threshold, tolerance).model_copy(update={"cost": cost})
        fitted = Fitted(*self._files(bank, facts, golden))
        Scorer(fitted.bundle(self.trunks), self.recipe.threads, self.trunks).check_golden()
        self.report("golden", 1.0)
        return fitted

    def _threshold(self, scores: NDArray[np.float64] | None, tolerance: ToleranceEntry) -> ThresholdEntry:
        alpha = self.recipe.alpha
        if self.recipe.threshold is not None:
            return given_threshold(self.recipe.threshold, alpha)
        if scores is None:
            raise FitError("no threshold: neither given nor found from the presses")
        return conformal_threshold(scores, alpha, slack=tolerance.around(float(scores.max())))

    def _files(
        self, bank: Bank, facts: Facts, golden: Sequence[GoldenFrame]
    ) -> tuple[Manifest, dict[str, bytes]]:
        with_trunk = self.recipe.with_trunk or not golden
        return bundle_files(
            facts,
            self.graphs,
            bank,
            golden,
            backbone=self.recipe.trunk.id,
            with_trunk=with_trunk,
            free_gel=self._free_gel(),
        )

    def _skipped(self) -> tuple[int, ...]:
        """The tiles that a press without contact there may skip: those that no nominal press touches."""
        tiles, touched = self.grid.tiles, self.presses.touched
        if tiles is None or touched is None or self.presses.no_contact is None:
            return ()
        return untouched_tiles(tiles, touched)

    def _free_gel(self) -> NDArray[np.uint8] | None:
        free = self.presses.no_contact
        return plainest(free) if free is not None and self._skipped() else None

    def _facts(self, bank: Bank, threshold: ThresholdEntry, tolerance: ToleranceEntry) -> Facts:
        recipe = self.recipe
        return Facts(
            part=recipe.part,
            position=recipe.position,
            method=self.detector.name,
            mode=recipe.mode,
            parameters=_plain(self.parameters),
            repairs=tuple(bank.facts.get("repairs", ())),
            facts={"backbone": recipe.trunk.facts, **{k: v for k, v in bank.facts.items() if k != "repairs"}},
            profile=ProfileEntry.of(recipe.profile),
            region=RegionEntry.of(recipe.region),
            grid=GridEntry.of(self.grid, self._skipped()),
            threshold=threshold,
            tolerance=tolerance,
            contact=contact_range(self.presses),
            colours=self.colours,
            provenance=provenance(self.created, self.presses, recipe.seed, self.warnings),
        )


def _chosen(features: Features, rows: NDArray[np.int64]) -> Features:
    return {tap: maps[rows] for tap, maps in features.items()}


def _head_score(head: ort.InferenceSession, inputs: Mapping[str, NDArray[Any]]) -> float:
    """The anomaly score of one press. Errors: FitError."""
    try:
        return float(head.run(["score"], dict(inputs))[0][0])
    except RUNTIME_ERRORS as error:
        raise FitError(f"the head does not run on a fold of the presses: {error!s:.300}") from error


def _as_stored(bank: Bank, name: str) -> NDArray[Any]:
    """A bank array as it will be after being stored and loaded."""
    packing = bank.packing.get(name, "none")
    try:
        return unpack(pack(bank.arrays[name], packing), packing)
    except ValueError as error:
        raise FitError(f"bank array '{name}' cannot be stored: {error}") from error


def _plain(parameters: object) -> dict[str, Any]:
    if is_dataclass(parameters) and not isinstance(parameters, type):
        return asdict(parameters)
    return dict(vars(parameters))
