"""Nominal presses prepared as a gateway prepares each press: marker dots filled, and smoothed against noise.

The dots of a marker gel are looked for on the free gel, and where it is not known in the presses.
"""

from dataclasses import replace

import numpy as np

from calibration.fitting.presses.free_gel import find_common_dots
from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from calibration.fitting.presses.strangers import list_names
from edge.core.arrays import U8
from edge.core.detector import Mode
from edge.core.imaging.marker_dots import MarkerDots, find_marker_dots, shows_marker_dots
from edge.core.imaging.smoothing import smooth
from edge.model.bundle import Bundle

__all__ = ["prepare_as", "prepare_presses", "smooth_presses", "take_out_dots"]


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


def _smooth_each(frames: U8) -> U8:
    return np.stack([smooth(rgb) for rgb in frames]) if len(frames) else frames


def take_out_dots(presses: NominalPresses, pixels_per_mm: float) -> NominalPresses:
    """Find the dots of a marker gel and fill them in presses and free gel.

    The same presses where there are none. Faults name the presses of another gel: without the dots that the others
    have, or with dots.
    """
    dots = _find(presses, pixels_per_mm)
    mixed = _find_mixed(presses, pixels_per_mm, dots is not None)
    if mixed:
        presses = replace(presses, faults=(*mixed, *presses.faults))
    return presses if dots is None else fill_dots(presses, dots.learn(list(presses.frames)))


def fill_dots(presses: NominalPresses, dots: MarkerDots) -> NominalPresses:
    """Fill these dots in presses and free gel."""
    free = presses.no_contact
    return replace(
        presses,
        frames=np.stack([dots.fill(rgb) for rgb in presses.frames]),
        no_contact=None if free is None else np.stack([dots.fill(rgb) for rgb in free]),
        dots=dots,
    )


def _find(presses: NominalPresses, pixels_per_mm: float) -> MarkerDots | None:
    free = presses.no_contact
    if free is not None:
        mean = np.rint(free.mean(axis=0, dtype=np.float64)).astype(np.uint8)
        return find_marker_dots(mean, pixels_per_mm)
    return find_common_dots(list(presses.frames), pixels_per_mm) if len(presses) >= MIN_PRESSES else None


def _find_mixed(presses: NominalPresses, pixels_per_mm: float, has_dots: bool) -> list[str]:
    """Name the presses that show dots where the gel has none, or the reverse."""
    shows = np.array([shows_marker_dots(rgb, pixels_per_mm) for rgb in presses.frames])
    odd = [name for name, has in zip(presses.names, shows, strict=True) if has != has_dots]
    if not odd:
        return []
    if len(odd) == len(presses):
        shown = "no press shows the dots that the free gel has"
        if not has_dots:
            shown = "all presses show regular dark dots, or the part has them, and the free gel does not"
        return [f"{shown}: it is of another gel; give a picture of the gel of the presses"]
    learnt = "the gel that is learnt"
    if not has_dots and len(odd) > len(presses) / 2:
        # Dots of a gel that is not known are found only where each of a few presses shows them.
        odd = [name for name, has in zip(presses.names, shows, strict=True) if not has]
        has_dots, learnt = True, "the others"
    what = "no dots of a marker gel" if has_dots else "the dots of a marker gel"
    return [
        f"{what} in {list_names(odd, len(presses))}, unlike {learnt}: they are of another gel; leave them out "
        f"(--leave-out '{odd[0]}'), and fit them alone"
    ]
