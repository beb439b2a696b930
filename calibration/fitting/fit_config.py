"""The settings of a fit."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from calibration.fitting.bundle_measurements import check_given
from calibration.fitting.limits.threshold import check_alpha
from calibration.fitting.pose.pose_decision import Register
from calibration.fitting.presses.augmentation import Augment
from calibration.fitting.trunks import Trunk
from edge.core.detector import Detector, Mode
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["FitConfig"]


@dataclass(frozen=True)
class FitConfig:
    """The settings of a fit.

    overrides: the detector's parameters that differ from the mode's. alpha: the requested false-alarm rate.
    threshold: a value to use instead of one found from presses. seed: fixes every random choice. folds: banks fitted
    to find the threshold, each about as costly as the bank itself; below ten presses each is held out alone.
    with_trunk: False leaves it to the store. is_scattered: accepts contacts that lie anywhere, also for a method that
    compares place with place. limit: `chosen` by the damage that it finds, or `plain`, one for all places; the mode
    `paper` always has the plain one. register: whether presses are brought to one pose, `auto` where it pays. augment:
    whether the bank also learns rendered copies of the presses, `auto` where there are few. revision: see `Facts`.
    gel_id: the gel of the presses, where it is known. choice_facts: why this method and this trunk were chosen, for the
    manifest; empty where they were named.
    """

    part: str
    position: str
    profile: SensorProfile
    region: Region
    detector: Detector
    trunk: Trunk
    mode: Mode = "corrected"
    overrides: Mapping[str, object] = field(default_factory=dict)
    alpha: float = 0.05
    threshold: float | None = None
    seed: int = 0
    threads: int = 2
    folds: int = 5
    with_trunk: bool = True
    is_scattered: bool = False
    limit: Literal["chosen", "plain"] = "chosen"
    revision: int | None = None
    register: Register = "never"
    augment: Augment = "never"
    gel_id: str | None = None
    choice_facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        check_given(self.threshold)
        if self.folds < 2:
            raise FitError(f"a threshold needs at least 2 folds, found {self.folds}")

    @property
    def view(self) -> tuple[SensorProfile, Region]:
        """The sensor of the pictures, and the part of them that is inspected."""
        return self.profile, self.region

    @property
    def why_plain(self) -> str:
        """The reason why there is one limit for all places whatever it finds; empty where a limit is chosen."""
        if self.threshold is not None:
            return "the threshold was given"
        if self.mode == "paper":
            return "the published methods have no other"
        return "it was asked for" if self.limit == "plain" else ""
