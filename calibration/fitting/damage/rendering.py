"""A real press with damage that was not there: the change of the picture is rendered, everything else stays real.

JPEG at the picture's own size, as simulated datasets and some recorders store it, hides fine damage. A sensor's frames
are compressed at 3280x2464 and decoded to a quarter, which hides nothing at 320x240. So only a picture that shows the
blocks of compression is compressed again after damage was added.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from calibration.fitting.damage.damage import Damage
from calibration.fitting.damage.imprint import Station
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.simulator import gel
from calibration.simulator.camera import NOISE_SD, jpeg
from calibration.simulator.field_of_view import grids
from calibration.simulator.renderer import MASK_DEPTH_MM
from edge.core.arrays import F32, U8, Mask
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.imaging.smoothing import smooth

__all__ = ["EditedPress", "compress", "edit_touching", "is_compressed"]

# Compression with halved colour has blocks of 16 pixels; the picture continues beyond the region at least this far.
_BLOCK = 16
# Compressing again at the same place of the blocks changes compressed pictures by 0.2 to 0.7 of what it changes at
# other places, and uncompressed ones (real presses and simulated ones) by 0.95 to 1.1.
_REPEATED = 0.8


def is_compressed(rgb: U8, region: Region) -> bool:
    """Tell whether a region of a picture, uint8 (h, w, 3), shows the blocks of JPEG at the picture's size."""
    again, apart = (_change(rgb, compress(rgb, region, shift)) for shift in (0, 4))
    return again < _REPEATED * apart


def compress(rgb: U8, region: Region, shift: int = 0) -> U8:
    """The region as it comes back from JPEG of the picture. shift: pixels by which the blocks are displaced."""
    top, left = region.y % _BLOCK + shift, region.x % _BLOCK + shift
    picture = cv2.copyMakeBorder(rgb, top, _BLOCK, left, _BLOCK, cv2.BORDER_REPLICATE)
    back = jpeg(np.ascontiguousarray(picture, np.uint8))
    return np.ascontiguousarray(back[top : top + rgb.shape[0], left : left + rgb.shape[1]])


def undo_compression(rgb: U8, region: Region) -> F32:
    """A picture that gives this one when it is compressed, float32 (h, w, 3): with the noise that compression took.

    Without that noise a change of less than half a step of the compression would vanish, and with it faint damage; in
    a camera the noise carries it into the picture. What compression takes of a picture with as much noise again has
    that size, and stays within the steps.
    """
    noise = np.random.default_rng(0).normal(0, NOISE_SD, rgb.shape)
    noisy = np.clip(np.rint(rgb + noise), 0, 255).astype(np.uint8)
    taken = noisy.astype(np.float32) - compress(noisy, region)
    return np.asarray(rgb + taken, np.float32)


def _change(rgb: U8, back: U8) -> float:
    """Rms in levels away from the border, whose blocks continue into unknown pixels."""
    inner = (
        (slice(_BLOCK, -_BLOCK), slice(_BLOCK, -_BLOCK))
        if min(rgb.shape[:2]) > 3 * _BLOCK
        else (slice(None),)
    )
    return float(np.sqrt(np.square(back[inner].astype(np.float64) - rgb[inner]).mean()))


# A point is in contact where it is pushed by more than this share of the imprint's height: on simulated parts nine in
# ten such points touch, and four in five of those that touch are such points.
_PUSHED_SHARE = 0.25
_HIGHEST_PERCENT = 98.0


@dataclass(frozen=True, eq=False)
class EditedPress:
    """One press into which damage is rendered."""

    station: Station
    rgb: U8
    """The press, uint8 (h, w, 3) of the station's region."""
    is_smoothed: bool = False
    """Whether it is shown smoothed: only after damage was rendered into it."""

    def show(self, rgb: U8) -> U8:
        """Show a picture of it as presses are learnt."""
        return smooth(rgb) if self.is_smoothed else rgb

    @cached_property
    def surface(self) -> F32:
        """The gel's surface, mm, float32 (h, w)."""
        return self.station.surface(self.rgb)

    @cached_property
    def contact(self) -> Mask:
        """The places where the part touches the gel, bool (h, w): damage shows nowhere else. None for noise alone."""
        height = float(np.percentile(self.surface, _HIGHEST_PERCENT))
        if height < MASK_DEPTH_MM:
            return np.zeros(self.surface.shape, np.bool_)
        return np.asarray(self.station.pressure(self.surface) > _PUSHED_SHARE * height)

    def render(self, damage: Damage) -> U8:
        """The press with the damage, uint8 (h, w, 3).

        The part's height is known where it touches; there the damage is added, and the gel is pressed on it again. The
        picture changes by the difference between the light on the two surfaces, so noise, grain, dust and marks stay.
        Where the picture was compressed, it is compressed again.
        """
        return self.with_relief(damage.relief(*grids(self.station.field)))

    def with_relief(self, relief_mm: F32) -> U8:
        """The press of an object with this much more height where it touches, mm, float32 (h, w)."""
        return self._show(self.surface + self._press_on(relief_mm) - self._sound)

    def smooth(self, sigma_mm: float) -> U8:
        """The press of an object that is smoother by this much, uint8 (h, w, 3): relief finer than that is missing.

        The standard deviation of a Gaussian window over the gel's surface. The picture changes as in `damaged`.
        """
        across, down = (sigma_mm / m for m in self.station.field.mm_per_px)
        return self._show(np.asarray(cv2.GaussianBlur(self.surface, (0, 0), across, sigmaY=down), np.float32))

    def _show(self, surface: F32) -> U8:
        """The press with this surface instead of its own."""
        rgb = np.clip(np.rint(self._seen + self.station.light(surface) - self._lit), 0, 255).astype(np.uint8)
        return self.show(rgb if self._seen is self.rgb else compress(rgb, self.station.region))

    @cached_property
    def _seen(self) -> U8 | F32:
        """The press before its compression, as far as that can be known; itself where it was not compressed."""
        region = self.station.region
        return undo_compression(self.rgb, region) if is_compressed(self.rgb, region) else self.rgb

    def _press_on(self, relief_mm: F32) -> F32:
        part = self._part + np.where(self.contact, relief_mm, np.float32(0))
        return gel.deformation(np.asarray(np.maximum(part, 0), np.float32), self.station.field)

    @cached_property
    def _part(self) -> F32:
        return np.where(self.contact, self.surface, np.float32(0))

    @cached_property
    def _sound(self) -> F32:
        return gel.deformation(self._part, self.station.field)

    @cached_property
    def _lit(self) -> F32:
        return self.station.light(self.surface)


def edit_touching(
    presses: NominalPresses, profile: SensorProfile, region: Region, rng: np.random.Generator, most: int
) -> dict[int, EditedPress]:
    """Prepare at most so many presses in a random order, by their number, those without contact left out.

    None of them without a picture of the free gel.
    """
    if presses.no_contact is None:
        return {}
    free = np.asarray(presses.no_contact.mean(axis=0, dtype=np.float64), np.float32)
    station = Station(profile, region, free)
    order = rng.permutation(len(presses)).tolist()
    is_smoothed, frames = presses.raw is not None, presses.frames if presses.raw is None else presses.raw
    edits = {k: EditedPress(station, frames[k], is_smoothed) for k in order[:most]}
    return {k: edit for k, edit in edits.items() if edit.contact.any()}
