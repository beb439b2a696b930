"""Real frames that the ideas of `idea_ablation` are learnt from: of sensors that neither set of real touch has.

Each is published under the MIT licence. They are read from the folder of real tactile frames and never stored.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.pictures import read_picture
from calibration.benchmark.trial import PROFILE
from edge.core.errors import DatasetError

__all__ = ["FREE_GELS", "PRESSES", "free_gels", "presses"]

F32 = NDArray[np.float32]

_THREADS = tuple(f"RavenLiang1005__UniCal/GelSight/000{k}.png" for k in range(3))

FREE_GELS = (
    ("rpl-cmu__normalflow/background.png",),
    ("feats-ai__feats/nocontact_train_sensor.png",),
    _THREADS,
)
"""Pictures of one free gel each; three presses of one gel show it where none of them lies."""

# Pictures differ by less away from their presses.
_AGREED_LEVELS, _SPREAD_PX, _SEAM_PX = 12.0, 15, 6.0

PRESSES = (
    *_THREADS,
    "feats-ai__feats/cuboid_10-2-284.png",
    *(f"RavenLiang1005__UniCal/9DTact/000{k}.png" for k in range(3)),
    *(f"gelsightinc__sdkdemo/FingerData/scan00{k}/image01.png" for k in (1, 2)),
)
"""Threads and a printed cuboid on two GelSight Minis; shapes and balls on two sensors of other kinds."""


def free_gels(data: Path) -> list[F32]:
    """Free gels (240, 320, 3) in grey levels. data: the folder of real tactile frames. Errors: DatasetError."""
    return [_between([_read(data / name) for name in names]) for names in FREE_GELS]


def _between(pictures: list[F32]) -> F32:
    """The gel that no press of these hides: their median where they agree, else a smooth light without grain."""
    median = np.median(pictures, axis=0).astype(np.float32)
    apart = cv2.blur(np.ptp(pictures, axis=0).max(axis=2), (_SPREAD_PX, _SPREAD_PX))
    agreed = (apart < _AGREED_LEVELS).astype(np.float32)
    if agreed.all():
        return median
    share = (agreed * cv2.GaussianBlur(agreed, (0, 0), _SEAM_PX))[:, :, None]
    return np.asarray(share * median + (1 - share) * _smooth(median, agreed > 0), np.float32)


def _smooth(rgb: F32, known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The light of a gel as a polynomial of the place, of degree 4, through what is known of it."""
    v, u = np.meshgrid(*(np.linspace(-1, 1, size) for size in rgb.shape[:2]), indexing="ij")
    terms = np.stack([u**i * v**j for i in range(5) for j in range(5 - i)], axis=-1)
    found = np.linalg.lstsq(terms[known], np.log(rgb[known] + 1), rcond=None)[0]
    return np.asarray(np.exp(terms @ found) - 1)


def presses(data: Path) -> list[F32]:
    """Presses (240, 320, 3) in grey levels. data: the folder of real tactile frames. Errors: DatasetError."""
    return [_read(data / name) for name in PRESSES]


def _read(path: Path) -> F32:
    """At the scale of 320x240. Errors: DatasetError."""
    if not path.is_file():
        raise DatasetError(f"'{path}' is not there; fetch the real tactile frames again")
    return cv2.resize(read_picture(path), PROFILE.size, interpolation=cv2.INTER_AREA).astype(np.float32)
