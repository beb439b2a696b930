"""What a bundle loses on a new gel, and what each way to keep it brings back.

Banks are compared as they are fitted, with one limit for all places.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.folds import held_out_folds
from calibration.fitting.held_out import Learner, ScoredPresses, held_out_scores
from calibration.fitting.nominal_presses import NominalPresses
from calibration.fitting.threshold import conformal_threshold
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from calibration.gel_change.presses import PROFILE, REGION, GelChange
from calibration.metrics.aupro import aupro
from calibration.metrics.summary import auroc
from edge import registry
from edge.core.detector import Bank, Features, Grid, Nominal
from edge.model.session import open_session

__all__ = ["AGAIN", "ALPHA", "BEFORE", "METHODS", "WAYS", "Figures", "measured", "table"]

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]

METHODS: Final = ("padim", "fapm", "spade", "inreach", "patchcore")
ALPHA: Final = 0.05
# Finer marks of a gel are its own, and not its tint.
_TINT_SIGMA_PX: Final = 3.0
_LEAST_LEVEL: Final = 1.0
_MOST_GAIN: Final = 2.0

BEFORE, AGAIN = "old gel", "pressed again"
WAYS: Final[Mapping[str, str]] = {
    BEFORE: "bank and limit of the old gel, on the old gel",
    AGAIN: "as many presses on the new gel, bank and limit from them",
    "as it is": "bank and limit of the old gel",
    "limit": "bank of the old gel, limit from the scores of 8 presses: what `gelgate bundle carry` does",
    "scaled limit": "bank of the old gel, its limit times the change of the median score",
    "tint, limit": "pictures with the tint of the old gel, by the two free gels; limit as under `limit`",
    "response, limit": "tint, and one gain for each colour from 8 presses; limit as under `limit`",
    "8 alone": "bank and limit from 8 presses on the new gel",
}
"""Every way with what it takes, the losing ones too."""


@dataclass(frozen=True)
class Figures:
    """One way on one part. aupro: up to 1 %, None on the old gel, where no damage was pressed. false_alarms, detected:
    shares at the limit."""

    part: str
    method: str
    way: str
    aupro: float | None
    auroc: float | None
    false_alarms: float
    detected: float | None


@dataclass(frozen=True, eq=False)
class _Gel:
    """Features of nominal presses, and the limit and scores of a bank learnt from them."""

    bank: Bank
    scores: NDArray[np.float64]
    limit: float


@dataclass(frozen=True, eq=False)
class _Taken:
    """Features of one change. few, scored: of each look of the pictures, by its name."""

    grid: Grid
    old: Nominal
    again: Nominal
    alone: Nominal
    before: Features
    few: Mapping[str, Features]
    scored: Mapping[str, Features]


def measured(change: GelChange, methods: Sequence[str] = METHODS) -> Iterator[Figures]:
    """Every method and way on one change of the gel."""
    taken = _taken(change, methods)
    for method in methods:
        yield from _of_method(change, taken, method)


def _of_method(change: GelChange, taken: _Taken, method: str) -> Iterator[Figures]:
    detector = registry.detector(method)
    parameters = detector.parameters()
    read = {tap: taken.grid.taps[tap] for tap in detector.taps(parameters)}
    learner = Learner(detector, Grid(taken.grid.frame, read, taken.grid.pixels_per_mm), parameters, 0, 1)
    old, again, alone = (_learnt(learner, one) for one in (taken.old, taken.again, taken.alone))
    before = learner.scores(old.bank, taken.before, range(len(change.sound_before)))
    yield Figures(change.name, method, BEFORE, None, None, float((before > old.limit).mean()), None)

    def figures(way: str, found: ScoredPresses, limit: float) -> Figures:
        return _figures(change, method, way, found, limit)

    looks = {look: _both(learner, old.bank, taken, look) for look in taken.scored}
    few, scored = looks["plain"]
    yield figures("as it is", scored, old.limit)
    yield figures("scaled limit", scored, old.limit * float(np.median(few) / np.median(old.scores)))
    for way, (few, scored) in zip(("limit", "tint, limit", "response, limit"), looks.values(), strict=True):
        yield figures(way, scored, conformal_threshold(few, ALPHA).value)
    rows = range(len(change.scored.frames))
    yield figures("8 alone", learner.scored(alone.bank, taken.scored["plain"], rows), alone.limit)
    yield figures(AGAIN, learner.scored(again.bank, taken.scored["plain"], rows), again.limit)


def _both(
    learner: Learner, bank: Bank, taken: _Taken, look: str
) -> tuple[NDArray[np.float64], ScoredPresses]:
    few, scored = taken.few[look], taken.scored[look]
    return learner.scores(bank, few, range(_count(few))), learner.scored(bank, scored, range(_count(scored)))


def _figures(change: GelChange, method: str, way: str, found: ScoredPresses, limit: float) -> Figures:
    is_damaged = np.asarray(change.scored.masks.any(axis=(1, 2)), np.bool_)
    fails = found.scores > limit
    return Figures(
        change.name,
        method,
        way,
        aupro(found.maps, change.scored.masks),
        auroc(found.scores, is_damaged),
        float(fails[~is_damaged].mean()),
        float(fails[is_damaged].mean()),
    )


def _learnt(learner: Learner, nominal: Nominal) -> _Gel:
    bank = learner.bank(nominal)
    folds, _ = held_out_folds((None,) * nominal.presses, 5, np.random.default_rng(0))
    rows = range(nominal.presses)
    scores = np.maximum(
        held_out_scores(learner, nominal, folds), learner.scores(bank, nominal.features, rows)
    )
    return _Gel(bank, scores, conformal_threshold(scores, ALPHA).value)


def _taken(change: GelChange, methods: Sequence[str]) -> _Taken:
    detectors = [registry.detector(method) for method in methods]
    taps = sorted({tap for one in detectors for tap in one.taps(one.parameters())})
    session = open_session(open_trunk(DEFAULT_BACKBONE, taps).graph, 1, "trunk")
    frame = (REGION.height, REGION.width)
    grid = trunk_grid(session, taps, frame, PROFILE.pixels_per_mm)

    def take(frames: U8) -> Features:
        return extract(session, frames, grid, lambda fraction: None)

    def nominal(presses: NominalPresses) -> Nominal:
        free = presses.no_contact
        return Nominal(take(presses.frames), presses.touched, None if free is None else take(free))

    looks = dict(_looks(change))
    return _Taken(
        grid,
        nominal(change.old),
        nominal(change.again),
        nominal(change.few),
        take(change.sound_before),
        {name: take(_seen(look, change.few.frames)) for name, look in looks.items()},
        {name: take(_seen(look, change.scored.frames)) for name, look in looks.items()},
    )


def _looks(change: GelChange) -> Iterator[tuple[str, Callable[[F32], F32]]]:
    """Of a press on the new gel: as it is, with the tint of the old gel, and with its response to a slope."""
    before, after = _tint(change.old), _tint(change.few)
    gain = _gain(change, before, after)
    yield "plain", lambda rgb: rgb
    yield "tint", lambda rgb: np.asarray(rgb * (before / np.maximum(after, _LEAST_LEVEL)), np.float32)
    yield "response", lambda rgb: np.asarray(before + gain * (rgb - after), np.float32)


def _tint(presses: NominalPresses) -> F32:
    """The free gel without its fine marks, float32 (h, w, 3)."""
    if presses.no_contact is None:
        raise ValueError("the tint of a gel needs pictures of the free gel")
    mean = presses.no_contact.mean(axis=0, dtype=np.float64).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(mean, (0, 0), _TINT_SIGMA_PX), np.float32)


def _gain(change: GelChange, before: F32, after: F32) -> F32:
    """How much stronger each colour answered on the old gel, float32 (3,), from as many presses of each."""
    old = _strength(change.old.frames[: len(change.few)], before)
    gain = np.clip(old / _strength(change.few.frames, after), 1 / _MOST_GAIN, _MOST_GAIN)
    return np.asarray(gain, np.float32)


def _strength(frames: U8, free: F32) -> F32:
    """The root mean square of the difference from the free gel, float32 (3,), in levels."""
    difference = frames.astype(np.float32) - free
    return np.asarray(np.sqrt((difference**2).mean(axis=(0, 1, 2)) + _LEAST_LEVEL), np.float32)


def _seen(look: Callable[[F32], F32], frames: U8) -> U8:
    seen = np.stack([look(frame.astype(np.float32)) for frame in frames])
    return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def _count(features: Features) -> int:
    return len(next(iter(features.values())))


def table(figures: Sequence[Figures]) -> str:
    """Markdown: a section for each method, a row for each way."""
    methods = list(dict.fromkeys(one.method for one in figures))
    parts = len({one.part for one in figures})
    said = f"{parts} parts, each on two gels; means over parts, and the most that one part loses."
    return "\n".join(
        [said, *(line for method in methods for line in _tabulate_method(figures, method)), "", *_words()]
    )


def _tabulate_method(figures: Sequence[Figures], method: str) -> list[str]:
    head = f"| {method} | AU-PRO up to 1 % | lost to `{AGAIN}` | most lost | image AUROC | false alarms | detected |"
    own = [one for one in figures if one.method == method]
    rows = [_row(own, way) for way in WAYS if any(one.way == way for one in own)]
    return ["", head, "|---|---|---|---|---|---|---|", *rows]


def _row(own: Sequence[Figures], way: str) -> str:
    rows = [one for one in own if one.way == way]
    again = {one.part: one.aupro for one in own if one.way == AGAIN}
    lost = [
        reference - one.aupro
        for one in rows
        if one.aupro is not None and (reference := again.get(one.part)) is not None
    ]
    cells = [
        _mean([one.aupro for one in rows]),
        "-" if way in (BEFORE, AGAIN) or not lost else f"{np.mean(lost):+.3f}",
        "-" if way in (BEFORE, AGAIN) or not lost else f"{max(lost):+.3f}",
        _mean([one.auroc for one in rows]),
        _mean([one.false_alarms for one in rows]),
        _mean([one.detected for one in rows]),
    ]
    return f"| {way} | {' | '.join(cells)} |"


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.3f}" if known else "-"


def _words() -> list[str]:
    return [f"- `{way}`: {what}." for way, what in WAYS.items()]
