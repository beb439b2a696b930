"""The simulated station of these tests, pictures of its presses, and a bundle fitted on some of them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, Bench, dome_bench, dome_config, write

from calibration.fitting.damage.imprint import Station
from calibration.fitting.fit import fit_files
from calibration.fitting.presses.nominal_presses import read_presses
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


@pytest.fixture(scope="session")
def pictures(bench: Bench, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders `learnt` (8 presses), `apart` (8 presses) and `free` (the free gel)."""
    root = tmp_path_factory.mktemp("station")
    with reproducible_opencv():
        for folder, numbers in (("learnt", range(8)), ("apart", range(8, 16))):
            for number in numbers:
                write(root / folder / f"p{number:02d}.png", bench.press(number))
        write(root / "free" / "free.png", bench.free())
    return root


@pytest.fixture(scope="session")
def fitted(pictures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle of padim on the eight learnt presses."""
    presses = read_presses([pictures / "learnt"], PROFILE, REGION, no_contact=[pictures / "free"])
    fitted = fit_files(presses, dome_config(), created="2026-01-01")
    return fitted.write(tmp_path_factory.mktemp("fitted") / "bundle")
