"""How far apart presses lie: a method that compares place with place is not fitted to scattered ones."""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from edge import registry
from edge.core.contact.mask import Touch, touched, touched_mask
from edge.core.contact.reference import Reference
from edge.core.detector import Detector
from edge.core.errors import FitError
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.manifest_facts import UNPROVEN

__all__ = ["is_placed", "scatter_mm", "scatter_warnings"]

SCATTERED_MM = 3.0
"""Presses whose contacts scatter more have no common place. Measured: up to 1.8 mm on simulated parts placed by hand,
where their contacts are wide and shallow; 4.2 mm and more on balls pressed anywhere, where methods that compare places
find a fifth of the damage that inreach finds."""


VIEW_WIDTH = 160
"""Pixels, as in contact detection."""


def scatter_mm(presses: NominalPresses, profile: SensorProfile) -> float | None:
    """Measure how far half of the contacts lie from their common middle; None where no touch is known."""
    return _scatter_mm(presses.touches, profile.size, profile) if presses.touches else None


def is_placed(presses: NominalPresses, profile: SensorProfile) -> bool:
    """Tell whether the contacts are known to lie at one place."""
    scatter = scatter_mm(presses, profile)
    return scatter is not None and scatter <= SCATTERED_MM


def _scatter_mm(touches: Sequence[Touch], size: tuple[int, int], profile: SensorProfile) -> float:
    """size: (w, h) of what the touches are fractions of, in pixels of the picture."""
    middles = np.array([(touch.x, touch.y) for touch in touches]) * size / profile.pixels_per_mm
    return float(np.median(np.linalg.norm(middles - np.median(middles, axis=0), axis=1)))


def _scatter_without_free_gel(presses: NominalPresses, profile: SensorProfile) -> float:
    """Measure it without the free gel, from where each press differs from the median press.

    That is the free gel where parts lie apart, and the part where they lie at one place. Measured: 3.9 to 5.0 mm on
    real balls pressed anywhere, 0.4 to 0.9 on simulated parts in a fixture or held by hand.
    """
    h, w = presses.frames.shape[1:3]
    view = VIEW_WIDTH, max(1, round(VIEW_WIDTH * h / w))
    views = [cv2.resize(rgb, view, interpolation=cv2.INTER_AREA).astype(np.float32) for rgb in presses.frames]
    median = Reference(np.median(views, axis=0).astype(np.float32), len(views), 0)
    touches = [touched(touched_mask(median.difference(one))) for one in views]
    return _scatter_mm(touches, (w, h), profile)


def scatter_warnings(
    presses: NominalPresses,
    profile: SensorProfile,
    detector: Detector,
    is_scattered: bool = False,
    why_unregistered: str = "",
) -> list[str]:
    """Checks that a method that compares place with place is not fitted to scattered contacts.

    why_unregistered: said in the refusal. Errors: FitError where it is; a warning instead where `is_scattered` allows
    it.
    """
    if not detector.compares_places:
        return []
    scatter = scatter_mm(presses, profile)
    if scatter is None and presses.no_contact is None:
        return _unregistered_warnings(presses, profile, detector)
    if scatter is None or scatter <= SCATTERED_MM:
        return []
    methods = [registry.detector(name) for name in registry.names("detectors")]
    other = [one.name for one in methods if not (one.compares_places or one.is_baseline)]
    found = (
        f"half of the contacts lie more than {scatter:.1f} mm from their common middle: {detector.name} compares place "
        f"with place and will pass damage; hold the part at one place, or fit {' or '.join(other)}"
    )
    if not is_scattered:
        registered = f" ({why_unregistered}; see --register)" if why_unregistered else ""
        raise FitError(f"{found}; --scattered fits {detector.name} all the same{registered}")
    return [found]


def _unregistered_warnings(presses: NominalPresses, profile: SensorProfile, detector: Detector) -> list[str]:
    """Warn where presses lie apart although nothing can register them."""
    if len(presses) < MIN_PRESSES:
        return []
    scatter = _scatter_without_free_gel(presses, profile)
    if scatter <= SCATTERED_MM:
        return []
    return [
        f"{UNPROVEN}half of the presses lie more than {scatter:.1f} mm from their common middle, and without a picture "
        f"of the free gel they are not registered: {detector.name} compares place with place and will pass damage; "
        "give the free gel with --no-contact, or a recording that shows it"
    ]
