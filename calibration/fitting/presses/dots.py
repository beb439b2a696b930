"""The dots of a marker gel, taken out of nominal presses as the gateway takes them out of each press.

They are looked for on the free gel, and where it is not known in the presses.
"""

from dataclasses import replace

import numpy as np

from calibration.fitting.presses.free_gel import find_common_dots
from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from calibration.fitting.presses.strangers import list_names
from edge.core.imaging.marker_dots import MarkerDots, find_marker_dots, shows_marker_dots

__all__ = ["fill_dots", "take_out_dots"]


def take_out_dots(presses: NominalPresses, pixels_per_mm: float) -> NominalPresses:
    """Find the dots of a marker gel and fill them in presses and free gel.

    The same presses where there are none. Faults name the presses of another gel: without the dots that the others
    have, or with dots.
    """
    dots = _find(presses, pixels_per_mm)
    mixed = _find_mixed(presses, pixels_per_mm, dots is not None)
    if mixed:
        presses = replace(presses, faults=(*presses.faults, *mixed))
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
