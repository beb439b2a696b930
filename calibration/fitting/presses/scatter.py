"""How far apart presses lie: a method that compares place with place is not fitted to scattered ones."""

import numpy as np

from calibration.fitting.presses.nominal_presses import NominalPresses
from edge import registry
from edge.core.detector import Detector
from edge.core.errors import FitError
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["is_placed", "scatter_mm", "scatter_warnings"]

SCATTERED_MM = 3.0
"""Presses whose contacts scatter more have no common place. Measured: up to 1.8 mm on simulated parts placed by hand,
where their contacts are wide and shallow; 4.2 mm and more on balls pressed anywhere, where methods that compare places
find a fifth of the damage that inreach finds."""


def scatter_mm(presses: NominalPresses, profile: SensorProfile) -> float | None:
    """Measure how far half of the contacts lie from their common middle; None where no touch is known."""
    if not presses.touches:
        return None
    middles = (
        np.array([(touch.x, touch.y) for touch in presses.touches]) * profile.size / profile.pixels_per_mm
    )
    return float(np.median(np.linalg.norm(middles - np.median(middles, axis=0), axis=1)))


def is_placed(presses: NominalPresses, profile: SensorProfile) -> bool:
    """Tell whether the contacts are known to lie at one place."""
    scatter = scatter_mm(presses, profile)
    return scatter is not None and scatter <= SCATTERED_MM


def scatter_warnings(
    presses: NominalPresses,
    profile: SensorProfile,
    detector: Detector,
    is_scattered: bool = False,
    why_unregistered: str = "",
) -> list[str]:
    """Check that a method that compares place with place is not fitted to scattered contacts.

    why_unregistered: said in the refusal. Errors: FitError where it is; a warning instead where `is_scattered` allows
    it.
    """
    scatter = scatter_mm(presses, profile)
    if not detector.compares_places or scatter is None or scatter <= SCATTERED_MM:
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
