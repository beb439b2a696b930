"""Scars of a gel as relief and lost light: scratches, dents, hairs and worn coat, each growing from nothing to full.

Sizes are assumed, from what shows on public pictures of used gels; heights are of the coat, in mm towards the camera.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from calibration.simulator import reproducible_math
from calibration.simulator.field_of_view import Field, grids
from edge.core.arrays import F32

__all__ = ["SCARS", "Scar", "grain", "mark_gel", "random_scar"]

# Presses over which a scar grows to its full size; 1 is a cut.
_GROWTHS = (1, 1, 5, 20)


@dataclass(frozen=True)
class Scar:
    """One mark of the gel."""

    kind: str
    at_mm: tuple[float, float]
    """Its middle, from the picture's."""
    turn_rad: float
    size: float
    """Its length or radius in mm."""
    strength: float
    """Height in mm, or for worn coat the share of light lost."""
    since: int
    """The press from which it exists; it grows evenly over `growth` presses."""
    growth: int = 1
    seed: int = 0

    def share(self, press: int) -> float:
        """Return the share of its full strength at the press with this number; 0 before it exists."""
        return min(1.0, max(0.0, (press - self.since + 1) / self.growth))

    def relief(self, field: Field) -> F32:
        """Return the relief at full strength, in mm, float32 (h, w); nothing for worn coat."""
        return np.asarray(
            _pattern(self, field) * np.float32(SCARS[self.kind].sign * self.strength), np.float32
        )

    def coat(self, field: Field) -> F32:
        """The share of light that is left at full strength, float32 (h, w)."""
        if SCARS[self.kind].sign:
            return np.ones(field.shape, np.float32)
        return np.asarray(1 - np.float32(self.strength) * _pattern(self, field), np.float32)


@lru_cache(maxsize=64)  # more than a gel has; a press shows all of its gel's three times
def _pattern(scar: Scar, field: Field) -> F32:
    """Return a scar's shape from 0 to 1, float32 (h, w), read-only."""
    x, y = grids(field)
    dx, dy = x - np.float32(scar.at_mm[0]), y - np.float32(scar.at_mm[1])
    cos, sin = np.float32(math.cos(scar.turn_rad)), np.float32(math.sin(scar.turn_rad))
    pattern = SCARS[scar.kind].pattern(cos * dx + sin * dy, cos * dy - sin * dx, scar)
    pattern.setflags(write=False)
    return pattern


def _line(along: F32, across: F32, scar: Scar, half_width_mm: float, bend: float) -> F32:
    away = across - np.float32(bend) * along * along
    ends = np.clip((np.float32(scar.size / 2) - np.abs(along)) / np.float32(0.3), 0, 1)
    return np.asarray(ends * reproducible_math.exp(-((away / np.float32(half_width_mm)) ** 2)), np.float32)


def _dent(along: F32, across: F32, scar: Scar) -> F32:
    """A round hollow that the gel does not fill again."""
    r2 = (along * along + across * across) / np.float32(scar.size * scar.size)
    return np.asarray(reproducible_math.exp(-r2 * 2), np.float32)


def _rub_coat(along: F32, across: F32, scar: Scar) -> F32:
    """Return a rubbed patch: ragged, with sharp edges."""
    rng = np.random.default_rng(scar.seed)
    angle = reproducible_math.arctan2(across, along)
    waves = sum(
        np.float32(a) * reproducible_math.sin(np.float32(n) * angle + np.float32(p))
        for n, a, p in zip((2, 3, 5, 9), rng.uniform(0.05, 0.2, 4), rng.uniform(0, 6.3, 4), strict=True)
    )
    radius = np.sqrt(along * along + across * across) / np.float32(scar.size)
    return np.asarray(np.clip((1 + waves - radius) * 6, 0, 1), np.float32)


class ScarKind(NamedTuple):
    """What scars of one kind have in common."""

    pattern: Callable[[F32, F32, Scar], F32]
    sign: float
    """Of its height; 0 for one that only takes light."""
    sizes_mm: tuple[float, float]
    strengths: tuple[float, float]


SCARS: Mapping[str, ScarKind] = {
    # A furrow about 0.15 mm wide; a hair is a bent fibre 0.08 mm across, between coat and part.
    "scratch": ScarKind(partial(_line, half_width_mm=0.08, bend=0.03), -1.0, (1.0, 5.0), (0.012, 0.06)),
    "dent": ScarKind(_dent, -1.0, (0.3, 0.9), (0.02, 0.1)),
    "hair": ScarKind(partial(_line, half_width_mm=0.05, bend=0.12), 1.0, (2.0, 7.0), (0.02, 0.06)),
    "worn_coat": ScarKind(_rub_coat, 0.0, (0.4, 1.2), (0.1, 0.35)),
}


def random_scar(kind: str, spot_mm: tuple[float, float], since: int, rng: np.random.Generator) -> Scar:
    """A scar of random size and growth at a spot."""
    return Scar(
        kind,
        spot_mm,
        float(rng.uniform(0, math.pi)),
        float(rng.uniform(*SCARS[kind].sizes_mm)),
        float(rng.uniform(*SCARS[kind].strengths)),
        since,
        int(rng.choice(_GROWTHS)),
        int(rng.integers(2**31)),
    )


def grain(spot_mm: tuple[float, float], radius_mm: float, height_mm: float, since: int) -> Scar:
    """Return a grain of dust between coat and part: a round hollow, upside down."""
    return Scar("dent", spot_mm, 0.0, 2 * radius_mm, -height_mm, since)


def mark_gel(surface: F32, scars: Iterable[tuple[Scar, float]], field: Field) -> tuple[F32, F32]:
    """Return the surface with scars, mm, and the share of light that they leave, float32 (h, w) each.

    scars: each with the share of its full strength.
    """
    coat = np.ones(field.shape, np.float32)
    for scar, share in scars:
        surface = surface + np.float32(share) * scar.relief(field)
        coat *= 1 - np.float32(share) * (1 - scar.coat(field))
    return np.asarray(surface, np.float32), coat
