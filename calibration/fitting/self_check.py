"""The checks of a fit: how far presses lie apart, what is not proven, outliers, a black frame."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from calibration.fitting.limits.folds import Folds
from calibration.fitting.limits.held_out import HeldOut
from calibration.fitting.limits.limit_choice import WORTH, Choice, DamageFound, Evidence, choose_limit
from calibration.fitting.limits.threshold import pieces_of
from calibration.fitting.presses.gel_choice import SCATTERED_MM, away_mm, spread_mm
from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from calibration.fitting.presses.strangers import split_numbers
from edge import registry
from edge.core.arrays import F64
from edge.core.detector import Detector
from edge.core.errors import FitError
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.manifest import ThresholdEntry
from edge.model.manifest_facts import DAMAGE_FOUND, UNPROVEN

__all__ = [
    "AT_CHANCE",
    "apart_warnings",
    "black_warnings",
    "damage_facts",
    "drift_warnings",
    "find_remedies",
    "list_apart",
    "may_compare",
    "room_warnings",
    "scatter_warnings",
    "standing_apart",
    "unproven_first",
    "unproven_warnings",
]

ScoreApart = Callable[[Folds], HeldOut]
"""Scores the presses of each fold, and the damage in them, by a bank of the others."""

FARTHER_THAN_ANY, FARTHER_THAN_USUAL = (1.6, 16.0), (5.0, 22.0)
"""An outlier is this many times as far above the median as every other press, and as the upper half on average:
(a, b) is a + b / n with n presses. Sound presses have long tails, longer where few are seen. On eight
random simulated parts and six methods 5 to 8 of 100 fits to 8 to 24 sound presses warn without a reason, 11 with 40,
14 with 5. Of damaged presses that raise the threshold to twice its height above the median 8 to 10 of 10 are named.
"""

AT_CHANCE = 0.6
"""Up to this image AUROC damage is not separated: of 24 presses 8 are held out, and chance alone gives 0.5 with a
standard deviation of 0.13. Real balls have 0.7 to 0.98."""

LEAST_FOUND = 0.3
"""Damage is rendered in three sizes, and few banks find the smallest: below this share less than the largest is found.
Of thirteen kinds of press for development (tests/bench/default_fits.py) the least is 0.36, where 94 % of the damaged
presses are reported; real balls where few are have 0 to 0.12, a simulated part with 11 of 20 reported 0.23."""

_FEW_FOUND = 1 / 2
"""Below this share what finds more is looked for. It is no warning: of real balls that find 0.3 to 0.4 one reports a
quarter of larger damage, another nearly all of it."""

LOOSER = 0.1
"""The promise that is tried where little is found."""

DRIFTING, _DRIFTING_MM = 0.65, 0.5
"""Contacts drift where one is away from the next by less than this share of what any two are, in the mean, and half of
them lie further than so many mm from their middle. Of four presses at places drawn at random 2 in 100 sets have less,
of eight 6 in 1,000; of stretches of six presses of three real balls, pressed row by row, 72 to 89 in 100."""

_FULL_VIEW = 0.5
"""Contacts over this share of the view, across and down, leave no large part of it to later presses."""

APART_SHARE = 0.1
"""More presses than this share are not outliers: sound presses then have more than one look."""


def unproven_warnings(
    separated: float | None,
    found: DamageFound | None,
    find_remedies: Callable[[], Sequence[str]] = tuple,
    unrendered: str = "",
) -> list[str]:
    """Say what the fit's own evidence does not show, the worst first, and what would find more of its damage.

    separated: image AUROC of rendered damage, where it decided on registration. found: how many presses with rendered
    damage the bundle finds. Each is None where it was not measured. find_remedies: called where too few are found.
    unrendered: why a fit that looks for damage had none.
    """
    sentences = [f"nothing shows what damage the bundle finds: {unrendered}"] if unrendered else []
    if separated is not None and separated <= AT_CHANCE:
        sentences.append(
            f"of damage rendered into its own presses {separated:.2f} is separated from sound presses, as by chance "
            "(0.5): the bundle will pass damage"
        )
    if found is not None and found.found < LEAST_FOUND * found.count:
        of = f" ({found.why})" if found.why else ""
        sentences.append(
            f"the bundle finds {found.found} of {found.count} small pieces of damage rendered into its own "
            f"presses{of}: it will pass most damage that small"
        )
    if not sentences:
        return []
    todo = ["press damaged parts before you trust it"]
    if not unrendered:
        todo = [*(find_remedies() or ["nothing that was tried on its own presses finds more"]), *todo]
    return [f"{UNPROVEN}{'; '.join([sentence, *todo])}" for sentence in sentences]


def unproven_first(sentences: Sequence[str]) -> list[str]:
    """Put first what the bundle's own evidence does not show, else in the order given."""
    return sorted(sentences, key=lambda sentence: not sentence.startswith(UNPROVEN))


def damage_facts(found: DamageFound | None, find_remedies: Callable[[], Sequence[str]]) -> dict[str, str]:
    """Say which sizes of the rendered damage are found, and where few are what finds more, for the manifest."""
    if found is None:
        return {}
    is_few = LEAST_FOUND * found.count <= found.found < _FEW_FOUND * found.count  # below it is warned
    return {DAMAGE_FOUND: "; ".join([f"found by size: {found.sizes}", *(find_remedies() if is_few else ())])}


def find_remedies(
    evidence: Evidence,
    choice: Choice,
    presses: NominalPresses,
    profile: SensorProfile,
    score_apart: ScoreApart | None = None,
) -> list[str]:
    """Say what finds clearly more of the rendered damage than the choice does, each with what it finds.

    score_apart: what more presses find is tried too.
    """
    if choice.kind not in choice.found:
        return []
    scores, remedies = choice.other.scores if choice.other else evidence.scores, []
    for words, changed, instead in _try_remedies(
        evidence, int(scores.argmax()), presses, profile, score_apart
    ):
        compared = instead or evidence
        less, more = choose_limit(instead) if instead else choice, choose_limit(changed)
        before, after = less.found.get(less.kind, 0.0), more.found.get(more.kind, 0.0)
        if after >= before + WORTH:
            pairs = (after, len(changed.damage)), (before, len(compared.damage))
            remedies.append(words.format(*(f"{round(share * count)} of {count}" for share, count in pairs)))
    return remedies


def _try_remedies(
    evidence: Evidence,
    highest: int,
    presses: NominalPresses,
    profile: SensorProfile,
    score_apart: ScoreApart | None,
) -> Iterator[tuple[str, Evidence, Evidence | None]]:
    """Yield what to say of the finds after and before, what is tried, and what before is; None for the bundle."""
    count = len(evidence.scores)
    if evidence.alpha < LOOSER:
        yield f"with --alpha {LOOSER:g} it finds {{}}", replace(evidence, alpha=LOOSER), None
    if count > MIN_PRESSES:
        name = presses.names[highest].replace("{", "{{").replace("}", "}}")
        words = f"without its highest press it finds {{}}: look whether '{name}' is dirty or damaged"
        yield words, evidence.keep(np.delete(np.arange(count), highest)), None
    if count < 2 * MIN_PRESSES:
        return
    if presses.touches:
        away = away_mm(presses.touches, profile)
        order = np.argsort(away, kind="stable")
        near, far = (evidence.keep(np.sort(half)) for half in np.split(order, [count // 2]))
        middle = f"{away[order[count // 2]]:.1f} mm of their middle"
        words = f"within {middle} it finds {{}}, beyond {{}}: hold the part at one place"
        if len(near.damage) and len(far.damage):
            yield words, near, far
    if score_apart is None:
        return
    held = np.sort(np.concatenate(evidence.folds[: (len(evidence.folds) + 1) // 2]))
    if MIN_PRESSES <= len(held) <= count - MIN_PRESSES and np.isin(evidence.damage.press, held).any():
        words = f"banks of the folds find {{}}, a bank of {count - len(held)} presses {{}}: press more pieces"
        apart, known = score_apart([held]), evidence.held_out
        fewer = HeldOut(
            replace(apart.sound, gel_limits=known.sound.gel_limits),
            replace(apart.edited, gel_limits=known.edited.gel_limits),
        )
        yield words, evidence.keep(held), replace(evidence, held_out=fewer).keep(held)


def standing_apart(scores: F64) -> list[int]:
    """Which presses score far above all others, the highest first.

    scores: out-of-fold scores, (n,). Up to APART_SHARE of them, at least one, may be outliers together; each is
    compared with the other presses, since two would hide each other.
    """
    n = len(scores)
    any_other, usual = (a + b / n for a, b in (FARTHER_THAN_ANY, FARTHER_THAN_USUAL))
    order = np.argsort(scores, kind="stable")[::-1]
    for count in range(max(1, round(APART_SHARE * n)), 0, -1):
        others = scores[order[count:]]
        above = np.maximum(others - np.median(others), 0)
        limit = max(any_other * above.max(), usual * above[above > 0].mean() if above.any() else 0.0)
        if scores[order[count - 1]] - np.median(others) > limit:
            return [int(k) for k in order[:count]]
    return []


def list_apart(scores: F64 | None) -> list[int]:
    """List the outliers as `standing_apart` does; none where too few presses have scores."""
    return [] if scores is None or len(scores) < MIN_PRESSES else standing_apart(scores)


def apart_warnings(scores: F64 | None, names: Sequence[str]) -> list[str]:
    """Write a sentence for each outlier."""
    apart = list_apart(scores)
    if scores is None or not apart:
        return []
    others = np.delete(scores, apart)
    return [
        f"press '{names[k]}' stands apart from the others: {scores[k]:.4g} where they reach {others.max():.4g}; if it "
        f"is of a damaged part, damage like it passes: look at it, and fit with --leave-out '{names[k]}'"
        for k in apart
    ]


def room_warnings(room: float) -> list[str]:
    """A warning where the bank is larger than the detector's parameters say."""
    if room == 1:
        return []
    return [f"the bank has {room:g} times its usual room: with less it lacks what nominal presses show"]


def black_warnings(
    score: float, threshold: ThresholdEntry, is_refused: bool, apart: Sequence[str] = ()
) -> list[str]:
    """Warn where a black frame, which shows no press, scores like a sound press.

    score: its anomaly score. is_refused: whether the gateway refuses it for its colours. apart: the sentences on
    outliers, which may be the reason. Errors: FitError where it would pass.
    """
    if score > threshold.value:
        return []
    sentence = f"a black frame scores {score:.4g}, below the threshold of {threshold.value:.4g}"
    if is_refused:
        return [f"{sentence}: it is refused for its colours alone"]
    why = apart or ("look for nominal pictures that are no presses, press more, or fit another method",)
    raise FitError(f"{sentence}, and would pass: {'; '.join(why)}")


def scatter_mm(presses: NominalPresses, profile: SensorProfile) -> float | None:
    """Measure how far half of the contacts lie from their common middle; None where no touch is known."""
    return spread_mm(presses.touches, profile) if presses.touches else None


def drift_warnings(presses: NominalPresses, profile: SensorProfile) -> list[str]:
    """Warn where contacts lie each beside the one before: presses by turns held out are not like those that come later.

    The order is that of the names. Of a piece that is pressed several times its mean place counts.
    """
    touches, pieces = presses.touches or presses.guessed, pieces_of(presses.specimens)
    order = sorted(range(len(presses)), key=lambda k: split_numbers(presses.names[k]))
    in_order = list(dict.fromkeys(pieces[k] for k in order))
    if not touches or len(in_order) < MIN_PRESSES or spread_mm(touches, profile) < _DRIFTING_MM:
        return []
    view = np.array(profile.size) / profile.pixels_per_mm
    middles = np.array([(touch.x, touch.y) for touch in touches]) * view
    places = np.stack([middles[[own == piece for own in pieces]].mean(axis=0) for piece in in_order])
    away = np.linalg.norm(places[:, None] - places, axis=2)
    span = np.ptp(places, axis=0)
    drifts = np.diagonal(away, 1).mean() < DRIFTING * away[np.triu_indices(len(away), 1)].mean()
    if not drifts or (span >= _FULL_VIEW * view).all():
        return []
    return [
        f"{UNPROVEN}each contact lies beside the one before it, all within {span[0]:.1f} x {span[1]:.1f} mm: the "
        "rate of false alarms is that of presses like these; where later ones lie elsewhere, most sound ones may "
        "fail or be rejected (off_position); set the part down anew before each press, or add presses of another day"
    ]


def may_compare(presses: NominalPresses, profile: SensorProfile, detector: Detector) -> bool:
    """Tell whether a method is fitted to presses as they lie: not one that compares places, to scattered contacts."""
    scatter = scatter_mm(presses, profile)
    return not detector.compares_places or scatter is None or scatter <= SCATTERED_MM


def scatter_warnings(
    presses: NominalPresses,
    profile: SensorProfile,
    detector: Detector,
    is_scattered: bool = False,
    why_unregistered: str = "",
) -> list[str]:
    """Check that a method that compares place with place is not fitted to scattered contacts.

    why_unregistered: said in the refusal. Errors: FitError where it is; a warning instead where `is_scattered` allows
    it, or the contacts are known by a free gel in doubt alone.
    """
    is_guessed = bool(presses.guessed)
    scatter = spread_mm(presses.guessed, profile) if is_guessed else scatter_mm(presses, profile)
    if not detector.compares_places or scatter is None or scatter <= SCATTERED_MM:
        return []
    methods = [registry.detector(name) for name in registry.names("detectors")]
    other = [method.name for method in methods if not (method.compares_places or method.is_baseline)]
    sentence = (
        f"half of the contacts lie more than {scatter:.1f} mm from their common middle: {detector.name} compares place "
        f"with place and will pass damage; hold the part at one place, or fit {' or '.join(other)}"
    )
    if is_guessed:
        return [f"{UNPROVEN}as far as a free gel in doubt shows it, {sentence}"]
    if not is_scattered:
        registered = f" ({why_unregistered}; see --set register)" if why_unregistered else ""
        raise FitError(f"{sentence}; --set scattered=true fits {detector.name} all the same{registered}")
    return [sentence]
