"""Nominal presses prepared as a gateway prepares each press: marker dots filled, and smoothed against noise."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.dots import fill_dots, take_out_dots
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.detector import Mode
from edge.core.imaging.smoothing import smooth
from edge.model.bundle import Bundle

__all__ = ["prepare_as", "prepare_presses", "smooth_presses"]


def prepare_presses(
    presses: NominalPresses, pixels_per_mm: float, mode: Mode = "corrected"
) -> NominalPresses:
    """Prepare presses for a fit; the same ones in the mode `paper`: the published methods learn them as they are."""
    return presses if mode == "paper" else smooth_presses(take_out_dots(presses, pixels_per_mm))


def prepare_as(bundle: Bundle, presses: NominalPresses) -> NominalPresses:
    """Prepare presses as those that a bundle has learnt."""
    dots = bundle.manifest.dots
    filled = presses if dots is None else fill_dots(presses, dots.opened)
    return smooth_presses(filled) if bundle.manifest.is_smoothed else filled


def smooth_presses(presses: NominalPresses) -> NominalPresses:
    """Smooth presses and the free gel. Damage is rendered into the pictures of before, and smoothed with them."""
    free = presses.no_contact
    return replace(
        presses,
        frames=_smooth_each(presses.frames),
        raw=presses.frames,
        no_contact=None if free is None else _smooth_each(free),
    )


def _smooth_each(frames: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.stack([smooth(rgb) for rgb in frames]) if len(frames) else frames
