"""The same press under other conditions, as a station sees them over its years: light, exposure, a lighter press."""

import numpy as np
from numpy.typing import NDArray

from calibration.simulator.field_of_view import F32

__all__ = ["dimmed", "fainter", "relit"]

U8 = NDArray[np.uint8]

# Another light: gains of each colour and their slope from edge to edge of the picture. A choice; automatic exposure
# moves the level of a GelSight Mini by a fifth within a session (edge/core/imaging/known_profiles.py).
_GAIN, _SLOPE = 0.15, 0.08


def relit(rgb: U8, rng: np.random.Generator) -> U8:
    """The press under another light: each colour brighter or darker, by a share that changes over the picture."""
    height, width = rgb.shape[:2]
    v, u = np.linspace(-1, 1, height)[:, None, None], np.linspace(-1, 1, width)[None, :, None]
    gain, across, down = (rng.uniform(-most, most, 3) for most in (_GAIN, _SLOPE, _SLOPE))
    return _levels(rgb * (1 + gain + across * u + down * v))


def dimmed(rgb: U8, share: float) -> U8:
    """The press at this share of the exposure."""
    return _levels(rgb * np.float32(share))


def fainter(rgb: U8, free: F32, share: float) -> U8:
    """The press with this share of its difference to the free gel, float32 (h, w, 3)."""
    return _levels(free + np.float32(share) * (rgb - free))


def _levels(found: NDArray[np.floating]) -> U8:
    return np.clip(np.round(found), 0, 255).astype(np.uint8)
