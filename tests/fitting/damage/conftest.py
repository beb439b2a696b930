"""The simulated station into whose presses damage is rendered."""

from collections.abc import Iterator

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, Bench

from calibration.fitting.damage.imprint import Station
from calibration.simulator.pose import Jitter
from calibration.simulator.renderer import Renderer
from calibration.simulator.reproducible_math import reproducible_opencv


@pytest.fixture(scope="session")
def bench() -> Iterator[Bench]:
    with reproducible_opencv():
        yield Bench(Renderer(jitter=Jitter(0.03, 0.2, 0.05, 0.01)))


@pytest.fixture(scope="session")
def station(bench: Bench) -> Station:
    return Station(PROFILE, REGION, REGION.crop(bench.free()).astype(np.float32))
