"""A simulated station that presses one domed part, sound or with damage of known size."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from damaged_part_presses import with_damage
from numpy.typing import NDArray

from calibration.fitting.damage.damage import Damage
from calibration.fitting.damage.imprint import Station
from calibration.fitting.fit import FitConfig
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.trunks import open_trunk
from calibration.simulator.field_of_view import LR
from calibration.simulator.pose import Jitter, Pose, sample
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from edge import registry
from edge.core.arrays import F32
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

PROFILE = profile("cropped_lr")
REGION = Region(112, 72, 96, 96)
DEPTH_MM = 0.3


def pillow(x_mm: F32, y_mm: F32) -> F32:
    """A dome 4.4 mm across with two flat grooves, its top at 0."""
    r2 = x_mm * x_mm + y_mm * y_mm
    grooves = 0.12 * (np.abs(np.abs(x_mm) - 1.1) < 0.15)
    return np.asarray(np.maximum(-0.06 * r2, -1.0) - grooves, np.float32)


@dataclass(frozen=True)
class Bench:
    """The simulated station. Presses differ by jitter and noise."""

    gel: Renderer

    def placed(self, number: int) -> Pose:
        return self.gel.place(Pose(), ("press", number))

    def height(self, number: int) -> F32:
        """The sound part over the field, mm, float32 (240, 320)."""
        return sample(pillow, self.placed(number), LR)

    def press(self, number: int, damage: Damage | None = None) -> NDArray[np.uint8]:
        """One press, uint8 (240, 320, 3), with real damage rendered from the part's geometry on."""
        placed, part = self.placed(number), pillow
        if damage is not None:
            part = with_damage(pillow, damage, placed)
        imprint = self.gel.imprint(sample(part, placed, LR), DEPTH_MM * placed.depth_factor)
        return self.gel.expose(self.gel.light(self.gel.surface(imprint)), ("press", number), Exposure())

    def free(self) -> NDArray[np.uint8]:
        return self.gel.free_gel()


def dome_bench() -> Bench:
    return Bench(Renderer(jitter=Jitter(0.03, 0.2, 0.05, 0.01)))


@cache
def dome_presses(count: int) -> NominalPresses:
    """The first presses of the sound dome, with the free gel."""
    with reproducible_opencv():
        bench = dome_bench()
        pictures = {f"p{k}": bench.press(k) for k in range(count)}
        return gather_presses(pictures, PROFILE, REGION, no_contact=[bench.free()])


def dome_config(**changes: object) -> FitConfig:
    """How padim is fitted on the shipped trunk."""
    detector = registry.detector("padim")
    trunk = open_trunk("tactile_resnet18", detector.taps(detector.parameters("corrected")))
    config = FitConfig("dome", "top", PROFILE, REGION, detector, trunk, threads=1)
    return replace(config, **changes)  # type: ignore[arg-type]


def write(path: Path, rgb: NDArray[np.uint8]) -> None:
    """A picture, RGB, with the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), rgb[..., ::-1])


@pytest.fixture(scope="module", autouse=True)
def as_files_are_rendered() -> Iterator[None]:
    """Later modules have OpenCV's fast code again: a fit gives other bits with it."""
    with reproducible_opencv():
        yield


@pytest.fixture(scope="session")
def bench() -> Bench:
    return dome_bench()


@pytest.fixture(scope="session")
def station(bench: Bench) -> Station:
    with reproducible_opencv():
        return Station(PROFILE, REGION, REGION.crop(bench.free()).astype(np.float32))
