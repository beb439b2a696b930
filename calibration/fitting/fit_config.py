"""The settings of a fit, and the bundle that it gives."""

import errno
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from calibration.fitting.bundle_measurements import check_given
from calibration.fitting.limits.threshold import check_alpha
from calibration.fitting.pose.pose_decision import Register
from calibration.fitting.presses.augmentation import Augment
from calibration.fitting.trunks import Trunk
from edge.core.detector import Detector, Mode
from edge.core.errors import FitError, StoreError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.registration.registrar import PartInPose
from edge.model.bundle import Bundle
from edge.model.bundle_writer import write_bundle
from edge.model.manifest import Manifest
from edge.model.manifest_facts import gel_facts

__all__ = ["SETTINGS", "FitConfig", "Fitted"]

SETTINGS = "settings"
"""The entry of a manifest's `facts` with what the fit was asked for otherwise than usual, by the names of `--set`."""


@dataclass(frozen=True)
class FitConfig:
    """The settings of a fit."""

    part: str
    position: str
    profile: SensorProfile
    region: Region
    detector: Detector
    trunk: Trunk
    mode: Mode = "corrected"
    overrides: Mapping[str, object] = field(default_factory=dict)
    """The detector's parameters that differ from the mode's."""
    alpha: float = 0.05
    """The requested false-alarm rate."""
    threshold: float | None = None
    """A value to use instead of one found from presses."""
    seed: int = 0
    """Fixes every random choice."""
    threads: int = 2
    folds: int = 5
    """Banks fitted to find the threshold, each about as costly as the bank itself; below ten presses each is held out
    alone."""
    with_trunk: bool = True
    """Whether the trunk is in the bundle, or left to the store."""
    is_scattered: bool = False
    """Whether contacts may lie anywhere, also for a method that compares place with place."""
    limit: Literal["chosen", "plain"] = "chosen"
    """`chosen` by the damage that it finds, or `plain`, one for all places; the mode `paper` always has the plain
    one."""
    revision: int | None = None
    """The bundle's number, see `Facts`."""
    register: Register = "never"
    """Whether presses are brought to one pose, `auto` where it pays."""
    augment: Augment = "never"
    """Whether the bank also learns rendered copies of the presses, `auto` where there are few."""
    gel_id: str | None = None
    """The gel of the presses, where it is known."""
    pose: PartInPose | None = None
    """The part in the pose of an earlier bank, to which presses are brought; None where a fit finds it."""
    settings: Mapping[str, object] = field(default_factory=dict)
    """What was asked for otherwise than usual, for the manifest: a later fit asks for the same."""

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        check_given(self.threshold)
        if self.seed < 0:
            raise FitError(f"a seed is 0 or more, found {self.seed}")
        if self.folds < 2:
            raise FitError(f"a threshold needs at least 2 folds, found {self.folds}")

    @property
    def how_registered(self) -> Register:
        """`register`; the published methods register nothing by themselves."""
        return "never" if (self.mode, self.register) == ("paper", "auto") else self.register

    @property
    def view(self) -> tuple[SensorProfile, Region]:
        """The sensor of the pictures, and the part of them that is inspected."""
        return self.profile, self.region

    @property
    def facts(self) -> dict[str, Any]:
        """Return what the manifest says of the gel, and of what was asked for."""
        return gel_facts(self.gel_id) | ({SETTINGS: dict(self.settings)} if self.settings else {})

    @property
    def why_plain(self) -> str:
        """The reason why there is one limit for all places whatever it finds; empty where a limit is chosen."""
        if self.threshold is not None:
            return "the threshold was given"
        if self.mode == "paper":
            return "the published methods have no other"
        return "it was asked for" if self.limit == "plain" else ""


@dataclass(frozen=True)
class Fitted:
    """A fitted bundle that is not yet on disk."""

    manifest: Manifest
    files: dict[str, bytes]
    apart: tuple[str, ...] = ()
    """The presses that stand apart from all others, by their names."""

    def bundle(self, loaded: Container[str] = ()) -> Bundle:
        """Load it through the same checks as from disk. loaded: see `Bundle.load`."""
        return Bundle.in_memory(self.manifest, self.files, loaded=loaded)

    def write(self, path: Path, *, overwrite: bool = False) -> Path:
        """Write a folder or (name ending in .zip) a zip, complete or not at all. Errors: StoreError with what to do."""
        try:
            return write_bundle(path, self.files, overwrite=overwrite)
        except OSError as error:
            room = "free some space or " if error.errno == errno.ENOSPC else ""
            raise StoreError(
                f"{path} cannot be written: {error.strerror or error}; {room}choose another folder"
            ) from error
