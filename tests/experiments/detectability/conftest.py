"""The simulated station of these tests, pictures of its presses, and a bundle fitted on some of them."""

from pathlib import Path

import pytest
from pressed_dome import PROFILE, REGION, Bench, as_files_are_rendered, bench, dome_config, station, write
from tiny_fit import other_package

from calibration.fitting.fit import fit_files
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.simulator.reproducible_math import reproducible_opencv

__all__ = ["as_files_are_rendered", "bench", "other_package", "station"]


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
