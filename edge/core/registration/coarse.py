"""The coarse pose: the correlation of slopes over all shifts at evenly spaced turns, by FFT.

It is divided by the energy of the complete press and of the complete part, so a part that has left the field in part
is found where most of it fits.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.core.registration.pose import Pose, turned_slopes

__all__ = ["GRID", "Candidate", "CoarseSearch"]

F32 = NDArray[np.float32]

GRID = 64
"""Cells along each side of the transform. The field has fewer, so little wraps round from one side to the other."""

# Candidates differ by more than this many turns, rows or columns.
_APART = (3, 2, 2)


@dataclass(frozen=True)
class Candidate:
    """pose: in cells. match: correlation of the slopes, at most 1."""

    pose: Pose
    match: float


class CoarseSearch:
    """A part at evenly spaced turns. slopes: float32 (h, w, 2) of the part, h and w at most 64. turns: how many."""

    def __init__(self, slopes: F32, turns: int) -> None:
        if max(slopes.shape[:2]) > GRID:
            raise ValueError(f"the coarse search takes at most {GRID} cells a side, found {slopes.shape[:2]}")
        self._turns = [2 * math.pi * k / turns for k in range(turns)]
        turned = np.stack([turned_slopes(slopes, Pose(turn_rad=-turn)) for turn in self._turns])
        norms = np.sqrt((turned.astype(np.float64) ** 2).sum(axis=(1, 2, 3), keepdims=True))
        turned /= np.maximum(norms, np.finfo(np.float32).tiny).astype(np.float32)
        self._spectra = np.conj(_spectra(turned)).transpose(1, 0, 2, 3)

    def candidates(self, slopes: F32, count: int) -> list[Candidate]:
        """The best poses, best first, none next to another: a regular part fits nearly as well a pitch further on.

        slopes: of a press, in cells.
        """
        found = self._matches(slopes)
        best = []
        for _ in range(count):
            turn, row, column = (int(k) for k in np.unravel_index(int(found.argmax()), found.shape))
            pose = Pose(float(_signed(column)), float(_signed(row)), self._turns[turn])
            best.append(Candidate(pose, float(found[turn, row, column])))
            turns, rows, columns = (
                np.arange(at - away, at + away + 1) % n
                for at, away, n in zip((turn, row, column), _APART, found.shape, strict=True)
            )
            found[np.ix_(turns, rows, columns)] = -1
        return best

    def roundness(self, slopes: F32) -> float:
        """How well a part agrees with itself at the turn at which it agrees least, at most 1: a ball nearly 1."""
        return float(self._matches(slopes).max(axis=(1, 2)).min())

    def _matches(self, slopes: F32) -> F32:
        """Of each turn and shift, float32 (turns, 64, 64)."""
        across, down = _spectra(slopes)
        product = self._spectra[0] * across
        product += self._spectra[1] * down
        norm = math.sqrt(float((slopes.astype(np.float64) ** 2).sum()))
        product *= np.float32(1 / max(norm, float(np.finfo(np.float32).tiny)))
        return np.asarray(np.fft.irfft2(product, (GRID, GRID)), np.float32)


def _signed(shift: int) -> int:
    """A place in the correlation, whose upper half are shifts to the left and up."""
    return (shift + GRID // 2) % GRID - GRID // 2


def _spectra(slopes: F32) -> NDArray[np.complex64]:
    """Of slopes (..., h, w, 2): complex64 (..., 2, 64, 33)."""
    planes = np.ascontiguousarray(np.moveaxis(slopes, -1, -3), np.float32)
    return np.asarray(np.fft.rfft2(planes, (GRID, GRID)), np.complex64)
