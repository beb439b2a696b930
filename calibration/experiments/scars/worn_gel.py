"""Placings of parts on a worn gel: how a part lies, the pictures of its presses, and of the free gel between them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.simulator.defects import Damaged, Defect
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import F32, LR
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.plan import PRESS_CYCLE_S
from calibration.simulator.pose import HeightField, Jitter, Pose, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.scars import Scar, mark_gel
from calibration.simulator.streams import Streams
from edge.core.contact.reference import View
from edge.core.imaging.decode import VIEW_SIZE

__all__ = ["PLACINGS", "Line", "Placing", "as_view"]

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
        marked, coat = mark_gel(surface, scars, LR)
        return np.asarray(self._renderer.light(marked, age) * coat, np.float32)


def as_view(rgb: U8) -> View:
    """A picture as contact detection sees it, float32 (120, 160, 3)."""
    return np.asarray(cv2.resize(rgb.astype(np.float32), VIEW_SIZE, interpolation=cv2.INTER_AREA), np.float32)
