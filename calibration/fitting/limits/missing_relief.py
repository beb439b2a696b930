"""Relief that nominal presses have and a press has not: an object that is smoother than the part, or barely touches.

A score map shows what a press has and nominal presses have not; a smoother press has nothing of that. So the finest tap
is asked how rough the press is where it touches, whatever its light and wherever the part lies. With f a cell's
features:

    contact = clip(|f - free| / level - 1/2, 0, 1)
    lack    = weights . f - middle                         0 on a nominal press, 1 at the limit
    smooth  = sum(contact * lack) / (sum(contact) + weakest)
    faint   = 11 weakest / (10 sum(contact) + weakest)     1 where the contact is as weak as the weakest allowed
    missing = max(smooth, faint)

The map shows the places that lack most, and is 0 until `missing` comes near its limit: so it changes no score of a
press whose relief is there.

All of it is float64 NumPy; `appended` writes the same into a head.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pooled", "Relief", "contact_of", "find_missing", "map_missing", "pool"]

Float = NDArray[np.float64]
Floating = NDArray[np.floating]

Relief = Mapping[str, NDArray[Any]]
"""What tells a smoother press from a nominal one, as the arrays of a bank: `relief_free` (channels, 1, 1), `_weights`
(1, channels, 1, 1), `_middle` (1,), `_expected` (the mean contact of nominal presses by cell), `_rows` and `_columns`
(they bring cells to the score map), and the numbers `_level`, `_weakest` and `_unit` (the score at the limit), (1, 1).
"""

# The map begins to show below the limit, at this share of it, and is complete at the limit, ten times steeper.
_START, _STEEPNESS = 0.9, 10.0
# No contact at all is this many times and one beyond the limit: a quotient needs an end.
_FAINT = 10.0
# A sum that is 0 has no peak to divide by.
_TINY = 1e-12


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
        means[k] = np.tensordot(one.astype(np.float64), touch, 2) / max(contact[k], _TINY)
    return Pooled(means, contact)


def find_missing(relief: Relief, features: Floating) -> Float:
    """Return how much relief is missing from features (n, channels, h, w), float64 (n,), 1 at the limit."""
    presses = pool(features, relief["relief_free"], float(relief["relief_level"].item()))
    lack = presses.means @ relief["relief_weights"][0, :, 0, 0] + relief["relief_middle"]
    weakest = relief["relief_weakest"].item()
    smooth = lack * presses.contact / (presses.contact + weakest)
    return np.asarray(np.maximum(smooth, (_FAINT + 1) * weakest / (_FAINT * presses.contact + weakest)))


def map_missing(relief: Relief, features: Floating) -> Float:
    """Map where relief is missing, in units of the bundle's scores, float64 (n, h, w); 0 where little is."""
    touch = contact_of(features, relief["relief_free"], float(relief["relief_level"].item()))
    lack = np.einsum("nchw,c->nhw", features.astype(np.float64), relief["relief_weights"][0, :, 0, 0])
    lacking = touch * (lack + relief["relief_middle"])
    places = np.maximum(lacking, 0) + np.maximum(relief["relief_expected"] - touch, 0)
    shown = relief["relief_rows"] @ places @ relief["relief_columns"]
    missing = find_missing(relief, features)
    height = relief["relief_unit"].item() * missing * np.clip(_STEEPNESS * (missing - _START), 0, 1)
    peak = shown.max(axis=(1, 2)) + _TINY
    return np.asarray((height / peak)[:, None, None] * shown)
