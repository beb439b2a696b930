"""Defects as geometry: each changes a part's height, from nothing at severity 0 to failure at severity 1."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calibration.simulator import reproducible_math
from calibration.simulator.field_of_view import Field, grids
from calibration.simulator.pose import HeightField, Pose, sample
from calibration.simulator.shapes import f32, ramp, rotate
from edge.core.arrays import F32

__all__ = ["DEFECTS", "DENT_DEPTH_MM", "SCRATCH_DEPTH_MM", "Damaged", "Defect", "place_defect"]

# Depths at severity 1.
DENT_DEPTH_MM, SCRATCH_DEPTH_MM = 0.4, 0.16


@dataclass(frozen=True)
class Defect:
    """A defect on one piece."""

    kind: str
    severity: float
    """0 (invisible) to 1 (failure); depth and height grow in proportion, width with its square root."""
    at_mm: tuple[float, float]
    """Its centre in the part's plane."""
    turn_rad: float = 0.0
    """Its direction."""
    size: float = 1.0
    """1 is typical."""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kind not in DEFECTS:
            raise ValueError(f"a defect is one of {', '.join(DEFECTS)}, found '{self.kind}'")
        if not 0 <= self.severity <= 1:
            raise ValueError(f"severity is in [0, 1], found {self.severity}")
        if self.size <= 0:
            raise ValueError(f"the size of a defect is positive, found {self.size}")
        # A number of NumPy's would widen the arithmetic of heights to float64.
        for name in ("severity", "turn_rad", "size"):
            object.__setattr__(self, name, float(getattr(self, name)))
        object.__setattr__(self, "at_mm", (float(self.at_mm[0]), float(self.at_mm[1])))

    @property
    def width(self) -> float:
        """The factor on a typical width."""
        return self.size * (0.5 + 0.5 * math.sqrt(self.severity))


@dataclass(frozen=True)
class Damaged:
    """A part with a defect; it can be used as any other part."""

    part: HeightField
    defect: Defect

    def __call__(self, x_mm: F32, y_mm: F32) -> F32:
        height = self.part(x_mm, y_mm)
        if self.defect.severity == 0:
            return height
        along, across = rotate(
            x_mm - self.defect.at_mm[0],
            y_mm - self.defect.at_mm[1],
            self.defect.turn_rad,
        )
        return DEFECTS[self.defect.kind](self, height, along, across)

    def top(self, reach_mm: float) -> float:
        """The highest point of the sound part within reach of the defect's centre."""
        offset = np.linspace(-reach_mm, reach_mm, 15, dtype=np.float32)
        x, y = np.meshgrid(offset + self.defect.at_mm[0], offset + self.defect.at_mm[1])
        return float(self.part(x, y).max())


Change = Callable[[Damaged, F32, F32, F32], F32]
"""(the damaged part, its sound height, coordinates along and across the defect in mm) to the changed height."""


def _bell(distance: ArrayLike) -> F32:
    """1 at 0, 0 from 1 on, smooth."""
    return ramp(1 - f32(distance))


def _dent(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """A round hollow up to 0.4 mm deep with the displaced metal as a low rim: a knock by something blunt."""
    d = piece.defect
    r = np.sqrt(along * along + across * across) / (0.8 * d.width)
    rim = reproducible_math.exp(-(((r - 1.05) / 0.22) ** 2))
    return f32(height - DENT_DEPTH_MM * d.severity * _bell(r) + 0.05 * d.severity * rim)


def _burr(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """A ragged ridge up to 0.22 mm high along an edge, only where there was metal."""
    d = piece.defect
    rng = np.random.default_rng(d.seed)
    length, width = 1.1 * d.width, 0.16 * d.width
    ragged = 0.7 + 0.3 * reproducible_math.sin(
        along * np.float32(rng.uniform(6, 11)) + np.float32(rng.uniform(0, 6))
    )
    ridge = _bell(np.abs(along) / length) * _bell(np.abs(across) / width)
    near_top = ramp((height - np.float32(piece.top(1.0) - 0.6)) / 0.3)
    return f32(height + 0.22 * d.severity * ridge * ragged * near_top)


def _scratch(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """A furrow up to 0.16 mm deep and about 0.2 mm wide with raised lips."""
    d = piece.defect
    bend = 0.12 / d.size * along * along
    u = np.abs(across - bend) / (0.11 * d.width)
    along_it = ramp((1.8 * d.size - np.abs(along)) / 0.5)
    lips = reproducible_math.exp(-(((u - 1.5) / 0.45) ** 2))
    furrow = np.maximum(1 - u, 0)
    return f32(height + along_it * d.severity * (0.025 * lips - SCRATCH_DEPTH_MM * furrow))


def _flattened_crest(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """The highest relief is pressed down to a plane up to 0.4 mm lower, over 2 x 1.2 mm, with a little spread metal."""
    d = piece.defect
    top = np.float32(piece.top(0.9 * d.size))
    inside = ramp((1.25 - np.abs(along) / (1.1 * d.width)) * 3)
    inside = inside * ramp((1.25 - np.abs(across) / (0.65 * d.width)) * 3)
    plane = top - 0.4 * d.severity
    return f32(height - inside * np.maximum(height - plane, 0))


def _abrasion(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """A rubbed patch: up to 0.12 mm removed from the highest relief, and parallel grinding marks."""
    d = piece.defect
    rng = np.random.default_rng(d.seed)
    r = np.sqrt((along / 1.7) ** 2 + across**2) / (0.95 * d.width)
    patch = ramp((1 - r) * 2.5)
    marks = sum(
        reproducible_math.sin(across * k + p) for k, p in rng.uniform((18, 0), (45, 6.3), (3, 2)).tolist()
    )
    exposed = ramp((height - np.float32(piece.top(1.2) - 0.5)) / 0.4)
    taken = 0.12 + 0.02 * marks
    return f32(height - d.severity * patch * exposed * taken)


def _material_loss(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """A chip broken out along a slanted, uneven face, up to 0.8 mm deep."""
    d = piece.defect
    rng = np.random.default_rng(d.seed)
    angle = reproducible_math.arctan2(across, along)
    lobes = (
        1
        + 0.18 * reproducible_math.sin(3 * angle + np.float32(rng.uniform(0, 6)))
        + 0.1 * reproducible_math.sin(5 * angle + np.float32(rng.uniform(0, 6)))
    )
    r = np.sqrt(along * along + across * across) / (0.9 * d.width * lobes)
    face = (0.8 * d.severity) * ramp((1 - r) * 2) * (0.75 + 0.25 * reproducible_math.tanh(along))
    return f32(height - face)


def _thread_discontinuity(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """Relief torn away over 2.4 x 1.6 mm: crests fall and valleys fill towards their common mean."""
    d = piece.defect
    x0, y0 = d.at_mm[0], d.at_mm[1]
    back_x, back_y = rotate(along, across, -d.turn_rad)
    stencil = [0.75 * k / 3 for k in range(-3, 4)]
    mean = sum(piece.part(back_x + x0, back_y + y0 + s) for s in stencil) / 7
    inside = ramp((1.2 - np.abs(along) / (1.3 * d.width)) * 3)
    inside = inside * ramp((1.2 - np.abs(across) / (0.9 * d.width)) * 3)
    level = np.minimum(f32(mean), np.float32(piece.top(1.0)))
    return f32(height + d.severity * inside * (level - height))


def _impact_mark(piece: Damaged, height: F32, along: F32, across: F32) -> F32:
    """A notch up to 0.35 mm deep from a sharp edge: long, narrow, steep on one side, with a burr on the other."""
    d = piece.defect
    length = _bell(np.abs(along) / (1.2 * d.width))
    u = across / (0.38 * d.width)
    notch = np.maximum(1 - np.where(u > 0, 0.8 * u, -2.2 * u), 0)
    lip = reproducible_math.exp(-(((u + 0.75) / 0.3) ** 2))
    change = 0.08 * lip - 0.35 * notch
    return f32(height + d.severity * length * change)


DEFECTS: Mapping[str, Change] = {
    "dent": _dent,
    "burr": _burr,
    "scratch": _scratch,
    "flattened_crest": _flattened_crest,
    "abrasion": _abrasion,
    "material_loss": _material_loss,
    "thread_discontinuity": _thread_discontinuity,
    "impact_mark": _impact_mark,
}

# Half of the side of the 224 pixel region that is inspected, less the reach of a defect.
_INSPECTED_HALF_MM = 6.2

# Placing samples the part at this coarse spacing; a defect is wider.
_COARSE = Field((128, 128), (0.11, 0.11))


def place_defect(
    kind: str, severity: float, part: HeightField, depth_mm: float, rng: np.random.Generator
) -> Defect:
    """A defect of this kind where the nominal press has good contact, inside the inspected region.

    The spot is in the higher half of the touched area. Burrs, scratches and flattened crests follow the edge that runs
    there; other kinds have any direction. Errors: ValueError when nothing is touched.
    """
    height = sample(part, Pose(), _COARSE)
    x, y = grids(_COARSE)
    within = (np.abs(x) < _INSPECTED_HALF_MM) & (np.abs(y) < _INSPECTED_HALF_MM)
    touched = (height > -0.55 * depth_mm) & within
    if not touched.any():
        raise ValueError(f"a press of {depth_mm} mm touches nothing of the part inside the inspected region")
    pick = rng.integers(int(touched.sum()))
    row, column = np.argwhere(touched)[pick]
    at = (float(x[row, column]), float(y[row, column]))
    slope_y, slope_x = np.gradient(height, axis=0), np.gradient(height, axis=1)
    along_edge = math.atan2(float(slope_x[row, column]), -float(slope_y[row, column]))
    free = rng.uniform(0, math.pi)
    turn = along_edge if kind in ("burr", "flattened_crest", "abrasion", "thread_discontinuity") else free
    return Defect(kind, severity, at, float(turn), float(rng.uniform(0.8, 1.25)), int(rng.integers(2**31)))
