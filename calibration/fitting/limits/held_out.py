"""Scores of nominal presses by banks without them, for the threshold."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.augmentation import Copies
from edge.core.detector import Bank, Detector, Features, Grid, Nominal, Progress
from edge.core.errors import FitError
from edge.core.registration.pose import Registered
from edge.model.packing import pack, unpack
from edge.model.session import RUNTIME_ERRORS, open_session

__all__ = ["HeldOut", "Learner", "ScoredPresses", "ShownPresses", "score_held_out"]

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ShownPresses:
    """n presses as the gateway brings them to a bank."""

    features: Features
    registered: Sequence[Registered] | None = None
    """Each of these; None where presses are scored as they lie, and all places count."""

    @cached_property
    def seen(self) -> Mask | None:
        """The places that count, (n, h, w); None for all."""
        return None if self.registered is None else np.stack([one.seen for one in self.registered])


@dataclass(frozen=True, eq=False)
class ScoredPresses:
    """What banks show of n presses."""

    maps: NDArray[np.float32]
    """Raw score maps, (n, h, w)."""
    scores: NDArray[np.float64]
    """Anomaly scores, (n,)."""
    head_ms: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    """What the head took for each, (n,), or none."""
    seen: Mask | None = None
    """The places that count, (n, h, w); None for all."""
    gel_limits: NDArray[np.float32] | None = None
    """By what these places are divided, (n, h, w); None for nothing."""

    def weigh(self, maps: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return these maps of the presses, (n, h, w), as the gateway compares them with the limit."""
        weighed = maps if self.gel_limits is None else maps / self.gel_limits
        return (
            weighed if self.seen is None else np.where(self.seen, weighed, weighed.min((1, 2), keepdims=True))
        )

    def highest(self, maps: NDArray[np.floating]) -> NDArray[np.float64]:
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
        head = open_session(self.head(bank), self.threads, f"head of {self.detector.name}")
        wanted = {i.name for i in head.get_inputs()}
        stored = {name: _as_stored(bank, name) for name in bank.arrays if name in wanted}
        taps = {tap: maps for tap, maps in features.items() if tap in wanted}
        scored = _empty(self.grid, len(rows))
        for place, k in enumerate(rows):
            start = time.perf_counter()
            inputs = {**_select(taps, [k]), **stored}
            try:
                score_map, score = head.run(["score_map", "score"], inputs)
            except RUNTIME_ERRORS as error:
                raise FitError(f"the head does not run on a fold of the presses: {error!s:.300}") from error
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
