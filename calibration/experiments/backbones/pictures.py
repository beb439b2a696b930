"""Real pictures as they are cut for trials: squares around contacts, without dirt of the free gel.

The folders are not part of the product; their pictures are only for evaluation, and nothing that ships is trained on
them.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.experiments.backbones.trial import PROFILE
from calibration.fitting.presses.nominal_presses import MAX_NO_CONTACT, NominalPresses
from edge.core.contact.mask import Touch
from edge.core.errors import DatasetError
from edge.core.imaging.region import Region

__all__ = ["contact_square", "read_picture", "specks", "together"]

U8 = NDArray[np.uint8]

# Side of a cut around a contact: 6.1 mm, larger than the contact of the balls.
_SIDE_PX = 96
# Sum over the channels. Dirt on one of the two gels has 71, the grain of both at most 13 (measured).
_SPECK_LEVELS = 30


def specks(background: U8) -> NDArray[np.bool_]:
    """Find where the free gel differs from its surroundings of half a millimetre."""
    near, around = (cv2.GaussianBlur(background.astype(np.float32), (0, 0), sigma) for sigma in (1, 5))
    return np.asarray(np.abs(near - around).sum(axis=2) > _SPECK_LEVELS)


def together(presses: Sequence[NominalPresses]) -> NominalPresses:
    """Presses of one position, each cut at a different place, with the free gel there."""
    touched = [press.touched for press in presses if press.touched is not None]
    free = [press.no_contact for press in presses if press.no_contact is not None]
    return NominalPresses(
        np.concatenate([press.frames for press in presses]),
        tuple(name for press in presses for name in press.names),
        touched=np.logical_or.reduce(touched),
        no_contact=np.concatenate(free)[:MAX_NO_CONTACT],
    )


def contact_square(touch: Touch) -> Region | None:
    """The square around the centre of the touched area, None where it would leave the picture."""
    width, height = PROFILE.size
    x, y = round(touch.x * width) - _SIDE_PX // 2, round(touch.y * height) - _SIDE_PX // 2
    is_inside = 0 <= x <= width - _SIDE_PX and 0 <= y <= height - _SIDE_PX
    return Region(x, y, _SIDE_PX, _SIDE_PX) if is_inside else None


def read_picture(path: Path) -> U8:
    """A picture as uint8 (h, w, 3) RGB. Errors: DatasetError."""
    bgr = cv2.imread(str(path))
    if bgr is None:
        raise DatasetError(f"'{path}' is not a picture; fetch the real frames again")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
