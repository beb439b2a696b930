"""Presses of random simulated parts that are damaged in their geometry and rendered completely."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from random_part_presses import DEPTH_MM, RandomPartPresses

from calibration.fitting.damage.damage import KINDS, Damage
from calibration.fitting.damage.imprint import Station
from calibration.simulator.defects import Damaged
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import specimen
from calibration.simulator.plan import PRESS_CYCLE_S
from calibration.simulator.pose import HeightField, Pose, pose_jitter, sample
from calibration.simulator.renderer import Exposure
from edge.core.arrays import F32


def with_damage(part: HeightField, damage: Damage, placed: Pose) -> HeightField:
    """The part with damage whose spot is in the millimetres of the picture, not of the part."""
    x, y = damage.spot.x_mm - placed.shift_mm[0], damage.spot.y_mm - placed.shift_mm[1]
    cos, sin = math.cos(placed.turn_rad), math.sin(placed.turn_rad)
    defect = damage.defect()
    moved = replace(
        defect, at_mm=(cos * x + sin * y, cos * y - sin * x), turn_rad=defect.turn_rad - placed.turn_rad
    )
    changed = Damaged(_flat, moved)
    return lambda u, v: np.asarray(part(u, v) + KINDS[damage.kind].sign * changed(u, v), np.float32)


def _flat(x_mm: F32, y_mm: F32) -> F32:
    return np.zeros_like(x_mm)


@dataclass(frozen=True)
class DamagedPartPresses(RandomPartPresses):
    """The same part and gel, also with damage. Spots are in mm from the middle of the picture."""

    def damaged_press(self, piece: int, repeat: int, order: int, damage: Damage) -> NDArray[np.uint8]:
        """The press of `press` with damage, uint8 (240, 320, 3) RGB."""
        clamped = pose_jitter(Pose(), self._clamping, self._streams("clamp", piece))
        placed = self._gel.place(clamped, (piece, repeat))
        part = with_damage(specimen(self._shape, self._streams("specimen", piece)), damage, placed)
        imprint = self._gel.imprint(sample(part, placed, LR), DEPTH_MM * placed.depth_factor)
        moment = int(self._moments[order])
        light = self._gel.light(self._gel.surface(imprint, moment), moment)
        return self._gel.expose(light, (piece, repeat), Exposure(0, moment * PRESS_CYCLE_S))


@dataclass(frozen=True)
class DamagedPress:
    """One press of a piece, which can be shown with damage, as `Judge` takes it."""

    station: Station
    presses: DamagedPartPresses
    piece: int
    order: int

    def render(self, damage: Damage) -> NDArray[np.uint8]:
        rgb = self.presses.damaged_press(self.piece, 0, self.order, damage)
        return np.ascontiguousarray(self.station.region.crop(rgb))
