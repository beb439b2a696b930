"""Scores of nominal presses by banks without them, for the threshold."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from calibration.fitting.presses.augmentation import Copies
from edge.core.detector import Bank, Detector, Features, Grid, Nominal, Progress
from edge.core.errors import FitError
from edge.model.packing import pack, unpack
from edge.model.session import RUNTIME_ERRORS, open_session

__all__ = ["HeldOut", "Learner", "ScoredPresses", "held_out", "held_out_scores"]


@dataclass(frozen=True)
class Learner:
    """A detector with everything to learn and to score.

    seed: fixes every random choice, the same for each bank. copies: of the fit's nominal presses, which a bank learns
    with them.
    """

    detector: Detector
    grid: Grid
    parameters: Any
    seed: int
    threads: int
    copies: Copies | None = None

    def bank(
        self,
        nominal: Nominal,
        progress: Progress = lambda fraction: None,
        presses: NDArray[np.int64] | None = None,
    ) -> Bank:
        """presses: which of the fit's presses these are, (n,); None for all. Errors: FitError."""
        rng = np.random.default_rng(self.seed)
        if self.copies is not None:
            nominal = self.copies.added(nominal, np.arange(nominal.presses) if presses is None else presses)
        return self.detector.fit(nominal, self.grid, self.parameters, rng, progress)

    def head(self, bank: Bank) -> bytes:
        """Errors: FitError."""
        return self.detector.head(self.grid, bank, self.parameters)

    def scores(self, bank: Bank, features: Features, rows: Sequence[int]) -> NDArray[np.float64]:
        """Anomaly scores (len(rows),) of those presses, with the bank as stored. Errors: FitError."""
        return self.scored(bank, features, rows).scores

    def scored(self, bank: Bank, features: Features, rows: Sequence[int]) -> "ScoredPresses":
        """Score maps and anomaly scores of those presses, with the bank as stored. Errors: FitError."""
        head = open_session(self.head(bank), self.threads, f"head of {self.detector.name}")
        wanted = {i.name for i in head.get_inputs()}
        stored = {name: _as_stored(bank, name) for name in bank.arrays if name in wanted}
        taps = {tap: maps for tap, maps in features.items() if tap in wanted}
        found = [_head_answer(head, {**_chosen(taps, [k]), **stored}) for k in rows]
        maps = np.stack([one for one, *_ in found]) if found else np.empty((0, *self.grid.frame), np.float32)
        scores, ms = np.array([found_in[1:] for found_in in found]).reshape(-1, 2).T
        return ScoredPresses(maps, scores, ms)

    def bank_without(self, nominal: Nominal, held: NDArray[np.int64]) -> Bank:
        """A bank of the other presses, with the same share of room as the final bank. Errors: FitError."""
        kept = np.setdiff1d(np.arange(nominal.presses), held)
        room = nominal.room * len(kept) / nominal.presses
        others = replace(nominal, features=_chosen(nominal.features, kept), room=room)
        return self.bank(others, presses=kept)


@dataclass(frozen=True, eq=False)
class ScoredPresses:
    """Of n presses: raw score maps float32 (n, h, w), and anomaly scores float64 (n,).

    head_ms: what the head took for each, float64 (n,), or none.
    """

    maps: NDArray[np.float32]
    scores: NDArray[np.float64]
    head_ms: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What banks without them show of the nominal presses, and of the same with damage, press by press."""

    sound: ScoredPresses
    edited: ScoredPresses


def held_out(
    learner: Learner,
    nominal: Nominal,
    folds: Sequence[NDArray[np.int64]],
    edited: tuple[Features, NDArray[np.int64]] | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> HeldOut:
    """Out of fold. folds: a partition of the presses. edited: features of m presses with damage, and which nominal
    press each was, (m,). Errors: FitError.
    """
    features, of = edited or (
        {tap: maps[:0] for tap, maps in nominal.features.items()},
        np.empty(0, np.int64),
    )
    sound, damaged = (_room(learner.grid, count) for count in (nominal.presses, len(of)))
    for number, held in enumerate(folds):
        bank = learner.bank_without(nominal, held)
        _put(sound, held, learner.scored(bank, nominal.features, held.tolist()))
        if (rows := np.flatnonzero(np.isin(of, held))).size:
            _put(damaged, rows, learner.scored(bank, features, rows.tolist()))
        progress((number + 1) / len(folds))
    return HeldOut(sound, damaged)


def held_out_scores(
    learner: Learner,
    nominal: Nominal,
    folds: Sequence[NDArray[np.int64]],
    progress: Callable[[float], None] = lambda fraction: None,
) -> NDArray[np.float64]:
    """The out-of-fold score of every press, float64 (n,). As `held_out`."""
    return held_out(learner, nominal, folds, progress=progress).sound.scores


def _room(grid: Grid, presses: int) -> ScoredPresses:
    return ScoredPresses(np.empty((presses, *grid.frame), np.float32), np.empty(presses), np.empty(presses))


def _put(into: ScoredPresses, rows: NDArray[np.int64], found: ScoredPresses) -> None:
    into.maps[rows], into.scores[rows], into.head_ms[rows] = found.maps, found.scores, found.head_ms


def _chosen(features: Features, rows: Sequence[int] | NDArray[np.int64]) -> Features:
    return {tap: maps[np.asarray(rows)] for tap, maps in features.items()}


def _head_answer(
    head: ort.InferenceSession, inputs: Mapping[str, NDArray[Any]]
) -> tuple[NDArray[np.float32], float, float]:
    """The score map and the anomaly score of one press, and the milliseconds of the head. Errors: FitError."""
    start = time.perf_counter()
    try:
        score_map, score = head.run(["score_map", "score"], dict(inputs))
        return score_map[0], float(score[0]), (time.perf_counter() - start) * 1e3
    except RUNTIME_ERRORS as error:
        raise FitError(f"the head does not run on a fold of the presses: {error!s:.300}") from error


def _as_stored(bank: Bank, name: str) -> NDArray[Any]:
    """A bank array after storing and loading."""
    packing = bank.packing.get(name, "none")
    try:
        return unpack(pack(bank.arrays[name], packing), packing)
    except ValueError as error:
        raise FitError(f"bank array '{name}' cannot be stored: {error}") from error
