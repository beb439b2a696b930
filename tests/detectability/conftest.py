"""The simulated station of these tests, pictures of its presses, and a bundle fitted on some of them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, Bench, write

from calibration.fitting.damage.imprint import Station
from calibration.fitting.fit import FitConfig, fit_bundle
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.trunks import open_trunk
from calibration.simulator.pose import Jitter
from calibration.simulator.renderer import Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from edge import registry


@pytest.fixture(scope="session")
def bench() -> Iterator[Bench]:
    with reproducible_opencv():
        yield Bench(Renderer(jitter=Jitter(0.03, 0.2, 0.05, 0.01)))


@pytest.fixture(scope="session")
def station(bench: Bench) -> Station:
    return Station(PROFILE, REGION, REGION.crop(bench.free()).astype(np.float32))


@pytest.fixture(scope="session")
def pictures(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders `learnt` (8 presses), `apart` (8 presses) and `free` (the free gel)."""
    root = tmp_path_factory.mktemp("station")
    for folder, numbers in (("learnt", range(8)), ("apart", range(8, 16))):
        for number in numbers:
            write(root / folder / f"p{number:02d}.png", bench.press(number))
    write(root / "free" / "free.png", bench.free())
    return root


@pytest.fixture(scope="session")
def fitted(pictures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle of padim on the eight learnt presses."""
    detector = registry.detector("padim")
    trunk = open_trunk("tactile_resnet18", detector.taps(detector.parameters("corrected")))
    presses = read_presses([pictures / "learnt"], PROFILE, REGION, no_contact=[pictures / "free"])
    config = FitConfig("dome", "top", PROFILE, REGION, detector, trunk, threads=1)
    return fit_bundle(tmp_path_factory.mktemp("fitted") / "bundle", presses, config, created="2026-01-01")
