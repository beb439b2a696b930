"""Scars of a gel as relief and lost light: scratches, dents, hairs and worn coat, each growing from nothing to full.

Sizes are assumed, from what shows on public pictures of used gels; heights are of the coat, in mm towards the camera.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.simulator import reproducible_math
from calibration.simulator.defects import Damaged, Defect
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import F32, LR, Field, grids
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.plan import PRESS_CYCLE_S
from calibration.simulator.pose import HeightField, Jitter, Pose, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.streams import Streams
from edge.core.contact.reference import View
from edge.core.imaging.decode import VIEW_SIZE

__all__ = ["PLACINGS", "SCARS", "Line", "Placing", "Scar", "random_scar"]

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
            self._pattern(field) * np.float32(SCARS[self.kind].sign * self.strength), np.float32
        )

    def coat(self, field: Field) -> F32:
        """The share of light that is left at full strength, float32 (h, w)."""
        if SCARS[self.kind].sign:
            return np.ones(field.shape, np.float32)
        return np.asarray(1 - np.float32(self.strength) * self._pattern(field), np.float32)

    def _pattern(self, field: Field) -> F32:
        """Return the scar's shape from 0 to 1, float32 (h, w)."""
        x, y = grids(field)
        dx, dy = x - np.float32(self.at_mm[0]), y - np.float32(self.at_mm[1])
        cos, sin = np.float32(math.cos(self.turn_rad)), np.float32(math.sin(self.turn_rad))
        return SCARS[self.kind].pattern(cos * dx + sin * dy, cos * dy - sin * dx, self)


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
    "scratch": ScarKind(_scratch, -1.0, (1.0, 5.0), (0.012, 0.06)),
    "dent": ScarKind(_dent, -1.0, (0.3, 0.9), (0.02, 0.1)),
    "hair": ScarKind(_hair, 1.0, (2.0, 7.0), (0.02, 0.06)),
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


U8 = NDArray[np.uint8]

# Seconds of free gel before a press: what the press before has left behind is then at its lowest.
_FREE_S: Final = 3.0
# Frames that are averaged to a picture of the free gel.
_FREE_FRAMES: Final = 6
_RANDOM_PART_DEPTH_MM: Final = 0.4


@dataclass(frozen=True)
class Placing:
    """A part and how it is put under the gel. position None: a random part."""

    name: str
    part: str
    position: str | None
    jitter: Jitter
    is_registered: bool = False
    """Presses are brought to one pose."""

    @property
    def depth_mm(self) -> float:
        """The depth to which it is pressed."""
        return PARTS[self.part].depth_mm if self.position else _RANDOM_PART_DEPTH_MM

    def shape(self) -> HeightField:
        """The sound part."""
        if self.position is None:
            return random_part(np.random.default_rng(int(self.part.removeprefix("random"))))
        return PARTS[self.part].positions[self.position]


_EXACT, _FIXTURE = Jitter(0.02, 0.1, 0.1, 0.03), PARTS["PZ1"].jitter
_BY_HAND, _ANYWHERE = PARTS["PZ4"].jitter, Jitter(1.2, 8.0, 0.4, 0.06)

PLACINGS: Final[Mapping[str, Placing]] = {
    one.name: one
    for one in (
        Placing("thread in a fixture", "PZ1", "pos1", _FIXTURE),
        Placing("grooves in an exact fixture", "PZ3", "pos1", _EXACT),
        Placing("random part in a fixture", "random11", None, _FIXTURE),
        Placing("bracket by hand", "PZ4", "pos1", _BY_HAND),
        Placing("connector anywhere", "PZ2", "pos1", _ANYWHERE, is_registered=True),
        Placing("pinion anywhere", "PZ5", "pos1", _ANYWHERE, is_registered=True),
    )
}
"""Where parts lie: always at one place, the hard case, by hand, and anywhere."""


class Line:
    """One placing on one gel. seed: of pieces and marks."""

    def __init__(self, placing: Placing, seed: int) -> None:
        self.placing, self.seed, self.streams, self.shape = placing, seed, Streams(seed), placing.shape()
        effects = (*DEFAULT_EFFECTS, "residual_imprint")
        self._renderer = Renderer(LR, effects, jitter=placing.jitter, streams=self.streams)

    def imprint(self, piece: int, defect: Defect | None = None) -> F32:
        """The gel over one piece, mm, float32 (240, 320)."""
        shape = specimen(self.shape, self.streams("specimen", piece))
        placed = self._renderer.place(Pose(), (piece,))
        height = sample(shape if defect is None else Damaged(shape, defect), placed, LR)
        return self._renderer.imprint(height, self.placing.depth_mm * placed.depth_factor)

    def press(self, imprint: F32, piece: int, age: int, scars: tuple[tuple[Scar, float], ...] = ()) -> U8:
        """The picture of a press, uint8 (240, 320, 3). age: presses of the gel. scars: each with its share."""
        light = self._light(self._renderer.surface(imprint, age), age, scars)
        return self._renderer.expose(light, (piece,), Exposure(0, age * PRESS_CYCLE_S))

    def free_gel(
        self, age: int, scars: tuple[tuple[Scar, float], ...] = (), before: F32 | None = None
    ) -> View:
        """The free gel as the station sees it, float32 (120, 160, 3). before: the imprint of the last press."""
        flat = np.zeros(LR.shape, np.float32)
        left = None if before is None else (before, _FREE_S)
        light = self._light(self._renderer.surface(flat, age, left), age, scars)
        frames = [
            self._renderer.expose(light, ("free", age), Exposure(k, age * PRESS_CYCLE_S))
            for k in range(_FREE_FRAMES)
        ]
        return np.asarray(np.mean([as_view(one) for one in frames], axis=0), np.float32)

    def free_picture(self, number: int) -> U8:
        """Photograph the new gel: one frame, uint8 (240, 320, 3)."""
        return self._renderer.free_gel(("new", number))

    def _light(self, surface: F32, age: int, scars: tuple[tuple[Scar, float], ...]) -> F32:
        coat = np.ones(LR.shape, np.float32)
        for scar, share in scars:
            surface = surface + np.float32(share) * scar.relief(LR)
            coat *= 1 - np.float32(share) * (1 - scar.coat(LR))
        return np.asarray(self._renderer.light(np.asarray(surface, np.float32), age) * coat, np.float32)


def as_view(rgb: U8) -> View:
    """A picture as contact detection sees it, float32 (120, 160, 3)."""
    return np.asarray(cv2.resize(rgb.astype(np.float32), VIEW_SIZE, interpolation=cv2.INTER_AREA), np.float32)
