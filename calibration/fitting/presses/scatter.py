"""How far apart presses lie: a method that compares place with place is not fitted to scattered ones."""

from calibration.fitting.presses.gel_choice import SCATTERED_MM, spread_mm
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge import registry
from edge.core.detector import Detector
from edge.core.errors import FitError
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.manifest_facts import UNPROVEN

__all__ = ["may_compare", "scatter_mm", "scatter_warnings"]


def scatter_mm(presses: NominalPresses, profile: SensorProfile) -> float | None:
    """Measure how far half of the contacts lie from their common middle; None where no touch is known."""
    return spread_mm(presses.touches, profile) if presses.touches else None


def may_compare(presses: NominalPresses, profile: SensorProfile, detector: Detector) -> bool:
    """Tell whether a method is fitted to presses as they lie: not one that compares places, to scattered contacts."""
    scatter = scatter_mm(presses, profile)
    return not detector.compares_places or scatter is None or scatter <= SCATTERED_MM


def scatter_warnings(
    presses: NominalPresses,
    profile: SensorProfile,
    detector: Detector,
    is_scattered: bool = False,
    why_unregistered: str = "",
) -> list[str]:
    """Check that a method that compares place with place is not fitted to scattered contacts.

    why_unregistered: said in the refusal. Errors: FitError where it is; a warning instead where `is_scattered` allows
    it, or the contacts are known by a free gel in doubt alone.
    """
    is_guessed = bool(presses.guessed)
    scatter = spread_mm(presses.guessed, profile) if is_guessed else scatter_mm(presses, profile)
    if not detector.compares_places or scatter is None or scatter <= SCATTERED_MM:
        return []
    methods = [registry.detector(name) for name in registry.names("detectors")]
    other = [one.name for one in methods if not (one.compares_places or one.is_baseline)]
    found = (
        f"half of the contacts lie more than {scatter:.1f} mm from their common middle: {detector.name} compares place "
        f"with place and will pass damage; hold the part at one place, or fit {' or '.join(other)}"
    )
    if is_guessed:
        return [f"{UNPROVEN}as far as a free gel in doubt shows it, {found}"]
    if not is_scattered:
        registered = f" ({why_unregistered}; see --set register)" if why_unregistered else ""
        raise FitError(f"{found}; --set scattered=true fits {detector.name} all the same{registered}")
    return [found]
