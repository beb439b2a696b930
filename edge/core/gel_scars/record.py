"""The decaying record of one gel: where presses exceeded their limit, how the part had moved, and what is masked.

All places are those of the gel: pixels of the contact view. The record has one size for ever, whatever is pressed.
"""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, Mask
from edge.core.imaging.decode import VIEW_SIZE

__all__ = ["PLANES", "Repeats", "ScarRecord"]

PLANES: Final = 7
# What each plane holds: presses that exceeded here, those that did not, the weight of the mask; of the presses that
# exceeded with a known pose of the part, their number, and the sums of its moves x and y and of x * x + y * y in mm.
_HITS, _QUIET, _MASK, _PLACED, _X, _Y, _SQUARES = range(PLANES)

# Older presses count less: half after 44 presses.
_KEPT = 1 - 1 / 64
# A masked place that is pressed and quiet keeps this share of its weight: after 18 such presses in a row it is
# forgotten.
_QUIET_KEEPS = 7 / 8
_FORGOTTEN = 0.1


@dataclass(frozen=True)
class Repeats:
    """How often a place of the gel exceeded the limit before."""

    hits: float = 0.0
    """Presses, decayed."""
    rate: float = 0.0
    """The share of the presses that showed the place."""
    spread_mm: float = 0.0
    """Standard deviation of the place of the part that lay there; 0 where it is not known."""


@dataclass(frozen=True, eq=False)
class ScarRecord:
    """planes: float32 (7, h, w), finite and, but for x and y, not negative."""

    planes: F32

    def __post_init__(self) -> None:
        if self.planes.ndim != 3 or len(self.planes) != PLANES or self.planes.dtype != np.float32:
            raise ValueError(f"a record is float32 (7, h, w), found {self.planes.dtype} {self.planes.shape}")
        if not np.isfinite(self.planes).all() or self.planes[: _PLACED + 1].min() < 0:
            raise ValueError("a record has finite values, and numbers of presses of 0 or more")

    @classmethod
    def from_file(cls, planes: NDArray[Any]) -> Self:
        """Make the record from planes of the view's size. Errors: ValueError."""
        if planes.shape[1:] != VIEW_SIZE[::-1]:
            raise ValueError(f"it is {planes.shape}")
        return cls(planes)

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Self:
        """Make the record of a new gel. shape: (h, w) of the view."""
        return cls(np.zeros((PLANES, *shape), np.float32))

    @property
    def masked(self) -> Mask:
        """The places of known scars, bool (h, w)."""
        return np.asarray(self.planes[_MASK] > 0)

    def repeats(self, places: Mask) -> Repeats:
        """Read the repeats of the place, among these, that exceeded most often. places: bool (h, w)."""
        if not places.any():
            return Repeats()
        at = int(np.where(places, self.planes[_HITS], -1).argmax())
        hits, quiet, _, placed, x, y, squares = self.planes.reshape(PLANES, -1)[:, at].tolist()
        variance = squares / placed - (x * x + y * y) / placed**2 if placed > 1 else 0.0
        rate = hits / (hits + quiet) if hits > 0 else 0.0
        return Repeats(float(hits), float(rate), float(np.sqrt(max(variance, 0.0))))

    def often(self, least: float) -> Mask:
        """Find where at least this number of presses, decayed, exceeded: bool (h, w)."""
        return np.asarray(self.planes[_HITS] >= least)

    def after(
        self,
        exceeds: Mask,
        shown: Mask,
        scars: Mask,
        moved_mm: F32 | None,
    ) -> "ScarRecord":
        """Make the record with one more press. All masks: bool (h, w).

        exceeds: above the limit. shown: what the press shows of the gel. scars: to be masked from now on. moved_mm:
        how far the part's place there has moved, (x, y), float32 (2, h, w); None where it is not known.
        """
        planes = self.planes * np.float32(_KEPT)
        quiet = shown & ~exceeds
        planes[_HITS] += exceeds
        planes[_QUIET] += quiet
        if moved_mm is not None:
            x, y = moved_mm
            for plane, value in ((_PLACED, np.ones_like(x)), (_X, x), (_Y, y), (_SQUARES, x * x + y * y)):
                planes[plane] += value * exceeds
        weight = np.where(quiet, self.planes[_MASK] * np.float32(_QUIET_KEEPS), self.planes[_MASK])
        weight[weight < _FORGOTTEN] = 0
        weight[scars | (exceeds & self.masked)] = 1
        planes[_MASK] = weight
        return ScarRecord(planes)
