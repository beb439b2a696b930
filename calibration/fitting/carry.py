"""A bundle carried over to another gel of its sensor by a few presses: the bank stays, its threshold is found again.

The trunk and the bank hold what the part looks like, and lose little by a new gel; the scores shift, so the threshold,
the coarse colours, the free gel and the golden frames are those of the new gel. Missing relief is no score of the
method: as much as failed before fails at the new threshold. docs/gel.md has the measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from calibration.fitting import bundle_measurements as measuring
from calibration.fitting.bundle_measurements import golden_frames, measure_tolerance, score_again
from calibration.fitting.fit import Fitted
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.fitting.presses.colours import colour_warnings, nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.presses.preparation import smooth_presses, take_out_dots
from calibration.fitting.self_check import apart_warnings, black_warnings, list_apart, unproven_first
from edge.core.arrays import F64
from edge.core.contact.wear import wear
from edge.core.errors import FitError, PoseNotFound
from edge.core.imaging.sensor_check import colour_cells, is_other_kind
from edge.model.bundle import Bundle
from edge.model.bundle_writer import facts_of, rewrite_files
from edge.model.detectability import CARD
from edge.model.manifest import DotsEntry, Facts, ThresholdEntry, ToleranceEntry
from edge.model.manifest_facts import DAMAGE_FOUND, LIMIT, MISSING, UNPROVEN, gel_facts
from edge.model.scorer import Scorer
from edge.model.tile_runner import most_typical

__all__ = ["MOST_CHANGE", "CarryConfig", "carry_bundle"]

FEWEST, MOST = 4, 8
"""Presses. With fewer their median is no measure; with more a fit is the better use of them."""

MOST_CHANGE: Final = 2.5
"""Change of the median score by a gel. PaDiM and FAPM on development parts: 1.1 to 2.2 times on another gel, 1.8 to 3.3
on another unit, 3.3 to 8.1 for another part."""
# Two pictures of one gel differ by less shading (levels) and less of a colour's level, and by no mark; of two gels by
# ten times as much.
_SAME_SHADING, _SAME_LEVEL = 0.6, 0.02
# Facts that hold for the old gel's scores alone.
_OF_OLD_GEL: Final = (CARD, "press_again", "dots", DAMAGE_FOUND)
# The score of a press from which as much relief is missing as is allowed.
_UNIT: Final = "relief_unit"
# So begins what the bundle before warned of.
_BEFORE: Final = "of the old gel: "


@dataclass(frozen=True)
class CarryConfig:
    """How a bundle is carried over."""

    created: str
    gel_id: str | None = None
    """The new gel, where it is known."""
    revision: int | None = None
    """Its number, of the new bundle."""
    threads: int = 2
    """Threads of the scorer."""


def carry_bundle(bundle: Bundle, presses: NominalPresses, config: CarryConfig) -> Fitted:
    """The bundle for the gel of these presses. Errors: FitError for presses that do not allow it."""
    _check_bundle(bundle)
    if bundle.registration is not None:  # another gel has other cuts
        bundle = replace(bundle, registration=replace(bundle.registration, gel_limits=None))
    presses = take_out_dots(presses, bundle.profile.pixels_per_mm)
    presses = smooth_presses(presses) if bundle.manifest.is_smoothed else presses
    _check_presses(bundle, presses)
    sentences = measuring.warnings(presses, bundle.manifest.frame, bundle.manifest.threshold.alpha)
    scorer = Scorer(_weigh_relief(bundle, 0), config.threads)
    scores = _scores(scorer, presses)
    before = np.array(bundle.manifest.threshold.nominal_scores)
    _check_change(before, scores)
    golden = golden_frames(scorer, presses.frames) if bundle.registration is None else list(bundle.golden)
    tolerance = measure_tolerance(scorer, golden, config.threads)
    threshold = _threshold(bundle.manifest.threshold, presses, scores, tolerance)
    if _UNIT in bundle.bank:
        bundle = _weigh_relief(bundle, threshold.value)
        scorer = Scorer(bundle, config.threads)
        _check_relief(scorer, presses, scores, threshold.value)
        golden = [score_again(frame, scorer) for frame in golden]
    facts, free = _facts(bundle, presses, config, threshold, tolerance), presses.no_contact
    apart = _warn_of_apart(before, scores, presses.names)
    sentences += measuring.rate_warnings(presses.specimens, threshold.alpha) + colour_warnings(facts.colours)
    facts = _warn(facts, [*sentences, *_check_black(scorer, facts, apart), *apart])
    free_gel = most_typical(free) if bundle.free_gel is not None and free is not None else None
    fitted = Fitted(*rewrite_files(bundle, facts, golden, free_gel=free_gel, free_view=presses.free_view))
    Scorer(fitted.bundle(), config.threads).check_golden()
    return fitted


def _weigh_relief(bundle: Bundle, unit: float) -> Bundle:
    """Give missing relief this score at its limit, where it is checked."""
    if _UNIT not in bundle.bank:
        return bundle
    return replace(bundle, bank={**bundle.bank, _UNIT: np.full((1, 1), unit, np.float32)})


def _check_relief(scorer: Scorer, presses: NominalPresses, scores: F64, limit: float) -> None:
    """Check that no press lacks relief. scores: without that check. Errors: FitError."""
    is_lacking = (_scores(scorer, presses) > limit) & (scores <= limit)
    if lacking := [presses.names[k] for k in np.flatnonzero(is_lacking)]:
        raise FitError(
            f"presses lack relief that the learnt ones have: {', '.join(lacking)}; check the parts, press them as at "
            "the fit, or fit a bundle on this gel"
        )


def _check_black(scorer: Scorer, facts: Facts, apart: Sequence[str]) -> list[str]:
    """Check that a black frame, which shows no press, fails or is refused; return what is said. Errors: FitError."""
    black = np.zeros((*scorer.frame, 3), np.uint8)
    score = scorer.score_in_pose(black).anomaly_score
    return black_warnings(score, facts.threshold, refuses(facts.colours, black), apart)


def _warn(facts: Facts, said: Sequence[str]) -> Facts:
    """Add what the new presses warn of to what the old ones did."""
    whole = facts.provenance
    before = [
        warning if warning.startswith((UNPROVEN, _BEFORE)) else f"{_BEFORE}{warning}"
        for warning in whole.warnings
    ]
    proven = whole.model_copy(update={"warnings": tuple(unproven_first([*before, *said]))})
    return facts.model_copy(update={"provenance": proven})


def _check_bundle(bundle: Bundle) -> None:
    manifest = bundle.manifest
    if manifest.threshold.n == 0:
        raise FitError(
            f"bundle {bundle.where} has no scores of presses, so its threshold ({manifest.threshold.method}) cannot be "
            "scaled; fit a bundle on the new gel"
        )
    if manifest.backbone is not None and bundle.graphs.trunk is None:
        raise FitError(f"bundle {bundle.where} comes without its trunk; put trunks/<sha256>.onnx next to it")


def _check_presses(bundle: Bundle, presses: NominalPresses) -> None:
    """Check the presses.

    Errors: FitError for a wrong number, no free gel, the old gel, presses elsewhere, or another kind of sensor.
    """
    if not FEWEST <= len(presses) <= MOST:
        raise FitError(
            f"found {len(presses)} presses on the new gel, expected {FEWEST} to {MOST}; with more, fit a bundle on it"
        )
    if presses.free_view is None:
        way_on = "the free new gel is not known; give a picture of it with --no-contact, or a recording"
        raise FitError("; ".join([way_on, *presses.faults]))
    _check_gel(bundle, presses)
    if why := list(_misplaced(bundle, presses)):
        raise FitError(
            f"presses lie where no learnt press does: {', '.join(why)}; hold the part as at the fit"
        )
    colours = bundle.manifest.colours
    cells = colour_cells(np.ascontiguousarray(presses.frames[0]), (8, 8))
    if colours is not None and is_other_kind(cells, colours.nominal()):
        raise FitError(
            "the colours over the gel run otherwise than in the learnt presses: another kind of sensor; use presses of "
            "the sensor of the bundle, or fit again"
        )


def _check_gel(bundle: Bundle, presses: NominalPresses) -> None:
    known = {frame.rgb.tobytes() for frame in bundle.golden}
    for name, frame in zip(presses.names, presses.frames, strict=True):
        if frame.tobytes() in known:
            raise FitError(
                f"press {name} was learnt for this bundle, so it is of the old gel; press the new gel"
            )
    if bundle.free_view is None or presses.free_view is None:
        return
    change = wear(bundle.free_view.astype(np.float32), presses.free_view.astype(np.float32))
    is_marked = change.specks > 0 or change.scratch_length > 0
    if not is_marked and change.shading_levels < _SAME_SHADING and change.level_change < _SAME_LEVEL:
        raise FitError(
            f"the free gel differs by {change.shading_levels:.2f} levels and no mark from that of the bundle: it is "
            "the old gel; press the new one, and give its own free gel"
        )


def _misplaced(bundle: Bundle, presses: NominalPresses) -> Sequence[str]:
    """The presses whose contact the station would refuse."""
    nominal = bundle.manifest.contact
    if nominal is None:
        return []
    ranges = (nominal.x, nominal.y, nominal.area)
    contacts = {
        name: (touch.x, touch.y, touch.area)
        for name, touch in zip(presses.names, presses.touches, strict=True)
    }
    return [
        name
        for name, values in contacts.items()
        if not all(low <= value <= high for value, (low, high) in zip(values, ranges, strict=True))
    ]


def _scores(scorer: Scorer, presses: NominalPresses) -> F64:
    scores = []
    for name, frame in zip(presses.names, presses.frames, strict=True):
        try:
            scores.append(scorer.score_prepared(frame).anomaly_score)
        except PoseNotFound as error:
            raise FitError(f"press {name} does not show the learnt part: {error}") from error
    return np.array(scores)


def _check_change(before: F64, now: F64) -> None:
    middle = float(np.median(before))
    if not middle > 0:
        raise FitError(
            f"the median score of the learnt presses is {middle:.3g}, so scores cannot be compared; fit a bundle on "
            "this gel"
        )
    change = float(np.median(now)) / middle
    if not 1 / MOST_CHANGE <= change <= MOST_CHANGE:
        raise FitError(
            f"these presses score {change:.2f} times as high as the learnt ones in the median, expected "
            f"{1 / MOST_CHANGE:.2f} to {MOST_CHANGE:g} times: another part, damaged parts, or a gel too different to "
            "carry the bank over; check the parts, or fit a bundle on this gel"
        )


def _warn_of_apart(before: F64, now: F64, names: Sequence[str]) -> list[str]:
    """Write a sentence for each press that stands apart. Two damaged ones of so few hide each other, so the scores of
    before are compared too, at the level of the new gel."""
    both = np.concatenate([now, before * (np.median(now) / np.median(before))])
    said = apart_warnings(both, [*names, *("of the old gel" for _ in before)])
    return [words for k, words in zip(list_apart(both), said, strict=True) if k < len(names)]


def _threshold(
    old: ThresholdEntry, presses: NominalPresses, scores: F64, tolerance: ToleranceEntry
) -> ThresholdEntry:
    """Find the threshold, which promises what the new presses alone show: the bank has not seen them."""
    slack = tolerance.around(float(scores.max()))
    new = conformal_threshold(scores, old.alpha, slack, "split-conformal", presses.specimens)
    method = f"carried over to another gel ({new.value / old.value:.3g} times the limit before): {new.method}"
    return new.model_copy(update={"method": method})


def _facts(
    bundle: Bundle,
    presses: NominalPresses,
    config: CarryConfig,
    threshold: ThresholdEntry,
    tolerance: ToleranceEntry,
) -> Facts:
    old = bundle.manifest
    facts: dict[str, Any] = {name: fact for name, fact in old.facts.items() if name not in _OF_OLD_GEL}
    for name in (LIMIT, MISSING):
        if facts.get(name, {}).get("found"):  # measured on the old gel
            why = "as in the bundle before; what it finds on this gel is not measured"
            facts[name] = {key: fact for key, fact in facts[name].items() if key != "found"} | {"why": why}
    came = {"carried_from": bundle.digest, "presses": len(presses)}
    known = gel_facts(config.gel_id).get("gel", {})
    provenance = measuring.provenance(config.created, presses, old.provenance.seed, old.provenance.warnings)
    return Facts(
        **{
            **dict(facts_of(old)),
            "revision": config.revision or (old.revision or 0) + 1,
            "facts": {**facts, **presses.facts, "gel": {**known, **came}},
            "threshold": threshold,
            "tolerance": tolerance,
            "colours": nominal_colours(presses.frames),
            "dots": None if presses.dots is None else DotsEntry.of(presses.dots),
            "accuracy": None,
            "provenance": provenance,
        }
    )
