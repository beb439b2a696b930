"""An operating point: one way to inspect a part, with everything that its accuracy and its cost depend on."""

from dataclasses import dataclass
from typing import Any, Final

from edge.core.detector import Mode
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["VIEWS", "OperatingPoint", "View"]

Setting = str | int | float | bool | tuple[int, ...] | None

LR_PROFILE: Final = "mini_lr"
HR_PROFILE: Final = "mini_hr"


@dataclass(frozen=True)
class View:
    """How a press is seen: a profile's picture, the centre of the gel in it, in one piece or in tiles."""

    name: str
    profile_name: str
    overlap: int | None = None
    """Least overlap of neighbouring tiles in pixels, None without tiles. All views show the same part of the gel."""

    @property
    def profile(self) -> SensorProfile:
        return profile(self.profile_name)

    @property
    def region(self) -> Region:
        """The centre of the low-resolution picture, in this picture's pixels."""
        low, size = profile(LR_PROFILE).size, self.profile.size
        centre = Region.centre(low)
        across, down = size[0] // low[0], size[1] // low[1]
        return Region(centre.x * across, centre.y * down, centre.width * across, centre.height * down)


VIEWS: Final = {
    view.name: view
    for view in (
        View("lr", LR_PROFILE),
        View("hr", HR_PROFILE),
        View("hr_tiles_0", HR_PROFILE, 0),
        View("hr_tiles_56", HR_PROFILE, 56),
    )
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

    def __post_init__(self) -> None:
        if self.view not in VIEWS:
            raise ValueError(f"no view is named '{self.view}'; known: {', '.join(VIEWS)}")
        if self.presses < 1:
            raise ValueError(f"a fit needs at least one press, found {self.presses}")
        if [name for name, _ in self.settings] != sorted(name for name, _ in self.settings):
            raise ValueError(f"settings are sorted by name, found {self.settings}")

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
