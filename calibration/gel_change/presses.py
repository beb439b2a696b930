"""Gels of one sensor: what a new pad changes, and what it leaves as it is.

The lamps and the camera stay, so a gel is a variation of the sensor's appearance: its tint, the strength of its coat
and its stiffness. Its grain, dust and scratches are its own and come from the renderer's `gel_id`.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.nominal_presses import NominalPresses, named_presses
from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.gel import Gel
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

__all__ = [
    "PROFILE",
    "REGION",
    "GelChange",
    "GelPresses",
    "Scored",
    "another_gel",
    "another_unit",
    "gel_change",
]

# Between public frames of three units the free gel differs in colour and in how the colour runs over the gel. Part of
# that is the lamps', which stay: a gel takes up to half of the difference to another unit (assumed).
_MOST_OF_A_UNIT: Final = 0.5
# The tint of a coat alone: sd of the logarithm of each colour's level (assumed; between units it is .03 to .13).
_TINT_SD: Final = 0.04
# How strongly a coat answers a slope: sd of the logarithm, common and of each colour (assumed). Two units differ up to
# 1.7 times, lamps included; two sd of this are 1.35 times.
_COAT_SD, _COAT_COLOUR_SD = 0.15, 0.05
_MOST_COAT: Final = 0.3
# The silicone is 4.25 +- 0.20 mm thick (the maker's datasheet), 5 %; its hardness varies as much again (assumed).
_STIFFNESS_SD: Final = 0.1
# The strongest answer of one unit in terms of another's, on public frames.
_UNIT_RESPONSE: Final = 1.7


def another_gel(sensor: SensorAppearance, rng: np.random.Generator) -> SensorAppearance:
    """The sensor with another pad of its kind."""
    other = SENSORS[str(rng.choice([name for name in sorted(SENSORS) if name != sensor.name]))]
    share, tint = float(rng.uniform(0, _MOST_OF_A_UNIT)), rng.normal(0, _TINT_SD, 3)
    free_gel = (1 - share) * sensor.free_gel + share * other.free_gel
    free_gel[:, 0] += tint
    coat = float(np.clip(rng.normal(0, _COAT_SD), -_MOST_COAT, _MOST_COAT))
    strength = np.exp(coat + rng.normal(0, _COAT_COLOUR_SD, 3))
    stiffness = np.exp(rng.normal(0, _STIFFNESS_SD, 2))
    return replace(
        sensor,
        free_gel=free_gel,
        slope_response=sensor.slope_response * strength[:, None],
        gel=_softened(sensor.gel, stiffness),
    )


def another_unit(name: str) -> SensorAppearance:
    """The hard limit: a unit with other lamps and the strongest other response that was seen."""
    unit = SENSORS[name]
    return replace(unit, slope_response=unit.slope_response * _UNIT_RESPONSE)


def _softened(gel: Gel, by: np.typing.NDArray[np.float64]) -> Gel:
    short_mm = gel.short_mm * float(by[0])
    return replace(gel, short_mm=short_mm, long_mm=max(short_mm, gel.long_mm * float(by[1])))


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
