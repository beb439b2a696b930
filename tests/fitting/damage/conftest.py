"""The simulated station into whose presses damage is rendered."""

from collections.abc import Iterator

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, Bench, dome_bench

from calibration.fitting.damage.imprint import Station
from calibration.simulator.reproducible_math import reproducible_opencv


@pytest.fixture(scope="module", autouse=True)
def _as_files_are_rendered() -> Iterator[None]:
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
