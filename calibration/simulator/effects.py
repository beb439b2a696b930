"""The effects that a scene can name. An effect that it does not name is not computed and draws no random numbers."""

from collections.abc import Callable, Iterable, Mapping

from calibration.simulator import camera, gel, gel_surface, optics, pose
from edge.core.suggest import suggestion

__all__ = ["DEFAULT_EFFECTS", "EFFECTS", "check_effects"]

EFFECTS: Mapping[str, Callable[..., object]] = {
    function.__name__: function
    for function in (
        *(pose.pose_jitter, pose.partial_contact),
        *(gel.deformation, gel.residual_imprint, gel_surface.dust, gel_surface.wear),
        *(optics.illumination, optics.shadows, optics.specular, gel_surface.grain, gel_surface.markers),
        *(camera.vignette, camera.lens_blur, camera.motion_blur, camera.led_drift, camera.noise, camera.jpeg),
    )
}
"""Every effect in the order in which they act, on pose, surface, light and camera: by its name the pure function that
computes it, whose docstring has units and source. A random one has the stream of its name."""

DEFAULT_EFFECTS = tuple(
    name for name in EFFECTS if name not in ("partial_contact", "markers", "residual_imprint")
)
"""The effects of a plain gel that is pressed firmly, with enough time between presses."""


def check_effects(names: Iterable[str]) -> frozenset[str]:
    """Give the names as a set. Errors: ValueError naming every unknown one with the nearest known name."""
    named = frozenset(names)
    unknown = [
        f"no effect is named '{name}'; {suggestion(name, EFFECTS)}" for name in sorted(named - set(EFFECTS))
    ]
    if unknown:
        raise ValueError(" ".join(unknown))
    return named
