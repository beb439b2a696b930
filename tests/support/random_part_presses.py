"""Sound presses of random simulated parts in any number, for measurements of how often they alarm."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.simulator.defects import DEFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.plan import PRESS_CYCLE_S, place_damage
from calibration.simulator.pose import FIXTURE, Jitter, Pose, pose_jitter, sample
from calibration.simulator.random_parts import RandomPart, random_part
from calibration.simulator.renderer import MASK_DEPTH_MM, Exposure, Renderer
from calibration.simulator.scene import paper_scenes
from calibration.simulator.sensor_appearance import SENSORS
from calibration.simulator.streams import Streams
from edge.core.arrays import F32

# As most of the analogues are pressed.
DEPTH_MM = 0.4


@dataclass(frozen=True)
class RandomPartPresses:
    """One random part on one gel. A piece is clamped once, by hand, and then pressed by a robot: its presses are
    alike. shapes, number: which part. presses: how many the gel has in all; each of them falls at a moment of its own,
    drawn at random, so that wear and drift tell nothing about which presses were learnt."""

    shapes: int
    number: int
    presses: int

    def press(self, piece: int, repeat: int, order: int) -> NDArray[np.uint8]:
        """One press of a sound piece, uint8 (240, 320, 3) RGB. order: which press of all it is."""
        shape = specimen(self._shape, self._streams("specimen", piece))
        clamped = pose_jitter(Pose(), self._clamping, self._streams("clamp", piece))
        placed = self._gel.place(clamped, (piece, repeat))
        imprint = self._gel.imprint(sample(shape, placed, LR), DEPTH_MM * placed.depth_factor)
        moment = int(self._moments[order])
        return self._exposed(imprint, moment, (piece, repeat))

    def damaged(self, piece: int, order: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """One press of a damaged piece: uint8 (240, 320, 3) RGB, and where it differs from the sound one, (240, 320).
        The kinds of damage take turns; its severity is 0.3 to 1."""
        kinds, severity = tuple(DEFECTS), float(self._streams("severity", piece).uniform(0.3, 1.0))
        shape = specimen(self._shape, self._streams("specimen", piece))
        placed = self._gel.place(
            pose_jitter(Pose(), self._clamping, self._streams("clamp", piece)), (piece, 1)
        )
        defect = place_damage(
            self._shape,
            kinds[piece % len(kinds)],
            severity,
            DEPTH_MM,
            MASK_DEPTH_MM,
            self._streams("defect", piece),
        )
        sound, imprint = self._gel.imprints(shape, defect, DEPTH_MM, placed)
        rgb = self._exposed(imprint, int(self._moments[order]), (piece, 1))
        return rgb, self._gel.mask(sound, imprint, MASK_DEPTH_MM)

    def _exposed(self, imprint: F32, moment: int, key: tuple[int, int]) -> NDArray[np.uint8]:
        light = self._gel.light(self._gel.surface(imprint, moment), moment)
        return self._gel.expose(light, key, Exposure(0, moment * PRESS_CYCLE_S))

    def free_gel(self, number: int) -> NDArray[np.uint8]:
        """The untouched gel, uint8 (240, 320, 3) RGB."""
        return self._gel.free_gel(("free", number))

    @cached_property
    def _shape(self) -> RandomPart:
        return random_part(np.random.default_rng([self.shapes, self.number]))

    @cached_property
    def _streams(self) -> Streams:
        return Streams(1000 * self.shapes + self.number)

    @cached_property
    def _moments(self) -> NDArray[np.int64]:
        return np.random.default_rng([self.shapes, self.number, 1]).permutation(self.presses)

    @property
    def _clamping(self) -> Jitter:
        """Every other part is clamped loosely, as the analogues PZ3 and PZ5 are."""
        return PARTS["PZ3" if self.number % 2 else "PZ5"].jitter

    @cached_property
    def _gel(self) -> Renderer:
        effects = next(scene for scene in paper_scenes() if scene.part == "PZ3").effects
        return Renderer(LR, effects, SENSORS["unit_b"], FIXTURE, self._streams, "gel1", "pos1")
