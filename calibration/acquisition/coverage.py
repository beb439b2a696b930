"""Coverage: which share of the part's places a new piece would show as never seen, by Good-Turing.

Ref: Good, The population frequencies of species (Biometrika 40, 1953): the share of things seen exactly once estimates
the chance that the next is new. Böhme, STADS (TOSEM 27, 2018), uses it to end a search. Here a "thing" is what a cell
of the feature map shows: a cell that finds no near neighbour among the other pieces, at the same place, was seen once.
Where pieces are not known, each press counts as one; otherwise a piece that is pressed often would cover itself.

Near is what is closer than half of all pairs of presses (of different pieces) are at their places: the median over
pairs and touched cells. The rule has no unit and no setting: it comes from the presses themselves.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.limits.threshold import pieces_of
from edge.core.arrays import F32, F64, Mask
from edge.core.binomial import CONFIDENCE, trials_needed, upper_rate

__all__ = [
    "EARLIEST",
    "FARTHEST",
    "LEAST",
    "MOST_CELLS",
    "PAYS",
    "ROUND",
    "Coverage",
    "PlaceDistances",
    "Standing",
    "fall",
    "pays_until",
    "rarefied",
]

LEAST = 4
"""With fewer pieces there is no coverage: with three each has two others, and half of all pairs are near."""

MOST_CELLS = 32
"""A feature map with more cells along a side is averaged down: 0.5 mm on the default region, as fine as damage."""


@dataclass(frozen=True)
class Coverage:
    """What n presses of some pieces show of a part."""

    near: float
    """The distance below which two cells show the same."""
    neighbours: NDArray[np.int64]
    """int (n, rows, cols), how many other pieces have a near press at each cell of each press."""
    touched: Mask
    """bool (rows, cols)."""
    pieces: int
    """The number of pieces; a press of an unknown piece counts as one."""

    @property
    def presses_of_each(self) -> float:
        return len(self.neighbours) / self.pieces

    @property
    def by_place(self) -> F64:
        """The share of presses that show something new at each cell, float64 (rows, cols); nan where untouched."""
        return np.where(self.touched, (self.neighbours == 0).mean(axis=0), np.nan)

    @property
    def unseen(self) -> float:
        """The share of touched cells that is expected to be new on a new piece, 0 to 1."""
        return float((self.neighbours[:, self.touched] == 0).mean())

    @property
    def newest(self) -> float:
        """The share of the last press's touched cells that no other piece shows."""
        return float((self.neighbours[-1, self.touched] == 0).mean())

    @property
    def curve(self) -> F64:
        """The unseen share after 1, 2, ... pieces, float64 (pieces,), averaged over all orders of the pieces."""
        counts = np.bincount(self.neighbours[:, self.touched].ravel(), minlength=self.pieces)
        return rarefied(counts / counts.sum())


def rarefied(shares: F64) -> F64:
    """The expected unseen share of every subset of 1 to n pieces, float64 (n,).

    shares: of cells with 0, 1, ... n - 1 near neighbours among n pieces, (n,). A cell with r of them is unseen in a
    random subset of m pieces that holds it with probability C(n - 1 - r, m - 1) / C(n - 1, m - 1)
    (Hurlbert, Ecology 52, 1971: rarefaction).
    """
    n = len(shares)
    r = np.arange(n, dtype=np.float64)
    unseen, unseen_shares = np.ones(n), [1.0]
    for m in range(1, n):
        unseen = unseen * np.maximum(n - r - m, 0) / (n - m)
        unseen_shares.append(float(unseen @ shares))
    return np.array(unseen_shares)


class PlaceDistances:
    """Distances between all presses at every cell, one press added at a time.

    After n presses it holds 4 n^2 bytes per cell: 30 MB for 100 presses of the default region.
    """

    def __init__(self) -> None:
        self._maps: list[F32] = []
        self._pieces: list[str | None] = []
        self._touched: Mask | None = None
        self._distances = np.zeros((0, 0, 0, 0), np.float32)

    def add(
        self,
        maps: F32,
        touched: Mask | None = None,
        piece: str | None = None,
    ) -> None:
        """Add one press. maps: its features, float32 (c, rows, cols). touched: bool (h, w) of the frame, None where
        the free gel is not known; then every cell counts. piece: None where unknown.

        Errors: ValueError for maps of another shape.
        """
        cells = _average_squares(maps)
        if self._maps and cells.shape != self._maps[0].shape:
            raise ValueError(f"features are {self._maps[0].shape}, found {cells.shape}")
        n, places = len(self._maps), cells.shape[1:]
        grown = np.zeros((n + 1, n + 1, *places), np.float32)
        if n:
            grown[:n, :n] = self._distances
        for k, other in enumerate(self._maps):
            grown[k, n] = grown[n, k] = np.sqrt(np.square(cells - other).sum(axis=0))
        self._distances = grown
        self._maps.append(cells)
        self._pieces.append(piece)
        shown = np.ones(places, np.bool_) if touched is None else _in_cells(touched, places)
        self._touched = shown if self._touched is None else self._touched | shown

    def coverage(self) -> Coverage | None:
        """Return the coverage; None for fewer than LEAST pieces, or where no press touches anything."""
        keys = np.array(pieces_of(self._pieces))
        pieces = list(dict.fromkeys(keys.tolist()))
        if len(pieces) < LEAST or self._touched is None or not self._touched.any():
            return None
        is_other = np.triu(keys[:, None] != keys[None])
        near = float(np.median(self._distances[is_other][:, self._touched]))
        is_near = self._distances <= near
        neighbours = sum(is_near[:, keys == piece].any(axis=1).astype(np.int64) for piece in pieces) - 1
        return Coverage(near, np.asarray(neighbours), self._touched, len(pieces))


def _average_squares(maps: F32) -> F32:
    """Average over squares of cells, so that no side has more than MOST_CELLS; what does not fill a square is cut."""
    c, rows, cols = maps.shape
    side = -(-max(rows, cols) // MOST_CELLS)
    kept = maps[:, : rows // side * side, : cols // side * side]
    blocks = kept.reshape(c, rows // side, side, cols // side, side)
    return np.asarray(blocks.mean(axis=(2, 4)), np.float32)


def _in_cells(touched: Mask, places: tuple[int, ...]) -> Mask:
    """Which cells hold a touched pixel."""
    rows, cols = np.nonzero(touched)
    cells = np.zeros(places, np.bool_)
    cells[rows * places[0] // touched.shape[0], cols * places[1] // touched.shape[1]] = True
    return cells


ROUND = 4
"""Presses between two forecasts."""

PAYS = 0.01
"""More presses pay while a round of them is expected to lower the unseen share by more than this."""

FARTHEST = 4
"""No forecast reaches farther than this many times the presses seen."""


def fall(curve: F64, step: float = ROUND) -> float:
    """Predict by how much the next `step` pieces lower the unseen share.

    curve: the unseen share after 1, 2, ... n pieces, see `Coverage.curve`; n is at least 4.
    """
    return float(_falls(curve, np.array([len(curve)], np.float64), step)[0])


def pays_until(curve: F64, step: float = ROUND) -> int:
    """The number of pieces, those seen included, from which on `step` more lower the unseen share by PAYS at most.

    At most FARTHEST times those seen. curve: as in `fall`.
    """
    n = len(curve)
    ahead = np.arange(n, FARTHEST * n + 1, dtype=np.float64)
    enough = _falls(curve, ahead, step) <= PAYS
    return int(ahead[np.argmax(enough)]) if enough.any() else FARTHEST * n


def _falls(curve: F64, at: F64, step: float) -> F64:
    """The fall over a step after `at` pieces, by a power law with the slope of the curve's second half."""
    n, last = len(curve), float(curve[-1])
    if last <= 0:
        return np.zeros_like(at)
    half = np.arange(max(2, n // 2), n + 1)
    slope = np.polyfit(np.log(half), np.log(curve[half - 1]), 1)[0]
    return np.asarray(last * ((at / n) ** slope - ((at + step) / n) ** slope), np.float64)


EARLIEST = 8
"""No coverage is trusted before this many presses: the curve's second half has five points then."""


@dataclass(frozen=True)
class Standing:
    """Where an acquisition is."""

    presses: int
    pieces: int | None
    """The number of pieces; None where it is not known which press is of which piece."""
    coverage: Coverage | None
    promise: float = 0.1
    """What is wanted: at most this rate of false alarms by press."""
    confidence: float = CONFIDENCE

    def rate(self, trials: int) -> float:
        """The false alarms that this number of presses, or pieces, without an alarm still allow."""
        return upper_rate(0, trials, self.confidence)

    @property
    def by_piece(self) -> float | None:
        """The rate by piece; None where pieces are not known, and of one, which shows nothing of others."""
        return self.rate(self.pieces) if self.pieces is not None and self.pieces > 1 else None

    @property
    def promised_at(self) -> int:
        """The number of presses without an alarm that promises it."""
        return trials_needed(self.promise, 0, self.confidence)

    @property
    def is_promised(self) -> bool:
        return self.presses >= self.promised_at

    @property
    def fall(self) -> float | None:
        """The share by which the next round is expected to lower the unseen share; None before EARLIEST presses."""
        if self.coverage is None or self.presses < EARLIEST:
            return None
        return fall(self.coverage.curve, ROUND / self.coverage.presses_of_each)

    @property
    def is_covered(self) -> bool:
        """True where more presses have stopped paying."""
        return self.fall is not None and self.fall <= PAYS

    @property
    def is_enough(self) -> bool:
        return self.is_promised and self.is_covered

    @property
    def covered_at(self) -> int | None:
        """The forecast of the presses in all from which on more do not pay; None where the coverage is unknown."""
        if self.coverage is None:
            return None
        if self.is_covered:
            return self.presses
        each = self.coverage.presses_of_each
        pieces = pays_until(self.coverage.curve, ROUND / each)
        return max(math.ceil(pieces * each), EARLIEST)

    @property
    def still_needed(self) -> int | None:
        """The forecast of presses still needed, for the promise and the coverage; None while it is unknown."""
        if self.covered_at is None:
            return None
        return max(self.promised_at, self.covered_at, self.presses) - self.presses
