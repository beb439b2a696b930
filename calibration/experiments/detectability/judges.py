"""One trial: the smallest size of damage, at one spot of one press, that the bundle's verdict finds."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.fitting.damage.damage import KINDS, Damage, Spot, surroundings
from calibration.fitting.damage.rendering import EditedPress
from calibration.fitting.limits.appended import append
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, TapReader
from calibration.fitting.pose.registration import in_pose_of
from calibration.fitting.presses.augmentation import Copies
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.presses.preparation import prepare_as
from edge import registry
from edge.core.arrays import U8
from edge.core.detector import Nominal
from edge.core.errors import DatasetError, PoseNotFound
from edge.core.printable import write_count
from edge.core.verdict import Kind as Result
from edge.model.bundle import Bundle, Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.detectability import JudgedBy
from edge.model.manifest import Manifest
from edge.model.manifest_facts import MISSING, copies_of_each
from edge.model.scorer import Scored, Scorer
from edge.model.session import TrunkSessions

__all__ = ["MIN_PRESSES", "Judge", "choose_judges", "sizes_mm", "smallest_found"]

# The smallest size tried, as a share of the largest, and the number of sizes: each is 1.13 times the one before.
_SMALLEST_SHARE, _SIZES = 1 / 50, 33


def sizes_mm(kind: str) -> tuple[float, ...]:
    """The sizes that are tried, rising by equal factors."""
    largest = KINDS[kind].largest_mm
    return tuple(round(float(a), 5) for a in np.geomspace(_SMALLEST_SHARE * largest, largest, _SIZES))


def smallest_found(is_found: Callable[[float], bool], sizes: Sequence[float]) -> tuple[float, float]:
    """The smallest size that is found, as (largest missed, smallest found], by halving.

    (0, a] where the first is found already, (a, inf) where the last is missed. Larger damage is taken to be found if
    smaller damage is: sizes between are not tried.
    """
    if not is_found(sizes[-1]):
        return sizes[-1], math.inf
    missed, hit = -1, len(sizes) - 1
    while hit - missed > 1:
        middle = (missed + hit) // 2
        missed, hit = (missed, middle) if is_found(sizes[middle]) else (middle, hit)
    return (0.0 if missed < 0 else sizes[missed]), sizes[hit]


@dataclass(frozen=True, eq=False)
class Judge:
    """The verdict on one press by a bank that has not learnt it."""

    scorer: Scorer
    manifest: Manifest
    """The manifest with the limit and its tolerance."""

    def passes(self, rgb: U8) -> bool:
        """Say whether the press passes as it is. Errors: NotScorable."""
        return self._result(self.scorer.score(rgb)) is Result.PASS

    def finds(self, press: EditedPress, damage: Damage) -> bool:
        """Say whether the press with the damage fails and its map is highest on the damage. Errors: NotScorable.

        A press whose part is not recognised any more is rejected, which finds no damage.
        """
        try:
            scored = self.scorer.score(press.render(damage))
        except PoseNotFound:
            return False
        if self._result(scored) is not Result.FAIL:
            return False
        row, column = np.unravel_index(int(scored.score_map.argmax()), scored.score_map.shape)
        return bool(surroundings(damage, press.station.field)[row, column])

    def bracket(self, press: EditedPress, kind: str, spot: Spot) -> tuple[float, float]:
        """The smallest size found at that spot, (missed, found] in mm. Errors: NotScorable."""
        return smallest_found(lambda size: self.finds(press, Damage(kind, size, spot)), sizes_mm(kind))

    def _result(self, scored: Scored) -> Result:
        return self.manifest.decide(scored.anomaly_score).kind


MIN_PRESSES = 4
"""Of presses to edit: with fewer no bound is known at a place."""

_FOLDS = 5

Advance = Callable[[float], None]


def choose_judges(
    bundle: Bundle, presses: NominalPresses, seed: int, threads: int, progress: Advance
) -> tuple[dict[int, Judge], JudgedBy]:
    """Choose the presses that may be edited, by their index in a random order, each with its judge.

    These are the presses apart from the fit where there are enough, else the learnt ones. Errors: DatasetError for too
    few presses, or learnt ones that are not complete.
    """
    learnt = [k for k, name in enumerate(presses.names) if name in bundle.manifest.provenance.presses]
    apart = _apart(bundle, presses)
    is_foreign = bundle.manifest.detector is not None
    if is_foreign or len(apart) >= MIN_PRESSES:
        chosen = _shuffle([*learnt, *apart] if is_foreign else apart, seed)
        judge = Judge(Scorer(bundle, threads), bundle.manifest)
        return dict.fromkeys(chosen, judge), "third party's graph" if is_foreign else "presses apart"
    _require_complete(bundle, len(learnt), len(apart))
    judges = _fold_judges(bundle, presses.choose(learnt), threads, progress)
    return {k: judges[learnt.index(k)] for k in _shuffle(learnt, seed)}, "folds"


def _apart(bundle: Bundle, presses: NominalPresses) -> list[int]:
    """The presses that the fit neither learnt nor left out. Errors: DatasetError where one was under another name."""
    origin = bundle.manifest.provenance
    known = {*origin.presses, *origin.left_out}
    apart = [k for k, name in enumerate(presses.names) if name not in known]
    golden, prepared = {frame.rgb.tobytes() for frame in bundle.golden}, prepare_as(bundle, presses)
    for k in apart:
        if prepared.frames[k].tobytes() in golden:
            raise DatasetError(
                f"press {presses.names[k]} is one that bundle {bundle.where} has learnt, under another name; give the "
                "sources of the fit as they were, or presses that it has not learnt"
            )
    return apart


def _require_complete(bundle: Bundle, found: int, apart: int) -> None:
    """Check that a bank without a press can be fitted as the bundle was. Errors: DatasetError."""
    expected = len(bundle.manifest.provenance.presses)
    if found == expected >= MIN_PRESSES:
        return
    raise DatasetError(
        f"{apart} presses that bundle {bundle.where} has not learnt were given, and {found} of the {expected} that it "
        f"has; give at least {MIN_PRESSES} that it has not learnt, or all {expected} others: then banks are fitted "
        "without each"
    )


def _shuffle(indices: Sequence[int], seed: int) -> list[int]:
    """Shuffle indices by the seed. Errors: DatasetError for too few."""
    if len(indices) < MIN_PRESSES:
        raise DatasetError(
            f"{write_count(len(indices), 'press')} to edit, at least {MIN_PRESSES} are needed for a "
            "probability of detection; give more presses"
        )
    return [indices[k] for k in np.random.default_rng(seed).permutation(len(indices)).tolist()]


def _fold_judges(bundle: Bundle, learnt: NominalPresses, threads: int, progress: Advance) -> dict[int, Judge]:
    """Repeat the bundle's own fit without a fold each, as for the threshold: the judge of each learnt press.

    Errors: FitError.
    """
    learner, nominal = _learner(bundle, learnt, threads)
    specimens = learnt.specimens or (None,) * len(learnt)
    folds, _ = divide_presses(specimens, _FOLDS, np.random.default_rng(learner.seed))
    tap = bundle.manifest.facts.get(MISSING, {}).get("tap", "")
    trunks, backbone = TrunkSessions(threads), bundle.manifest.backbone
    assert backbone is not None
    judges: dict[int, Judge] = {}
    for number, held in enumerate(folds, start=1):
        bank = learner.bank_without(nominal, held)
        head, bank = append(learner.head(bank), bank, bundle.bank, tap)
        manifest, files = bundle_files(
            bundle.manifest,
            Graphs(trunk=bundle.graphs.trunk, head=head),
            bank,
            backbone=backbone.id,
            free_gel=bundle.free_gel,
            free_view=bundle.free_view,
            registration=bundle.registration,
        )
        where = f"{bundle.where} without {len(held)} presses"
        scorer = Scorer(Bundle.in_memory(manifest, files, where, loaded=trunks), threads, trunks)
        judges |= dict.fromkeys(held.tolist(), Judge(scorer, bundle.manifest))
        progress(number / len(folds))
    return judges


def _learner(bundle: Bundle, learnt: NominalPresses, threads: int) -> tuple[Learner, Nominal]:
    """The bundle's detector with its settings, and what it learnt."""
    manifest, part, scale = bundle.manifest, bundle.registration, bundle.profile.pixels_per_mm
    detector, seed = registry.detector(manifest.method), manifest.provenance.seed or 0
    settings = {name: value for name, value in manifest.parameters.items() if name != "mode"}
    parameters = detector.parameters(manifest.mode or "corrected", **settings)
    learnt = prepare_as(bundle, learnt)
    trunk, frame = bundle.graphs.trunk or b"", learnt.frames.shape[1:3]
    where = f"bundle {bundle.where}: trunk.onnx"
    reader = TapReader(trunk, detector.taps(parameters), frame, scale, threads, where)
    copies = Copies.of(learnt, copies_of_each(manifest.facts), scale, seed, reader.take)
    posed = learnt if part is None else replace(learnt, frames=in_pose_of(part, learnt.frames), touched=None)
    learner = replace(reader.learner(detector, parameters, seed), copies=copies)
    return learner, reader.nominal(posed)
