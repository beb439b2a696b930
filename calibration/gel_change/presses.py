"""Presses of one simulated part on two gels of one sensor."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.nominal_presses import NominalPresses, named_presses
from calibration.gel_change.gels import another_gel, another_unit
from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.plan import PRESS_CYCLE_S, place_damage
from calibration.simulator.pose import HeightField, Pose, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import MASK_DEPTH_MM, Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance
from calibration.simulator.streams import make_streams
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

__all__ = ["PROFILE", "REGION", "GelChange", "GelPresses", "Scored", "gel_change"]

U8 = NDArray[np.uint8]

PROFILE: Final = profile("cropped_lr")
REGION: Final = Region.centre(PROFILE.size)
# As the random parts of the benchmark.
_DEPTH_MM: Final = 0.4
_FREE_FRAMES: Final = 6
NOMINAL: Final = 24
# What a change of the gel may cost at most.
FEW: Final = 8
_TESTED: Final = 20
# Presses that each gel has had, in all its pictures: wear is not what is measured.
_AGE: Final = 20
# The lamps are warm.
_POWERED_S: Final = 3600.0


@dataclass(frozen=True, eq=False)
class Scored:
    """Regions of presses, uint8 (n, h, w, 3), and where damage shows, bool (n, h, w); all False on a sound piece."""

    frames: U8
    masks: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class GelChange:
    """One part on two gels. old, again: as many presses on each; few: the first of the new gel's. sound_before: presses
    of other sound pieces on the old gel; scored: sound and damaged ones on the new gel."""

    name: str
    old: NominalPresses
    again: NominalPresses
    few: NominalPresses
    sound_before: U8
    scored: Scored


class GelPresses:
    """One part on one gel."""

    def __init__(
        self, shape: HeightField, number: int, seed: int, sensor: SensorAppearance, gel: str
    ) -> None:
        self.shape, self.streams, self.gel = shape, make_streams(seed), gel
        # Odd and even parts alternate between a hand and a fixture, as those of the benchmark.
        jitter = PARTS["PZ3" if number % 2 else "PZ5"].jitter
        self.renderer = Renderer(LR, DEFAULT_EFFECTS, sensor, jitter, self.streams, gel, f"session of {gel}")

    def nominal(self, pieces: range) -> NominalPresses:
        """One press of each sound piece, and the free gel before them."""
        free = [self._free(k) for k in range(_FREE_FRAMES)]
        pictures = {f"s{piece:05d}_p0": self.sound(piece) for piece in pieces}
        return named_presses(pictures, PROFILE, REGION, no_contact=free)

    def sound(self, piece: int) -> U8:
        """A picture, uint8 (240, 320, 3)."""
        placed = self.renderer.place(Pose(), (piece,))
        whole = specimen(self.shape, self.streams("specimen", piece))
        imprint = self.renderer.imprint(sample(whole, placed, LR), _DEPTH_MM * placed.depth_factor)
        return self._picture(imprint, piece)

    def damaged(self, piece: int, kind: str, severity: float) -> tuple[U8, NDArray[np.bool_]]:
        """A picture and where the damage shows, bool (240, 320)."""
        placed = self.renderer.place(Pose(), (piece,))
        whole = specimen(self.shape, self.streams("specimen", piece))
        rng = self.streams("defect", piece)
        defect = place_damage(self.shape, kind, severity, _DEPTH_MM, MASK_DEPTH_MM, rng)
        sound, damaged = self.renderer.imprints(whole, defect, _DEPTH_MM, placed)
        return self._picture(damaged, piece), self.renderer.mask(sound, damaged)

    def _free(self, number: int) -> U8:
        return self.renderer.free_gel(("free", number), _AGE, Exposure(number, _POWERED_S))

    def _picture(self, imprint: NDArray[np.float32], piece: int) -> U8:
        light = self.renderer.light(self.renderer.surface(imprint, _AGE), _AGE)
        return self.renderer.expose(light, (piece,), Exposure(0, _POWERED_S + piece * PRESS_CYCLE_S))


def gel_change(seed: int, number: int, *, is_other_unit: bool = False) -> GelChange:
    """The random part of this number. is_other_unit: the hard limit, another unit instead of another gel."""
    rng = np.random.default_rng([seed, number])
    shape = random_part(np.random.default_rng([seed, number, 1]))
    before = another_gel(SENSORS["unit_a" if is_other_unit else "unit_b"], rng)
    after = another_unit("unit_b") if is_other_unit else another_gel(SENSORS["unit_b"], rng)
    with reproducible_opencv():
        old = GelPresses(shape, number, seed, before, f"old {number}")
        new = GelPresses(shape, number, seed, after, f"new {number}")
        again = new.nominal(range(1000, 1000 + NOMINAL))
        return GelChange(
            f"part {number}",
            old.nominal(range(NOMINAL)),
            again,
            _first(again, FEW),
            np.stack([REGION.crop(old.sound(2000 + k)) for k in range(_TESTED)]),
            _scored(new, number),
        )


def _first(presses: NominalPresses, count: int) -> NominalPresses:
    return replace(
        presses,
        frames=presses.frames[:count],
        names=presses.names[:count],
        specimens=presses.specimens[:count],
        touches=presses.touches[:count],
        reliefs=presses.reliefs[:count],
    )


def _scored(gel: GelPresses, number: int) -> Scored:
    """Sound and damaged pieces in turn."""
    kinds, frames, masks = tuple(DEFECTS), [], []
    rng = gel.streams("severities", number)
    for k in range(_TESTED):
        frames.append(gel.sound(3000 + k))
        masks.append(np.zeros(LR.shape, np.bool_))
        rgb, mask = gel.damaged(4000 + k, kinds[k % len(kinds)], float(rng.uniform(0.3, 1.0)))
        frames.append(rgb)
        masks.append(mask)
    return Scored(np.stack([REGION.crop(f) for f in frames]), np.stack([REGION.crop(m) for m in masks]))
