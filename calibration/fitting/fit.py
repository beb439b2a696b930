"""From nominal presses to a bundle: features, bank, out-of-fold threshold, tolerance, golden frames, files.

The detector has the mathematics; the procedure (which presses, which folds, which seed) is here.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from calibration.fitting import bundle_measurements as measuring
from calibration.fitting import self_check
from calibration.fitting.damage.damaged_presses import DamagedPresses, render_damage
from calibration.fitting.features import feature_warnings
from calibration.fitting.fit_config import FitConfig, Fitted
from calibration.fitting.limits.appended import append
from calibration.fitting.limits.folds import Folds, divide_presses
from calibration.fitting.limits.gel_limits import choose_limits
from calibration.fitting.limits.held_out import (
    Covered,
    HeldOut,
    Learner,
    ShownPresses,
    TapReader,
    covering_bank,
    score_held_out,
)
from calibration.fitting.limits.limit_choice import Choice, Evidence
from calibration.fitting.limits.map_limit import PLAIN
from calibration.fitting.limits.relief_step import ReliefChoice, try_relief
from calibration.fitting.limits.threshold import conformal_threshold, limit_promise, of_copies, require_enough
from calibration.fitting.pose.pose_decision import PoseChoice, choose_pose
from calibration.fitting.presses.augmentation import (
    EACH,
    Augmentation,
    Copies,
    Take,
    plan_copies,
    render_copies,
)
from calibration.fitting.presses.colours import colour_warnings, nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from calibration.fitting.presses.preparation import prepare_presses
from calibration.progress import Report, StageTimes
from calibration.threads import one_blas_thread
from edge.core.arrays import F64
from edge.core.detector import Bank, Nominal, Progress
from edge.core.registration.registrar import PartInPose
from edge.model.bundle import GoldenFrame, Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.manifest import (
    ColourEntry,
    DotsEntry,
    Facts,
    GridEntry,
    ThresholdEntry,
    ToleranceEntry,
)
from edge.model.manifest_facts import MISSING
from edge.model.scorer import Scorer
from edge.model.session import TrunkSessions
from edge.model.tile_runner import most_typical, untouched_tiles

__all__ = ["FitConfig", "Fitted", "fit_files"]

# The score maps of all presses are kept until a limit is chosen.
MEMORY_BYTES = 1 << 30


@one_blas_thread()
def fit_files(
    presses: NominalPresses, config: FitConfig, *, created: str, report: Report = lambda stage, fraction: None
) -> Fitted:
    """Fit a bundle in memory. created: the date for the provenance. Errors: FitError, ConfigError."""
    watch = StageTimes(report)
    plan = _plan_fit(prepare_presses(presses, config.profile.pixels_per_mm, config.mode), config)
    with watch.time("features"):
        features = _take_features(plan, partial(report, "features"))
    return _measure(_learn_bank(features, watch), created, watch)


@dataclass(frozen=True, eq=False)
class _Plan:
    """What is known of a fit before the trunk has seen a press."""

    presses: NominalPresses
    config: FitConfig
    parameters: Any
    folds: Folds | None
    """The presses that are held out together; None where none is."""
    fewest: int
    """Presses that a threshold needs."""
    colours: ColourEntry | None
    warnings: Sequence[str]

    @property
    def why_plain(self) -> str:
        """The reason why nothing is learnt from held-out presses but a threshold; empty where it is."""
        few = f"of fewer than {MIN_PRESSES} presses nothing can be held out to choose by"
        return self.config.why_plain or (few if len(self.presses) < MIN_PRESSES else "")

    @property
    def why_unrendered(self) -> str:
        """The reason why no damage is rendered into held-out presses; empty where it is."""
        if not self.why_plain and 4 * int(np.prod(self.presses.frames.shape[:3])) > MEMORY_BYTES:
            return f"the score maps of {len(self.presses)} presses take more memory than a choice may use"
        return self.why_plain

    def augment(self, is_registered: bool = False) -> Augmentation:
        """Decide on copies of the presses. Errors: FitError where they are asked for in vain."""
        config = self.config
        return plan_copies(config.augment, self.presses, config.detector.name, config.mode, is_registered)

    def find_threshold(self, scores: F64, slack: float = 0.0) -> ThresholdEntry:
        pieces = self.presses.specimens
        return conformal_threshold(scores, self.config.alpha, slack, specimens=pieces, fewest=self.fewest)


def _plan_fit(presses: NominalPresses, config: FitConfig) -> _Plan:
    """Check the presses and divide them into folds. Errors: FitError."""
    promised = config.alpha if config.threshold is None else None
    sentences = measuring.warnings(presses, (config.region.height, config.region.width), promised)
    colours = nominal_colours(presses.frames)
    parameters = config.detector.parameters(config.mode, **config.overrides)
    plan = _Plan(presses, config, parameters, None, MIN_PRESSES, colours, ())
    augmentation, folds, few_pieces = plan.augment(), None, list[str]()
    fewest = 2 if augmentation.each and len(presses) < MIN_PRESSES else MIN_PRESSES
    if config.threshold is None and not (augmentation.each and len(presses) == 1):
        require_enough(len(presses), config.alpha, fewest, augmentation.why)
        rng = np.random.default_rng(config.seed)
        folds, few_pieces = divide_presses(presses.specimens, config.folds, rng, fewest, presses.film)
    sentences += [
        *(few_pieces or measuring.rate_warnings(presses.specimens, promised)),
        *(self_check.drift_warnings(presses, config.profile) if promised else ()),
        *colour_warnings(colours),
    ]
    return replace(plan, folds=folds, fewest=fewest, warnings=sentences)


@dataclass(frozen=True, eq=False)
class _Features:
    """What the trunk shows of the presses, in the pose in which the bank learns them."""

    plan: _Plan
    take: Take
    learner: Learner
    pose: PoseChoice
    presses: NominalPresses
    nominal: Nominal
    augmentation: Augmentation
    warnings: Sequence[str]

    def render_damage(self) -> tuple[DamagedPresses | None, ShownPresses | None, str]:
        """Render damage by which a limit is chosen, as the gateway shows it; None, and why, for the plain limit."""
        plan, rng = self.plan, np.random.default_rng(self.learner.seed)
        if plan.why_unrendered or plan.folds is None:
            return None, None, plan.why_unrendered
        damage = render_damage(plan.presses, *plan.config.view, rng)
        if damage is None:
            return None, None, "no contact is seen; give a picture of the free gel with --no-contact"
        return *self.pose.show_damage(damage, self.take, plan.presses.unjudged), ""

    def prove_pose(self, held_out: HeldOut | None, damage: DamagedPresses | None) -> "_Features":
        """Prove registration by held-out presses. Errors: FitError where they show nothing."""
        if not self.pose.is_open:
            return self
        presses, config = self.plan.presses, self.plan.config
        pose = self.pose.prove(held_out, damage)
        if pose.learnt is None:
            self_check.scatter_warnings(presses, config.profile, config.detector, why_unregistered=pose.why)
        return replace(self, pose=pose)

    def gather_evidence(self, covered: Covered, damage: DamagedPresses) -> Evidence:
        """Gather what a limit is chosen by."""
        held_out, known = covered.held_out, covered.known
        assert held_out is not None
        assert known is not None
        plan, black, seen = self.plan, np.zeros_like(self.presses.frames[:1]), None
        if not refuses(plan.colours, black[0]):
            seen = self.learner.score(covered.bank, self.take(black), [0])
        folds, pieces, mm = plan.folds or [], plan.presses.specimens, self.learner.grid.pixels_per_mm
        return Evidence(held_out, known, seen, damage, folds, pieces, plan.config.alpha, mm)

    def choose_relief(self, head: bytes, shown: ShownPresses, unit: float) -> ReliefChoice:
        """Learn from presses as the gateway shows them to the bank. shown: the nominal ones. unit: the score at the
        limit."""
        plan, view = self.plan, self.plan.config.view
        if plan.folds is None or plan.why_plain:
            return ReliefChoice(plan.why_plain)
        if not unit > 0:
            return ReliefChoice(f"the limit is {unit:.4g}, and only in units of one above 0 it counts")
        nominal, take = replace(self.nominal, features=shown.features), self.pose.take_shown(self.take)
        return try_relief(plan.presses, view, nominal, take, plan.folds, self.learner, head)

    @property
    def skipped_tiles(self) -> tuple[int, ...]:
        """The tiles that a press without contact there may skip: those that no nominal press touches."""
        tiles, touched = self.learner.grid.tiles, self.presses.touched
        if tiles is None or touched is None or self.presses.no_contact is None:
            return ()
        return untouched_tiles(tiles, touched)


def _take_features(plan: _Plan, progress: Progress) -> _Features:
    """Bring the presses to one pose where that pays, and take their features. Errors: FitError."""
    config, presses = plan.config, plan.presses
    taps, frame = config.detector.taps(plan.parameters), (config.region.height, config.region.width)
    name = f"trunk '{config.trunk.id}'"
    reader = TapReader(config.trunk.graph, taps, frame, config.profile.pixels_per_mm, config.threads, name)
    learner, take = reader.learner(config.detector, plan.parameters, config.seed), reader.take
    is_held_out = not (plan.folds is None or plan.why_unrendered or config.is_scattered)
    pose = choose_pose(config.how_registered, presses, learner, take, config.view, is_held_out, config.pose)
    sentences: list[str] = []
    if pose.learnt is None:  # a method that compares places needs the presses at one place
        sentences = self_check.scatter_warnings(
            presses, config.profile, config.detector, config.is_scattered, pose.why
        )
    posed = pose.apply(presses)
    augmentation = plan.augment(pose.learnt is not None)
    copies = Copies.of(posed, augmentation.each, config.profile.pixels_per_mm, config.seed, take)
    nominal = reader.nominal(posed, progress)
    sentences += [
        *plan.warnings,
        *pose.find_warnings(presses.names, presses.faults),
        *feature_warnings(nominal, reader.grid),
    ]
    learner = replace(learner, copies=copies)
    return _Features(plan, take, learner, pose, posed, nominal, augmentation, sentences)


@dataclass(frozen=True, eq=False)
class _Learnt:
    """A bank with its limit, whose scores are those of the bundle."""

    features: _Features
    part: PartInPose | None
    """None where presses are scored as they lie."""
    bank: Bank
    head: bytes
    choice: Choice
    scores: F64 | None
    """Scores of the nominal presses; None where no press is held out."""
    facts: Mapping[str, Any]
    """What was decided, for the manifest."""
    apart: Sequence[str]
    """A sentence for each press that stands apart."""
    warnings: Sequence[str]

    def find_threshold(self, tolerance: ToleranceEntry, scorer: Scorer) -> ThresholdEntry:
        plan, config = self.features.plan, self.features.plan.config
        if config.threshold is not None:
            return measuring.state_threshold(config.threshold, config.alpha)
        if self.scores is None:  # one press: copies that the bank has not learnt
            rng = np.random.default_rng(config.seed + 1)
            fresh, _ = render_copies(plan.presses, EACH, config.profile.pixels_per_mm, rng)
            return of_copies([scorer.score_in_pose(rgb).anomaly_score for rgb in fresh], config.alpha)
        other, slack = self.choice.other, tolerance.around(float(self.scores.max()))
        threshold = other.threshold if other is not None else plan.find_threshold(self.scores, slack)
        return limit_promise(threshold, plan.presses.specimens, plan.folds or [])


def _learn_bank(features: _Features, watch: StageTimes) -> _Learnt:
    """Learn the bank, and find the limit that it is to have. Errors: FitError."""
    plan, learner, nominal = features.plan, features.learner, features.nominal
    with watch.time("threshold"):
        shown = features.pose.show(nominal, features.take, plan.presses)
        damage, damaged, why_plain = features.render_damage()
        edited = None if damage is None or damaged is None else (damaged, damage.press)

    def learn(roomy: Nominal) -> tuple[Bank, HeldOut | None]:
        with watch.time("fit"):
            bank = learner.bank(roomy, partial(watch.report, "bank"))
        if plan.folds is None:
            return bank, None
        with watch.time("threshold"):
            report = partial(watch.report, "threshold")
            return bank, score_held_out(learner, roomy, plan.folds, edited, report, shown)

    covered = covering_bank(learner, nominal, learn, lambda found: plan.find_threshold(found).value, shown)
    with watch.time("features"):
        features = features.prove_pose(covered.held_out, damage)
    bank, scores = covered.bank, covered.scores
    head, choice, damage_found, again = learner.head(bank), Choice(PLAIN, why_plain), None, {}
    remedies: Callable[[], Sequence[str]] = tuple
    part = None if features.pose.learnt is None else features.pose.learnt.part
    unit = 1.0 if scores is None else plan.find_threshold(scores).value
    with watch.time("threshold"):
        if damage is not None and damaged is not None and scores is not None:
            chosen = choose_limits(features.gather_evidence(covered, damage), shown, damaged, head)
            choice, evidence, scores = chosen.choice, chosen.evidence, chosen.scores
            part = chosen.extend(part)
            if choice.other is not None:
                head, bank = append(head, bank, choice.other.limit)
            unit = 1.0 if choice.other else plan.find_threshold(scores).value
            damage_found, again = evidence.count_found(choice), evidence.press_again_facts(choice, scores)
            roomy = learner, replace(nominal, room=covered.room)
            more = partial(self_check.find_remedies, evidence, choice, plan.presses, plan.config.profile)
            remedies = partial(more, partial(score_held_out, *roomy, edited=edited, shown=shown))
            again |= self_check.damage_facts(damage_found, more)
            unit *= chosen.highest_limit
        relief = features.choose_relief(head, shown, unit)
    head, bank = relief.append_to(head, bank, unit)
    apart = self_check.apart_warnings(scores, plan.presses.names)
    unrendered = "" if plan.config.why_plain else why_plain
    sentences = [
        *self_check.unproven_warnings(features.pose.separated, damage_found, remedies, unrendered),
        *features.warnings,
        *self_check.room_warnings(covered.room),
        *covered.bank.facts.get("warnings", ()),
        *apart,
    ]
    decided = {"limit": choice.facts(), MISSING: relief.facts(), **features.pose.facts}
    decided |= {**features.augmentation.facts, **again, **plan.presses.facts}
    return _Learnt(
        features, part, bank, head, choice, scores, decided, apart, self_check.unproven_first(sentences)
    )


def _measure(learnt: _Learnt, created: str, watch: StageTimes) -> Fitted:
    """Score with the bundle as it will be loaded, then record the measurements. Errors: FitError."""
    watch.report("golden", 0.0)
    features, plan, threads = learnt.features, learnt.features.plan, learnt.features.plan.config.threads
    trunks, facts = TrunkSessions(threads), _facts(learnt, created)
    scorer = Scorer(_pack(learnt, facts, ()).bundle(), threads, trunks)
    golden = measuring.golden_frames(scorer, features.presses.frames, learnt.scores)
    tolerance = measuring.measure_tolerance(scorer, golden, threads)
    cost = measuring.cost_card(scorer, features.presses.frames, threads, watch.seconds)
    threshold = learnt.find_threshold(tolerance, scorer)
    black = np.zeros_like(plan.presses.frames[0])
    black_score, is_refused = scorer.score_in_pose(black).anomaly_score, refuses(plan.colours, black)
    sentences = *learnt.warnings, *self_check.black_warnings(black_score, threshold, is_refused, learnt.apart)
    proven = facts.provenance.model_copy(update={"warnings": sentences})
    measured = {"threshold": threshold, "tolerance": tolerance, "cost": cost, "provenance": proven}
    fitted = _pack(learnt, facts.model_copy(update=measured), golden)
    Scorer(fitted.bundle(trunks), threads, trunks).check_golden()
    watch.report("golden", 1.0)
    return replace(fitted, apart=tuple(plan.presses.names[k] for k in self_check.list_apart(learnt.scores)))


def _pack(learnt: _Learnt, facts: Facts, golden: Sequence[GoldenFrame]) -> Fitted:
    """Make the bundle. golden: none for one that is only measured."""
    features, config = learnt.features, learnt.features.plan.config
    presses, free = features.plan.presses, features.plan.presses.no_contact
    parts = facts, Graphs(config.trunk.graph, learnt.head), learnt.bank, golden
    files = bundle_files(
        *parts,
        backbone=config.trunk.id,
        with_trunk=config.with_trunk or not golden,
        free_gel=most_typical(free) if free is not None and features.skipped_tiles else None,
        free_view=presses.free_view,
        registration=learnt.part,
        nominal_pictures=measuring.picture_presses(features.presses, config.detector),
    )
    return Fitted(*files)


def _facts(learnt: _Learnt, created: str) -> Facts:
    """Return the facts of a bundle that is only measured: with this threshold every press fails."""
    features, plan = learnt.features, learnt.features.plan
    config, facts = plan.config, learnt.bank.facts
    threshold, tolerance = measuring.placeholders()
    return Facts(
        part=config.part,
        position=config.position,
        revision=config.revision,
        method=config.detector.name,
        mode=config.mode,
        parameters=dict(vars(plan.parameters)),
        repairs=tuple(facts.get("repairs", ())),
        facts={
            "backbone": config.trunk.facts,
            **learnt.facts,
            **config.facts,
            **{k: v for k, v in facts.items() if k != "repairs"},
        },
        profile=config.profile,
        region=config.region,
        grid=GridEntry.of(features.learner.grid, features.skipped_tiles),
        threshold=threshold,
        tolerance=tolerance,
        contact=measuring.contact_range(plan.presses),
        strength=measuring.strength_range(plan.presses),
        colours=plan.colours,
        dots=None if plan.presses.dots is None else DotsEntry.of(plan.presses.dots),
        is_smoothed=plan.presses.raw is not None,
        provenance=measuring.provenance(created, plan.presses, config.seed, learnt.warnings),
    )
