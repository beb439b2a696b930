"""The simulated station into whose presses damage is rendered."""

from collections.abc import Iterator

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, Bench, dome_bench

from calibration.fitting.damage.imprint import Station
from calibration.simulator.reproducible_math import reproducible_opencv


@pytest.fixture(scope="session")
def bench() -> Iterator[Bench]:
    with reproducible_opencv():
        yield dome_bench()


@pytest.fixture(scope="session")
def station(bench: Bench) -> Station:
    return Station(PROFILE, REGION, REGION.crop(bench.free()).astype(np.float32))
