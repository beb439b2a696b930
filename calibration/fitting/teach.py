"""A damage that passed: which limit, place or method would have found it, and what that costs in false alarms.

A limit and a place leave bank and graphs as they are, and every score is at least what it was, relative to the limit:
they find whatever was found before. Sound presses are scored by banks without them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.bundle_measurements import measure_tolerance, score_again
from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.limits.appended import TAUGHT_WEIGHTS, append
from calibration.fitting.limits.gel_limits import find_near
from calibration.fitting.limits.threshold import pieces_of, promise_at, promise_known_pieces
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.arrays import F32, F64
from edge.core.detector import Bank
from edge.core.errors import FitError, NotScorable, PoseNotFound
from edge.core.registration.pose import warp
from edge.model.bundle import Bundle, GoldenFrame
from edge.model.bundle_writer import facts_of, rewrite_files
from edge.model.manifest import REGION_WEIGHTS, ThresholdEntry, ToleranceEntry
from edge.model.scorer import Scorer

__all__ = [
    "BEARABLE",
    "FEWEST_HELD_OUT",
    "Lesson",
    "Remedy",
    "change_method",
    "find_other_score",
    "hold_out",
    "lower_limit",
    "lower_place",
    "name_alike",
    "why_not",
]

BEARABLE: Final = 0.10
"""Of sound presses that fail: twice what a fit asks for by default."""

# At a place that is taught its damage scores this many times the limit.
_ABOVE: Final = 1.1
# What is watched around a place, and where that fades out. Of 12 damages of two simulated parts no more sound presses
# fail with 0.4 mm, and with 1 mm half as many again.
_PLACE_MM, _FADE_MM = 0.6, 0.4
# Where the largest value of a map is not the press's score to this share, the score is something else.
_SAME: Final = 1e-4
# Below this share of the limit a map shows noise, which no weight makes a damage.
_LEAST_SHOWN: Final = 0.1
# Fits that each leave out a part of the presses.
_FOLDS, FEWEST_HELD_OUT = 3, 6
# What a manifest says of scores, which are others with another limit.
_OF_OLD_SCORES: Final = ("press_again",)


@dataclass(frozen=True, eq=False)
class Lesson:
    """A bundle, the damage that it is to find, and its nominal presses."""

    old: Bundle
    damaged: NominalPresses
    """Cut to the inspected region, with names."""
    nominal: NominalPresses
    config: FitConfig
    created: str
    scores: F64 = field(init=False)
    """Of the damaged presses, by the old bundle."""
    maps: F32 = field(init=False)
    """Their score maps in units of the limit, where the bank knows the part, (m, h, w)."""

    def __post_init__(self) -> None:
        old, limit = self.old, self.old.manifest.threshold
        if limit.n == 0 or not limit.value > 0:
            raise FitError(
                f"bundle {old.where} has no scores of presses ({limit.method}), so what another limit costs is not "
                "known; fit it from presses"
            )
        scores, maps = _see(Scorer(old, self.config.threads), self.damaged, old)
        if refused := [
            name for name, score in zip(self.damaged.names, scores, strict=True) if not score < np.inf
        ]:
            raise FitError(f"the bundle gives {', '.join(refused)} no score, so such presses never pass")
        object.__setattr__(self, "scores", scores * limit.value)
        object.__setattr__(self, "maps", maps)

    @cached_property
    def held_out(self) -> tuple[NominalPresses, F32] | None:
        """The nominal presses that have a score by banks without them, and their maps, as `maps`, (n, h, w); None of
        too few. It takes three fits. Errors: as `fit_files`."""
        if (held_out := hold_out(self.old, self.nominal, self.config, self.created)) is None:
            return None
        presses, maps = held_out
        for name in (TAUGHT_WEIGHTS, REGION_WEIGHTS):
            maps = maps * self.old.bank.get(name, np.float32(1))
        return presses, maps

    @property
    def missed(self) -> list[int]:
        """The numbers of the damaged presses that pass."""
        return [k for k, score in enumerate(self.scores) if self.old.manifest.decide(score).kind == "pass"]


def hold_out(
    old: Bundle, nominal: NominalPresses, config: FitConfig, created: str
) -> tuple[NominalPresses, F32] | None:
    """Score each nominal press by a fit without its piece, which has neither taught places nor regions. Return those
    that have a score, for others are never judged, and their maps: float32 (n, h, w), in units of the limit, in the
    pose of the old bundle. None of too few. Errors: as `fit_files`; FitError for a limit as earlier versions made it,
    for these fits have another one."""
    if len(nominal) < FEWEST_HELD_OUT:
        return None
    if "limit_grid" in old.bank and "limit_usual" not in old.bank:
        raise FitError(
            f"bundle {old.where} has a limit of an earlier version, so what its nominal presses would score without "
            "them is not known; fit it again"
        )
    scores, maps = np.zeros(len(nominal)), np.zeros(nominal.frames.shape[:3], np.float32)
    fold = _share_out(nominal.specimens, len(nominal))
    for fold_number in range(_FOLDS):
        held = np.flatnonzero(fold == fold_number).tolist()
        rest = nominal.choose(np.flatnonzero(fold != fold_number).tolist())
        without = fit_files(rest, config, created=created).bundle()
        scores[held], maps[held] = _see(Scorer(without, config.threads), nominal.choose(held), old)
    kept = np.flatnonzero(scores < np.inf).tolist()
    return (nominal.choose(kept), maps[kept]) if len(kept) >= FEWEST_HELD_OUT else None


def _share_out(specimens: Sequence[str | None], presses: int) -> NDArray[np.intp]:
    """Return the fold of each press. Presses of one piece share theirs, or a bank would know the piece that it is to
    judge; of fewer pieces than folds, or where too few presses would be left, each press is taken alone."""
    pieces = pieces_of(specimens or (None,) * presses)
    number = {piece: k for k, piece in enumerate(dict.fromkeys(pieces))}
    fold = np.array([number[piece] % _FOLDS for piece in pieces])
    held = np.bincount(fold, minlength=_FOLDS)
    is_enough = held.min() > 0 and presses - held.max() >= FEWEST_HELD_OUT - FEWEST_HELD_OUT // _FOLDS
    return fold if is_enough else np.arange(presses) % _FOLDS


@dataclass(frozen=True, eq=False)
class Remedy:
    """A bundle that may find the damage."""

    name: str
    """By which it is taken."""
    what: str
    """What it changes, in words."""
    fitted: Fitted
    scores: F64
    """Of the damaged presses."""

    @property
    def is_found(self) -> list[bool]:
        """Say of each damaged press whether it fails."""
        return [self.fitted.manifest.decide(score).kind == "fail" for score in self.scores]

    @property
    def rate(self) -> float:
        """The rate of sound presses that fail, as it is promised."""
        limit = self.fitted.manifest.threshold
        return limit.alpha if limit.alpha_floor == 1 else max(limit.alpha, limit.alpha_floor)

    @property
    def alarms(self) -> int:
        """The nominal presses that fail by a bank without them."""
        limit = self.fitted.manifest.threshold
        return sum(score > limit.value for score in limit.nominal_scores)

    def describe(self) -> str:
        """Give what it finds, and what that costs, in one line."""
        limit = self.fitted.manifest.threshold
        whose = "sound ones of these pieces" if limit.alpha_floor == 1 else "sound ones"
        return (
            f"{self.name}: {self.what}; finds {sum(self.is_found)} of {len(self.scores)}; by banks without them "
            f"{self.alarms} of {limit.n} nominal presses fail, {self.rate:.1%} of {whose} are to be expected"
        )


def lower_limit(lesson: Lesson) -> Remedy | str:
    """Lower the limit of all places to just below the damage; say why not where that cannot be."""
    old = lesson.old.manifest
    lowest = min(lesson.scores[k] for k in lesson.missed)
    value = float(lowest - 2 * old.tolerance.around(lowest))
    limit = promise_at(old.threshold.nominal_scores, value, old.threshold.alpha) if value > 0 else None
    if limit is None:
        return "limit: every sound press would fail"
    if old.threshold.pieces not in (None, old.threshold.n):  # which piece a score is of is not known any more
        limit = promise_known_pieces(limit)
    what = f"the limit {value:.4g} instead of {old.threshold.value:.4g}"
    fitted = _rewrite(lesson, what, limit)
    return Remedy("limit", what, fitted, lesson.scores)


def lower_place(lesson: Lesson) -> Remedy | str:
    """Lower the limit where each missed damage stands out most; say why not where that cannot be.

    A place that is chosen by sound presses shows less of these than of others. So what it costs is counted on each
    piece with the places that the others choose.
    """
    if why := find_other_score(lesson.old):
        return f"place: {why}, so no place of the map decides"
    old, held_out = lesson.old, lesson.held_out
    if held_out is None or len(set(pieces_of(held_out[0].specimens))) == 1:
        return f"place: of one piece, or fewer than {FEWEST_HELD_OUT} presses, none can be held out"
    (sound, maps), pieces = held_out, np.array(pieces_of(held_out[0].specimens))
    if faint := [name for k, name in enumerate(lesson.damaged.names) if lesson.maps[k].max() < _LEAST_SHOWN]:
        return f"place: {', '.join(faint)} shows nowhere above {_LEAST_SHOWN:.0%} of the limit"
    near, scores = _near(old, maps), np.zeros(len(maps))
    for piece in set(pieces):
        weights = _weigh(lesson, near[pieces != piece].max(axis=0))
        scores[pieces == piece] = (maps[pieces == piece] * weights).max(axis=(1, 2))
    value, usual = old.manifest.threshold.value, near.max(axis=0)
    limit = promise_at(scores * value, value, old.manifest.threshold.alpha, sound.specimens)
    if limit is None:
        return "place: every sound press would fail"
    x_mm, y_mm = old.profile.mm_per_pixel
    places = [(k, *_find_place(lesson, k, usual)) for k in lesson.missed]
    words = (
        f"divided by {_ABOVE / lesson.maps[k, y, x]:.2g} at ({x * x_mm:.1f}, {y * y_mm:.1f}) mm"
        for k, y, x in places
    )
    what = f"the limit {', '.join(words)}"
    try:
        fitted = _rewrite(lesson, what, limit, _weigh(lesson, usual))
    except FitError as error:
        return f"place: {error}"
    seen = Scorer(fitted.bundle(), lesson.config.threads)
    return Remedy("place", what, fitted, _see(seen, lesson.damaged, old)[0] * value)


def find_other_score(old: Bundle) -> str:
    """Say of a bundle whose score is not the highest value of its map what it is; empty where it is that."""
    for golden in old.golden:
        highest = max(map(max, golden.map_peaks))
        if abs(highest - golden.score) > _SAME * abs(golden.score):
            return f"its score ({golden.score:.4g}) is not the highest value of its map ({highest:.4g})"
    return ""


def change_method(lesson: Lesson, name: str, fit: Callable[[], Fitted]) -> Remedy | str:
    """Fit another method; say why not where that cannot be."""
    try:
        fitted = fit()
    except FitError as error:
        return f"{name}: {error}"
    scorer = Scorer(fitted.bundle(), lesson.config.threads)
    ratios = _see(scorer, lesson.damaged, lesson.old)[0]
    return Remedy(name, f"the method {name}", fitted, ratios * fitted.manifest.threshold.value)


def why_not(lesson: Lesson) -> list[str]:
    """Say of each missed damage which sound press lies nearest to it, where it stands out most."""
    held_out = lesson.held_out
    if held_out is None:
        return []
    near = _near(lesson.old, held_out[1])
    places = [(k, _find_place(lesson, k, near.max(axis=0))) for k in lesson.missed]
    names, sound = lesson.damaged.names, held_out[0].names
    return [_name_nearest(lesson.old, names[k], lesson.maps[k], at, sound, near) for k, at in places]


def name_alike(old: Bundle, damaged: NominalPresses, good: NominalPresses, threads: int) -> list[str]:
    """Say of each damaged press which good press shows most where it stands out most, by the old bundle."""
    scorer, sentences = Scorer(old, threads), list[str]()
    near = _near(old, _see(scorer, good, old)[1])
    for name, damage in zip(damaged.names, _see(scorer, damaged, old)[1], strict=True):
        y, x = np.unravel_index(int(damage.argmax()), damage.shape)
        if damage[y, x] > 0:
            sentences.append(_name_nearest(old, name, damage, (int(y), int(x)), good.names, near))
    return sentences


def _name_nearest(
    old: Bundle, name: str, damage: F32, at: tuple[int, int], sound: Sequence[str], near: F32
) -> str:
    """Name the sound press that shows most at a place of a damaged one. near: of the sound ones, as `_near`."""
    (y, x), (x_mm, y_mm) = at, old.profile.mm_per_pixel
    nearest = int(near[:, y, x].argmax())
    return (
        f"{name} scores {damage[y, x]:.2f} of the limit at ({x * x_mm:.1f}, {y * y_mm:.1f}) mm, where it stands out "
        f"most, and the sound press {sound[nearest]} {near[nearest, y, x]:.2f}"
    )


def _near(old: Bundle, maps: F32) -> F32:
    """Give each place the highest value of what is watched with it, for each map."""
    return find_near(maps, old.profile.pixels_per_mm, _PLACE_MM + _FADE_MM / 2)


def _find_place(lesson: Lesson, number: int, usual: F32) -> tuple[int, int]:
    """Find where a damaged press most exceeds what is usual near there, as `_near` gives it: (y, x)."""
    damage = lesson.maps[number]
    excess = np.where(damage >= min(_LEAST_SHOWN, float(damage.max())), damage / np.maximum(usual, 1e-6), 0)
    y, x = np.unravel_index(int(excess.argmax()), excess.shape)
    return int(y), int(x)


def _weigh(lesson: Lesson, usual: F32) -> F32:
    """Make weights of a score map, (h, w), by which each missed damage exceeds the limit; 1 elsewhere."""
    weights, (rows, columns) = np.ones(usual.shape, np.float32), np.indices(usual.shape)
    for k in lesson.missed:
        y, x = _find_place(lesson, k, usual)
        distance_mm = np.hypot(rows - y, columns - x) / lesson.old.profile.pixels_per_mm
        share = np.clip((_PLACE_MM + _FADE_MM - distance_mm) / _FADE_MM, 0, 1)
        more = max(_ABOVE / float(lesson.maps[k, y, x]), 1.0) - 1
        weights = np.maximum(weights, np.float32(1 + more * share))
    return np.asarray(weights, np.float32)


def _see(scorer: Scorer, presses: NominalPresses, old: Bundle) -> tuple[F64, F32]:
    """Score presses in units of the scorer's limit, without the places that a station did not judge; a press without a
    score is infinite and its map empty. Maps are in the pose of the old bundle's bank."""
    limit = scorer.bundle.manifest.threshold.value
    registrar = None if old.registration is None else old.registration.open()
    scores, maps = list[float](), list[F32]()
    for k, rgb in enumerate(presses.frames):
        try:
            scored = scorer.score(rgb)
            if presses.unjudged is not None and presses.unjudged[k].any():
                shown = np.where(presses.unjudged[k], scored.score_map.min(), scored.score_map)
                scored = replace(scored, score_map=shown, anomaly_score=float(shown.max()))
            registration = None if registrar is None else registrar.register(old.prepare(rgb))
            if registration is not None and registration.refusal is not None:
                raise PoseNotFound(registration.refusal)
            lying = np.asarray(scored.score_map / np.float32(limit), np.float32)
            maps.append(
                lying
                if registration is None
                else np.where(registration.seen, warp(lying, registration.pose), 0)
            )
            scores.append(scored.anomaly_score / limit)
        except (PoseNotFound, NotScorable):
            scores.append(np.inf)
            maps.append(np.zeros(presses.frames.shape[1:3], np.float32))
    return np.array(scores), np.stack(maps)


def _rewrite(lesson: Lesson, what: str, limit: ThresholdEntry, weights: F32 | None = None) -> Fitted:
    """Write the old bundle again with this limit, and weights of its score map. Errors: FitError for a head that cannot
    be extended."""
    old = lesson.old
    manifest, graphs, arrays = old.manifest, old.graphs, dict(old.bank)
    packing = {name: entry.packing for name, entry in manifest.bank.items()}
    if weights is not None and TAUGHT_WEIGHTS in arrays:
        arrays[TAUGHT_WEIGHTS] = arrays[TAUGHT_WEIGHTS] * weights
    elif weights is not None:
        head, bank = append(graphs.head or b"", Bank(arrays), {TAUGHT_WEIGHTS: weights})
        graphs, arrays = replace(graphs, head=head), dict(bank.arrays)
    taught = {"presses": list(lesson.damaged.names), "what": what}
    facts: dict[str, Any] = {
        name: fact for name, fact in manifest.facts.items() if name not in _OF_OLD_SCORES
    }
    facts["taught"] = [*facts.get("taught", []), taught]
    words = f"{manifest.threshold.method}; taught: {what}"
    changes = {
        "revision": (manifest.revision or 0) + 1,
        "facts": facts,
        "threshold": limit.model_copy(update={"method": words}),
        "accuracy": None,
    }

    def pack(golden: Sequence[GoldenFrame], tolerance: ToleranceEntry) -> Fitted:
        more = {} if golden else {"with_trunk": True}
        new_facts = facts_of(manifest).model_copy(update=changes | {"tolerance": tolerance})
        return Fitted(
            *rewrite_files(old, new_facts, golden, graphs=graphs, bank=Bank(arrays, packing), **more)
        )

    scorer = Scorer(pack((), manifest.tolerance).bundle(), lesson.config.threads)
    golden = [score_again(press, scorer) for press in old.golden]
    tolerance = measure_tolerance(scorer, golden, lesson.config.threads) if golden else manifest.tolerance
    return pack(golden, tolerance)
