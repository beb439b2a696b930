"""Scars of a gel as relief and lost light: scratches, dents, hairs and worn coat, each growing from nothing to full.

Sizes are assumed, from what shows on public pictures of used gels; heights are of the coat, in mm towards the camera.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calibration.simulator import reproducible_math
from calibration.simulator.field_of_view import F32, Field, grids

__all__ = ["SCARS", "Scar", "random_scar"]

# Presses over which a scar grows to its full size; 1 is a cut.
_GROWTHS = (1, 1, 5, 20)


@dataclass(frozen=True)
class Scar:
    """One mark of the gel. at_mm: its middle, from the picture's. size: its length or radius in mm.

    strength: height in mm, or for worn coat the share of light lost. since: the press from which it exists; it grows
    evenly over `growth` presses.
    """

    kind: str
    at_mm: tuple[float, float]
    turn_rad: float
    size: float
    strength: float
    since: int
    growth: int = 1
    seed: int = 0

    def share(self, press: int) -> float:
        """Of its full strength, at the press with this number; 0 before it exists."""
        return min(1.0, max(0.0, (press - self.since + 1) / self.growth))

    def relief(self, field: Field) -> F32:
        """At full strength, in mm, float32 (h, w); nothing for worn coat."""
        pattern = _pattern(self, field)
        return np.asarray(pattern * np.float32(_SIGNS[self.kind] * self.strength), np.float32)

    def coat(self, field: Field) -> F32:
        """The share of light that is left at full strength, float32 (h, w)."""
        if self.kind != "worn_coat":
            return np.ones(field.shape, np.float32)
        return np.asarray(1 - np.float32(self.strength) * _pattern(self, field), np.float32)


_SIGNS: Mapping[str, float] = {"scratch": -1.0, "dent": -1.0, "hair": 1.0, "worn_coat": 0.0}


def _pattern(scar: Scar, field: Field) -> F32:
    """From 0 to 1, float32 (h, w)."""
    x, y = grids(field)
    dx, dy = x - np.float32(scar.at_mm[0]), y - np.float32(scar.at_mm[1])
    cos, sin = np.float32(math.cos(scar.turn_rad)), np.float32(math.sin(scar.turn_rad))
    return SCARS[scar.kind](cos * dx + sin * dy, cos * dy - sin * dx, scar)


def _line(along: F32, across: F32, scar: Scar, half_width_mm: float, bend: float) -> F32:
    away = across - np.float32(bend) * along * along
    ends = np.clip((np.float32(scar.size / 2) - np.abs(along)) / np.float32(0.3), 0, 1)
    return np.asarray(ends * reproducible_math.exp(-((away / np.float32(half_width_mm)) ** 2)), np.float32)


def _scratch(along: F32, across: F32, scar: Scar) -> F32:
    """A furrow about 0.15 mm wide."""
    return _line(along, across, scar, 0.08, 0.03)


def _hair(along: F32, across: F32, scar: Scar) -> F32:
    """A bent fibre 0.08 mm across, between coat and part."""
    return _line(along, across, scar, 0.05, 0.12)


def _dent(along: F32, across: F32, scar: Scar) -> F32:
    """A round hollow that the gel does not fill again."""
    r2 = (along * along + across * across) / np.float32(scar.size * scar.size)
    return np.asarray(reproducible_math.exp(-r2 * 2), np.float32)


def _worn_coat(along: F32, across: F32, scar: Scar) -> F32:
    """A rubbed patch: ragged, with sharp edges."""
    rng = np.random.default_rng(scar.seed)
    angle = reproducible_math.arctan2(across, along)
    waves = sum(
        np.float32(a) * reproducible_math.sin(np.float32(n) * angle + np.float32(p))
        for n, a, p in zip((2, 3, 5, 9), rng.uniform(0.05, 0.2, 4), rng.uniform(0, 6.3, 4), strict=True)
    )
    radius = np.sqrt(along * along + across * across) / np.float32(scar.size)
    return np.asarray(np.clip((1 + waves - radius) * 6, 0, 1), np.float32)


SCARS: Mapping[str, Callable[[F32, F32, Scar], F32]] = {
    "scratch": _scratch,
    "dent": _dent,
    "hair": _hair,
    "worn_coat": _worn_coat,
}

_SIZES_MM = {"scratch": (1.0, 5.0), "dent": (0.3, 0.9), "hair": (2.0, 7.0), "worn_coat": (0.4, 1.2)}
_STRENGTHS = {
    "scratch": (0.012, 0.06),
    "dent": (0.02, 0.1),
    "hair": (0.02, 0.06),
    "worn_coat": (0.1, 0.35),
}


def random_scar(kind: str, spot_mm: tuple[float, float], since: int, rng: np.random.Generator) -> Scar:
    """A scar of random size and growth at a spot."""
    return Scar(
        kind,
        spot_mm,
        float(rng.uniform(0, math.pi)),
        float(rng.uniform(*_SIZES_MM[kind])),
        float(rng.uniform(*_STRENGTHS[kind])),
        since,
        int(rng.choice(_GROWTHS)),
        int(rng.integers(2**31)),
    )
