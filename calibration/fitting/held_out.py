"""Scores of nominal presses by banks without them, for the threshold."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from calibration.fitting.heads import head_of
from edge.core.detector import Bank, Detector, Features, Grid, Nominal, Progress
from edge.core.errors import FitError
from edge.model.packing import pack, unpack
from edge.model.session import RUNTIME_ERRORS, open_session

__all__ = ["Learner", "held_out_scores"]


@dataclass(frozen=True)
class Learner:
    """A detector with everything to learn and to score. seed: fixes every random choice, the same for each bank."""

    detector: Detector
    grid: Grid
    parameters: Any
    seed: int
    threads: int

    def bank(self, nominal: Nominal, progress: Progress = lambda fraction: None) -> Bank:
        """Errors: FitError."""
        rng = np.random.default_rng(self.seed)
        return self.detector.fit(nominal, self.grid, self.parameters, rng, progress)

    def head(self, bank: Bank) -> bytes:
        """Errors: FitError."""
        return head_of(self.detector, self.grid, bank, self.parameters)

    def scores(self, bank: Bank, features: Features, rows: Sequence[int]) -> NDArray[np.float64]:
        """Anomaly scores (len(rows),) of those presses, with the bank as stored. Errors: FitError."""
        head = open_session(self.head(bank), self.threads, f"head of {self.detector.name}")
        wanted = {i.name for i in head.get_inputs()}
        stored = {name: _as_stored(bank, name) for name in bank.arrays if name in wanted}
        taps = {tap: maps for tap, maps in features.items() if tap in wanted}
        return np.array([_head_score(head, {**_chosen(taps, [k]), **stored}) for k in rows])

    def bank_without(self, nominal: Nominal, held: NDArray[np.int64]) -> Bank:
        """A bank of the other presses, with the same share of room as the final bank. Errors: FitError."""
        kept = np.setdiff1d(np.arange(nominal.presses), held)
        room = nominal.room * len(kept) / nominal.presses
        return self.bank(replace(nominal, features=_chosen(nominal.features, kept), room=room))

    def scores_without(self, nominal: Nominal, held: NDArray[np.int64]) -> NDArray[np.float64]:
        """Scores of the presses held out, by a bank of the others."""
        return self.scores(self.bank_without(nominal, held), nominal.features, held.tolist())


def held_out_scores(
    learner: Learner,
    nominal: Nominal,
    folds: Sequence[NDArray[np.int64]],
    progress: Callable[[float], None] = lambda fraction: None,
) -> NDArray[np.float64]:
    """The out-of-fold score of every press, float64 (n,). folds: a partition of the presses. Errors: FitError."""
    scores = np.empty(nominal.presses)
    for number, held in enumerate(folds):
        scores[held] = learner.scores_without(nominal, held)
        progress((number + 1) / len(folds))
    return scores


def _chosen(features: Features, rows: Sequence[int] | NDArray[np.int64]) -> Features:
    return {tap: maps[np.asarray(rows)] for tap, maps in features.items()}


def _head_score(head: ort.InferenceSession, inputs: Mapping[str, NDArray[Any]]) -> float:
    """The anomaly score of one press. Errors: FitError."""
    try:
        return float(head.run(["score"], dict(inputs))[0][0])
    except RUNTIME_ERRORS as error:
        raise FitError(f"the head does not run on a fold of the presses: {error!s:.300}") from error


def _as_stored(bank: Bank, name: str) -> NDArray[Any]:
    """A bank array after storing and loading."""
    packing = bank.packing.get(name, "none")
    try:
        return unpack(pack(bank.arrays[name], packing), packing)
    except ValueError as error:
        raise FitError(f"bank array '{name}' cannot be stored: {error}") from error
