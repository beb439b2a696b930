"""The effects that a scene can name. An effect that it does not name is not computed and draws no random numbers."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from calibration.simulator import camera, gel, gel_surface, optics, pose
from edge.core.suggest import suggestion

__all__ = ["DEFAULT_EFFECTS", "EFFECTS", "Effect", "check_effects"]

Stage = Literal["pose", "surface", "light", "camera"]


@dataclass(frozen=True)
class Effect:
    """One effect: where in the chain it acts, and the pure function that computes it (its docstring has units and
    source)."""

    name: str
    stage: Stage
    function: object
    draws: tuple[str, ...] = ()
    """The words that name its random streams, empty when it is not random."""

    @property
    def summary(self) -> str:
        """The first line of the function's docstring."""
        return (self.function.__doc__ or "").strip().partition("\n")[0]


EFFECTS: Mapping[str, Effect] = {
    effect.name: effect
    for effect in (
        Effect("pose_jitter", "pose", pose.pose_jitter, ("pose_jitter",)),
        Effect("partial_contact", "pose", pose.partial_contact, ("partial_contact",)),
        Effect("deformation", "surface", gel.deformation),
        Effect("residual_imprint", "surface", gel.residual_imprint),
        Effect("dust", "surface", gel_surface.dust, ("dust",)),
        Effect("wear", "surface", gel_surface.wear, ("wear",)),
        Effect("illumination", "light", optics.illumination),
        Effect("shadows", "light", optics.shadows),
        Effect("specular", "light", optics.specular),
        Effect("grain", "light", gel_surface.grain, ("grain",)),
        Effect("markers", "light", gel_surface.markers),
        Effect("vignette", "camera", camera.vignette),
        Effect("lens_blur", "camera", camera.lens_blur),
        Effect("motion_blur", "camera", camera.motion_blur, ("motion_blur",)),
        Effect("led_drift", "camera", camera.led_drift, ("led_drift",)),
        Effect("noise", "camera", camera.noise, ("noise",)),
        Effect("jpeg", "camera", camera.jpeg),
    )
}
"""Every effect, in the order in which they act."""

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
