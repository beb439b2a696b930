"""The coarse pose: the correlation of slopes over all shifts at evenly spaced turns, by FFT.

It is divided by the energy of the complete press and of the complete part, so a part that has left the field in part
is found where most of it fits.
"""

import math
from collections.abc import Iterable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32
from edge.core.registration.pose import Pose, turn_slopes

__all__ = ["CoarseSearch", "shifts_alike"]

# The transform has this many times the cells of the field, so that little wraps round from one side to the other: what
# lies more than half of them from where most lie is not found. Balls at the rim lay up to 0.75 of the field away.
_ROOM = 11 / 7

# Candidates at one turn differ by more than two rows or columns.
_NEAR = np.arange(-2, 3)
# One back and one on along each axis.
_STEPS = np.concatenate([-np.eye(3, dtype=np.int64), np.eye(3, dtype=np.int64)])
# A coarse match within this share of the best may become the best when it is refined.
_NEARLY = 0.8


class CoarseSearch:
    """A part at evenly spaced turns. slopes: float32 (h, w, 2) of the part. turns: how many."""

    def __init__(self, slopes: F32, turns: int) -> None:
        self._grid = cv2.getOptimalDFTSize(math.ceil(_ROOM * max(slopes.shape[:2])))
        self._step_rad = 2 * math.pi / turns
        turned = np.stack([turn_slopes(slopes, Pose(turn_rad=-k * self._step_rad)) for k in range(turns)])
        norms = np.sqrt((turned.astype(np.float64) ** 2).sum(axis=(1, 2, 3), keepdims=True))
        turned /= np.maximum(norms, np.finfo(np.float32).tiny).astype(np.float32)
        self._spectra = np.conj(self._spectra_of(turned)).transpose(1, 0, 2, 3)

    def candidates(self, slopes: F32, count: int) -> list[tuple[Pose, float]]:
        """The best poses in cells, each with the correlation of its slopes, at most 1; best first, none by another.

        A regular part fits nearly as well a pitch further on. Those that fit much worse than the best are left out.
        slopes: of a press, in cells.
        """
        return self._choose(self._matches(slopes), count)

    def candidates_at(
        self, slopes: F32, count: int, turns_rad: Iterable[float]
    ) -> Iterator[list[tuple[Pose, float]]]:
        """Yield what `candidates` finds at the nearest turn alone, for each of these."""
        matches = self._matches(slopes)
        for turn in turns_rad:
            k, only = round(turn / self._step_rad) % len(matches), np.full_like(matches, -1)
            only[k] = matches[k]
            yield self._choose(only, count)

    def _choose(self, matches: F32, count: int) -> list[tuple[Pose, float]]:
        """Take the best places of matches, which are spent by it."""
        # Each turn's best place; only the turn at which a candidate was taken is searched again.
        each = matches.reshape(len(matches), -1)
        place = each.argmax(axis=1)
        height = each[np.arange(len(each)), place]
        best: list[tuple[Pose, float]] = []
        while len(best) < count:
            k = int(height.argmax())
            match = float(height[k])
            if best and match < _NEARLY * best[0][1]:
                break
            at = k, *divmod(int(place[k]), self._grid)
            turn, row, column = _vertex(matches, at)
            pose = Pose(self._to_shift(column), self._to_shift(row), turn * self._step_rad)
            best.append((pose, match))
            rows, columns = ((index + _NEAR) % self._grid for index in at[1:])
            matches[k, rows[:, None], columns] = -1
            place[k] = each[k].argmax()
            height[k] = each[k, place[k]]
        return best

    def roundness(self, slopes: F32) -> float:
        """Measure how well a part agrees with itself at the turn where it agrees least, at most 1: a ball nearly 1."""
        return float(self._matches(slopes).max(axis=(1, 2)).min())

    def _matches(self, slopes: F32) -> F32:
        """Compute the match of each turn and shift, float32 (turns, grid, grid)."""
        across, down = self._spectra_of(slopes)
        product = self._spectra[0] * across
        product += self._spectra[1] * down
        norm = math.sqrt(float((slopes.astype(np.float64) ** 2).sum()))
        product *= np.float32(1 / max(norm, float(np.finfo(np.float32).tiny)))
        return np.asarray(np.fft.irfft2(product, (self._grid, self._grid)), np.float32)

    def _to_shift(self, shift: float) -> float:
        """Convert a place in the correlation, whose upper half are shifts to the left and up."""
        return (shift + self._grid // 2) % self._grid - self._grid // 2

    def _spectra_of(self, slopes: F32) -> NDArray[np.complex64]:
        """Transform slopes (..., h, w, 2) to spectra, complex64 (..., 2, grid, grid // 2 + 1)."""
        planes = np.ascontiguousarray(np.moveaxis(slopes, -1, -3), np.float32)
        return np.asarray(np.fft.rfft2(planes, (self._grid, self._grid)), np.complex64)


def shifts_alike(
    slopes: F32, count: int, away_px: float, least_match: float, least_inside: float
) -> list[Pose]:
    """Find shifts of this many pixels or more at which a part agrees with itself so well, best first, none by another.

    slopes: float32 (h, w, 2). The match is over the places that both show, at least this share of the part.
    """
    h, w = slopes.shape[:2]
    energy, shows = (slopes**2).sum(axis=2), np.ones((h, w), np.float32)
    spectra = np.fft.rfft2(np.stack([slopes[..., 0], slopes[..., 1], energy, shows]), (2 * h, 2 * w))
    across, down, power, field = spectra
    product = np.fft.irfft2(np.abs(across) ** 2 + np.abs(down) ** 2, (2 * h, 2 * w))
    part_energy, press_energy = (
        np.fft.irfft2(each, (2 * h, 2 * w)) for each in (np.conj(power) * field, np.conj(field) * power)
    )
    is_shown = np.minimum(part_energy, press_energy) >= least_inside * float(energy.sum())
    match = np.where(
        is_shown, product / np.sqrt(np.maximum(part_energy * press_energy, np.finfo(np.float32).tiny)), -1
    )
    y, x = (np.fft.fftfreq(2 * side, 1 / (2 * side)) for side in (h, w))
    match[np.hypot(y[:, None], x) < away_px] = -1
    shifts = list[Pose]()
    while len(shifts) < count and match.max() >= least_match:
        row, column = divmod(int(match.argmax()), 2 * w)
        shifts.append(Pose(float(x[column]), float(y[row])))
        rows, columns = (row + _NEAR) % (2 * h), (column + _NEAR) % (2 * w)
        match[rows[:, None], columns] = -1
    return shifts


def _vertex(matches: F32, at: tuple[int, int, int]) -> list[float]:
    """Find the top between turns and cells, within half a step of a peak, by a parabola along each axis."""
    peak, top = float(matches[at]), list[float]()
    around = np.add(at, _STEPS) % matches.shape
    sides = matches[around[:, 0], around[:, 1], around[:, 2]].tolist()
    for index, before, after in zip(at, sides[:3], sides[3:], strict=True):
        bend = 2 * peak - before - after
        top.append(index if bend <= 0 else index + max(-0.5, min(0.5, (after - before) / (2 * bend))))
    return top
