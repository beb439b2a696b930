"""Relief that nominal presses have and a press has not: an object that is smoother than the part, or barely touches.

A score map shows what a press has and nominal presses have not; a smoother press has nothing of that. So the finest tap
is asked how rough the press is where it touches, whatever its light and wherever the part lies. With f a cell's
features:

    contact = clip(|f - free| / level - 1/2, 0, 1)
    lack    = (weights . f - middle)                       0 on a nominal press, 1 at the limit
    smooth  = sum(contact * lack) / (sum(contact) + weakest)
    faint   = 11 weakest / (10 sum(contact) + weakest)     1 where the contact is as weak as the weakest allowed
    missing = max(smooth, faint)

The map shows the places that lack most, and is 0 until `missing` comes near its limit: so it changes no score of a
press whose relief is there.

All of it is float64 NumPy; `head_relief` writes the same into a head.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["FAINT", "START", "STEEPNESS", "MissingRelief", "Pooled", "contact_of", "pool"]

Float = NDArray[np.float64]
Floating = NDArray[np.floating]

START = 0.9
"""The map begins to show below the limit, at this share of it, and is complete at the limit."""

STEEPNESS = 10.0
"""1 / (1 - START)."""

FAINT = 10.0
"""No contact at all is this many times and one beyond the limit: a quotient needs an end."""

# A sum that is 0 has no peak to divide by.
TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Pooled:
    """Presses over their contact."""

    means: Float
    """Mean features, float64 (n, channels)."""
    contact: Float
    """Cells in contact, float64 (n,)."""

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "Pooled":
        return Pooled(self.means[rows], self.contact[rows])


def contact_of(features: Floating, free: Float, level: float) -> Float:
    """Return how much each cell touches, 0 to 1, float64 (n, h, w).

    features: (n, channels, h, w). free: those of the free gel, (channels, 1, 1).
    """
    distance = np.sqrt(np.square(features - free).sum(axis=1))
    return np.asarray(np.clip(distance / level - 0.5, 0, 1))


def pool(features: Floating, free: Float, level: float) -> Pooled:
    """Pool the presses' features (n, channels, h, w), averaged over what touches; press by press, for their size."""
    means, contact = np.zeros(features.shape[:2]), np.zeros(len(features))
    for k, one in enumerate(features):
        touch = contact_of(one[None], free, level)[0]
        contact[k] = touch.sum()
        means[k] = np.tensordot(one.astype(np.float64), touch, 2) / max(contact[k], TINY)
    return Pooled(means, contact)


@dataclass(frozen=True, eq=False)
class MissingRelief:
    """What tells a smoother press from a nominal one."""

    tap: str
    """The tap whose features are read."""
    free: Float
    """Features of the free gel, float64 (channels, 1, 1)."""
    level: float
    """The distance from the free gel at which a cell touches half."""
    weights: Float
    """With `middle` as above, float64 (channels,)."""
    middle: float
    weakest: float
    """The least contact, in cells."""
    expected: Float
    """The mean contact of nominal presses, float64 (rows, columns)."""
    rows: Float
    columns: Float
    """With `rows`, (h, rows) and (w, columns): they bring the tap's cells to the score map."""
    unit: float = 1.0
    """The score at the limit."""

    def __post_init__(self) -> None:
        if not (self.level > 0 and self.weakest > 0 and self.unit > 0):
            raise ValueError(
                f"level, weakest contact and unit are positive, found {self.level}, {self.weakest} and {self.unit}"
            )

    def missing_of(self, presses: Pooled) -> Float:
        """Return how much relief is missing, float64 (n,), 1 at the limit."""
        lack = presses.means @ self.weights - self.middle
        smooth = lack * presses.contact / (presses.contact + self.weakest)
        faint = (FAINT + 1) * self.weakest / (FAINT * presses.contact + self.weakest)
        return np.maximum(smooth, faint)

    def missing(self, features: Floating) -> Float:
        """Return how much relief is missing from features (n, channels, h, w)."""
        return self.missing_of(pool(features, self.free, self.level))

    def score_map(self, features: Floating) -> Float:
        """Map where relief is missing, in units of the bundle's scores, float64 (n, h, w); 0 where little is."""
        touch = contact_of(features, self.free, self.level)
        lack = np.einsum("nchw,c->nhw", features.astype(np.float64), self.weights) - self.middle
        places = np.maximum(touch * lack, 0) + np.maximum(self.expected - touch, 0)
        shown = self.rows @ places @ self.columns.T
        missing = self.missing(features)
        height = self.unit * missing * np.clip(STEEPNESS * (missing - START), 0, 1)
        peak = shown.max(axis=(1, 2)) + TINY
        return np.asarray((height / peak)[:, None, None] * shown)
