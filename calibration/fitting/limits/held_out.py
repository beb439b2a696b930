"""Scores of nominal presses by banks without them, for the threshold, and a bank that covers its own presses.

A bank of limited size may by chance leave out a place that every press has, where the banks of the folds did not. Then
sound presses score higher with it than the threshold expects, and fail. The nominal presses show this: they must not
score higher with the final bank than with banks without them. Where a few do, their higher score counts for the
threshold.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.presses.augmentation import Copies
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.arrays import F32, F64, U8, Mask
from edge.core.detector import Bank, Detector, Features, Grid, Nominal, Progress
from edge.core.errors import FitError
from edge.core.registration.pose import Registered
from edge.model.packing import pack, unpack
from edge.model.session import RUNTIME_ERRORS, open_session

__all__ = [
    "Covered",
    "HeldOut",
    "Learner",
    "ScoredPresses",
    "ShownPresses",
    "TapReader",
    "covering_bank",
    "is_covered",
    "score_held_out",
]


@dataclass(frozen=True, eq=False)
class ShownPresses:
    """n presses as the gateway brings them to a bank."""

    features: Features
    registered: Sequence[Registered] | None = None
    """Each of these; None where presses are scored as they lie."""
    unjudged: Mask | None = None
    """Places of presses as they lie that do not count, (n, h, w); None for none."""

    @cached_property
    def seen(self) -> Mask | None:
        """The places that count, (n, h, w); None for all."""
        if self.registered is not None:
            return np.stack([placed.seen for placed in self.registered])
        return None if self.unjudged is None else ~self.unjudged


@dataclass(frozen=True, eq=False)
class ScoredPresses:
    """What banks show of n presses."""

    maps: F32
    """Raw score maps, (n, h, w)."""
    scores: F64
    """Anomaly scores, (n,)."""
    head_ms: F64 = field(default_factory=lambda: np.empty(0))
    """What the head took for each, (n,), or none."""
    seen: Mask | None = None
    """The places that count, (n, h, w); None for all."""
    gel_limits: F32 | None = None
    """By what these places are divided, (n, h, w); None for nothing."""

    def weigh(self, maps: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return these maps of the presses, (n, h, w), as the gateway compares them with the limit."""
        weighed = maps if self.gel_limits is None else maps / self.gel_limits
        return (
            weighed if self.seen is None else np.where(self.seen, weighed, weighed.min((1, 2), keepdims=True))
        )

    def highest(self, maps: NDArray[np.floating]) -> F64:
        """Return the highest value that counts of these maps of the presses, (n,)."""
        return np.asarray(self.weigh(maps).max(axis=(1, 2)), np.float64)

    def put(self, rows: NDArray[np.int64], scored: "ScoredPresses") -> None:
        """Write other presses into these rows."""
        self.maps[rows], self.scores[rows], self.head_ms[rows] = scored.maps, scored.scores, scored.head_ms


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What banks without them show of the nominal presses, and of the same with damage, press by press."""

    sound: ScoredPresses
    edited: ScoredPresses


@dataclass(frozen=True)
class Learner:
    """A detector with everything to learn and to score."""

    detector: Detector
    grid: Grid
    parameters: Any
    seed: int
    """Fixes every random choice, the same for each bank."""
    threads: int
    copies: Copies | None = None
    """Copies of the fit's nominal presses, which a bank learns with them."""

    def bank(
        self,
        nominal: Nominal,
        progress: Progress = lambda fraction: None,
        presses: NDArray[np.int64] | None = None,
    ) -> Bank:
        """Learn a bank. presses: which of the fit's presses these are, (n,); None for all. Errors: FitError."""
        rng = np.random.default_rng(self.seed)
        if self.copies is not None:
            nominal = self.copies.add_to(nominal, np.arange(nominal.presses) if presses is None else presses)
        return self.detector.fit(nominal, self.grid, self.parameters, rng, progress)

    def head(self, bank: Bank) -> bytes:
        """Return the graph that scores by the bank. Errors: FitError."""
        return self.detector.head(self.grid, bank, self.parameters)

    def score_shown(self, bank: Bank, shown: ShownPresses, rows: NDArray[np.int64]) -> ScoredPresses:
        """Score those presses with the bank as stored, where only some places count by those. Errors: FitError."""
        scored = self.score(bank, shown.features, rows.tolist())
        if shown.seen is None:
            return scored
        scored = replace(scored, seen=shown.seen[rows])
        return replace(scored, scores=scored.highest(scored.maps))

    def score(self, bank: Bank, features: Features, rows: Sequence[int]) -> ScoredPresses:
        """Score those presses with the bank as stored. Errors: FitError."""
        head = _open_head(self.head(bank), self.threads, self.detector.name)
        wanted = {i.name for i in head.get_inputs()}
        stored = {name: _as_stored(bank, name) for name in bank.arrays if name in wanted}
        taps = {tap: maps for tap, maps in features.items() if tap in wanted}
        scored = _empty(self.grid, len(rows))
        for place, k in enumerate(rows):
            inputs = {**_select(taps, [k]), **stored}
            start = time.perf_counter()
            try:
                score_map, score = head.run(["score_map", "score"], inputs)
            except RUNTIME_ERRORS as error:
                name = self.detector.name
                raise FitError(f"the head of {name} does not run on a press: {error!s:.300}") from error
            scored.head_ms[place] = (time.perf_counter() - start) * 1e3
            scored.maps[place], scored.scores[place] = score_map[0], score[0]
        return scored

    def bank_without(self, nominal: Nominal, held: NDArray[np.int64]) -> Bank:
        """Learn a bank of the other presses, with the same share of room as the final bank. Errors: FitError."""
        kept = np.setdiff1d(np.arange(nominal.presses), held)
        room = nominal.room * len(kept) / nominal.presses
        others = replace(nominal, features=_select(nominal.features, kept), room=room)
        return self.bank(others, presses=kept)


def score_held_out(
    learner: Learner,
    nominal: Nominal,
    folds: Sequence[NDArray[np.int64]],
    edited: tuple[ShownPresses, NDArray[np.int64]] | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
    shown: ShownPresses | None = None,
) -> HeldOut:
    """Score every press by a bank of the other folds. Errors: FitError.

    folds: a partition of the presses. edited: m presses with damage, and which nominal press each was, (m,). shown:
    the nominal presses; None where the gateway shows them as they are learnt.
    """
    shown = shown or ShownPresses(nominal.features)
    damage, of = edited or (shown, np.empty(0, np.int64))
    sound, damaged = (
        _empty(learner.grid, count, one.seen) for count, one in ((nominal.presses, shown), (len(of), damage))
    )
    for number, held in enumerate(folds):
        bank = learner.bank_without(nominal, held)
        sound.put(held, learner.score_shown(bank, shown, held))
        if (rows := np.flatnonzero(np.isin(of, held))).size:
            damaged.put(rows, learner.score_shown(bank, damage, rows))
        progress((number + 1) / len(folds))
    return HeldOut(sound, damaged)


@lru_cache(maxsize=4)
def _open_head(head: bytes, threads: int, name: str) -> ort.InferenceSession:
    """Open a head, kept for the next banks: most graphs are the same for all of them."""
    return open_session(head, threads, f"head of {name}")


def _empty(grid: Grid, presses: int, seen: Mask | None = None) -> ScoredPresses:
    return ScoredPresses(
        np.empty((presses, *grid.frame), np.float32), np.empty(presses), np.empty(presses), seen
    )


def _select(features: Features, rows: Sequence[int] | NDArray[np.int64]) -> Features:
    return {tap: maps[np.asarray(rows)] for tap, maps in features.items()}


def _as_stored(bank: Bank, name: str) -> NDArray[Any]:
    """Return a bank array after storing and loading."""
    packing = bank.packing.get(name, "none")
    try:
        return unpack(pack(bank.arrays[name], packing), packing)
    except ValueError as error:
        raise FitError(f"bank array '{name}' cannot be stored: {error}") from error


class TapReader:
    """Reads taps of frames by a trunk. frame: (h, w). Errors: FitError for a trunk that lacks a tap."""

    def __init__(
        self,
        graph: bytes,
        taps: Sequence[str],
        frame: tuple[int, int],
        pixels_per_mm: float,
        threads: int = 1,
        name: str = "trunk",
    ) -> None:
        self._session, self._threads = open_session(graph, threads, name), threads
        self.grid = trunk_grid(self._session, taps, frame, pixels_per_mm)

    def take(self, frames: U8, progress: Progress = lambda fraction: None) -> Features:
        """Return every tap of frames, uint8 (n, h, w, 3)."""
        return extract(self._session, frames, self.grid, progress)

    def nominal(self, presses: NominalPresses, progress: Progress = lambda fraction: None) -> Nominal:
        """Return what is learnt from presses."""
        free, features = presses.no_contact, self.take(presses.frames, progress)
        return Nominal(features, presses.touched, None if free is None else self.take(free))

    def learner(self, detector: Detector, parameters: Any = None, seed: int = 0) -> Learner:
        """Return the learner of a detector, with its defaults if no parameters are given."""
        parameters = parameters or detector.parameters()
        grid = replace(self.grid, taps={tap: self.grid.taps[tap] for tap in detector.taps(parameters)})
        return Learner(detector, grid, parameters, seed, self._threads)


ROOMS = (1.0, 1.5, 2.0, 4.0)
"""The factors of a bank's usual room, tried in turn until it covers its nominal presses."""

COVERED_RATIO = 1.1
"""How far nominal presses may score above their out-of-fold scores with the final bank, in the median."""

COVERED_SHARE = 0.25
"""The share of nominal presses that may fail with it: a missing place of every press makes most of them fail."""


@dataclass(frozen=True, eq=False)
class Covered:
    """A bank that covers its nominal presses."""

    bank: Bank
    room: float
    """How many times its usual size it may have."""
    held_out: HeldOut | None = None
    """What banks without them show of the presses; None where no threshold is wanted."""
    known: ScoredPresses | None = None
    """The nominal presses by the bank, which knows them; None where no threshold is wanted."""

    @property
    def scores(self) -> F64 | None:
        """Scores of the nominal presses, (n,), for the threshold."""
        if self.held_out is None or self.known is None:
            return None
        return np.maximum(self.known.scores, self.held_out.sound.scores)


def covering_bank(
    learner: Learner,
    nominal: Nominal,
    learn: Callable[[Nominal], tuple[Bank, HeldOut | None]],
    find_threshold: Callable[[F64], float],
    shown: ShownPresses | None = None,
) -> Covered:
    """Learn a bank with the least room in which it covers the presses.

    learn: nominal presses and a room to a bank, and what banks without them show of the presses. find_threshold: from
    scores. shown: the nominal presses as the gateway shows them; None as they are learnt. Errors: FitError where more
    room does not help.
    """
    shown = shown or ShownPresses(nominal.features)
    size = 0
    for room in ROOMS:
        bank, held_out = learn(replace(nominal, room=room))
        if held_out is None:
            return Covered(bank, room)
        unknown = held_out.sound.scores
        known = learner.score_shown(bank, shown, np.arange(nominal.presses))
        if is_covered(known.scores, unknown, find_threshold(unknown)):
            return Covered(bank, room, held_out, known)
        if (grown := sum(array.nbytes for array in bank.arrays.values())) <= size:
            break
        size = grown
    raise FitError(
        f"the bank of {learner.detector.name} lacks what its own nominal presses show: they score higher by it than by "
        "banks that do not know them, and good parts would fail; fit another method, or look whether the presses are "
        "of one part at one position"
    )


def is_covered(known: F64, held_out: F64, threshold: float) -> bool:
    """Tell whether few nominal presses fail with the final bank, and in the median they do not score higher with it.

    known, held_out: their scores with the final bank and with banks without them, (n,) each. threshold: from the
    latter.
    """
    is_higher = np.median(known) > COVERED_RATIO * np.median(held_out)
    return bool(np.mean(known > threshold) <= COVERED_SHARE and not is_higher)
