"""An operating point: one way to inspect a part, with everything that its accuracy and its cost depend on."""

from dataclasses import dataclass
from typing import Any, Final

from calibration.experiments.harness.pictures import find_centre
from edge.core.detector import Mode
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["VIEWS", "OperatingPoint", "View"]

Setting = str | int | float | bool | tuple[int, ...] | None


@dataclass(frozen=True)
class View:
    """How a press is seen: a profile's picture, the centre of the gel in it, in one piece or in tiles."""

    profile: SensorProfile
    overlap: int | None = None
    """Least overlap of neighbouring tiles in pixels, None without tiles. All views show the same part of the gel."""

    @property
    def region(self) -> Region:
        """The centre of the low-resolution picture, in this picture's pixels."""
        return find_centre(self.profile.size)


VIEWS: Final = {
    "lr": View(profile("mini_lr")),
    "hr": View(profile("mini_hr")),
    "hr_tiles_0": View(profile("mini_hr"), 0),
    "hr_tiles_56": View(profile("mini_hr"), 56),
}
"""Every view by its name. 56 pixels is the seed paper's overlap of tiles of 224."""


@dataclass(frozen=True)
class OperatingPoint:
    """One way to inspect a part."""

    method: str
    backbone: str
    view: str = "lr"
    presses: int = 20
    """Nominal presses of the fit; the first ones of a fixed order, so that more presses contain fewer."""
    mode: Mode = "corrected"
    settings: tuple[tuple[str, Setting], ...] = ()
    """Parameters of the detector that differ from its mode's, sorted by name."""

    @property
    def key(self) -> str:
        """The point's name in rows and on the command line, such as `padim.tactile_resnet18.lr.20.rank=8`."""
        names = [self.method, self.backbone, self.view, str(self.presses)]
        if self.mode != "corrected":
            names.append(self.mode)
        return ".".join([*names, *(f"{name}={_write_value(value)}" for name, value in self.settings)])

    @property
    def overrides(self) -> dict[str, Any]:
        return dict(self.settings)


def _write_value(value: Setting) -> str:
    return "+".join(map(str, value)) if isinstance(value, tuple) else str(value)
