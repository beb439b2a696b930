"""JPEG at the picture's own size, as simulated datasets and some recorders store it: it hides fine damage.

A sensor's frames are compressed at 3280x2464 and decoded to a quarter, which hides nothing at 320x240. So only a
picture that shows the blocks of compression is compressed again after damage was added.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.simulator.camera import NOISE_SD, jpeg
from calibration.simulator.field_of_view import F32
from edge.core.imaging.region import Region

__all__ = ["compress", "is_compressed", "undo_compression"]

U8 = NDArray[np.uint8]

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
