"""Presses of balls of known size on three real gels: public frames in the folder that `TACTILE` names."""

import os
from pathlib import Path

import pytest

from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

_SETS = {
    "gelslam, 6.31 mm": ("rpl-cmu__gelslam/6.310mm", "rpl-cmu__gelslam/background.png", 3.155),
    "gelslam, 9.50 mm": ("rpl-cmu__gelslam/9.500mm", "rpl-cmu__gelslam/background.png", 4.75),
    "skleff1994, 9.47 mm": ("skleff1994__gs_sdk/9.470mm", "skleff1994__gs_sdk/background.png", 4.735),
    "FabPrez, 5.0 mm": ("FabPrez__Taxim/gsmini_ball5.0", "FabPrez__Taxim/gsmini_ball5.0/frame_0.jpg", 2.5),
}


def real_balls(*names: str) -> dict[str, tuple[NominalPresses, float]]:
    """Return presses and radius in mm of each set, by default of all. Without the frames the test is skipped."""
    folder = os.environ.get("TACTILE")
    if folder is None:
        pytest.skip("SKIPPED, NOT TESTED: name the folder of public frames with TACTILE")
    return {
        name: (_read(Path(folder), *paths), radius)
        for name, (*paths, radius) in _SETS.items()
        if name in names or not names
    }


def _read(folder: Path, balls: str, free: str) -> NominalPresses:
    own = profile("mini_lr")
    sources = sorted(
        path
        for path in (folder / balls).rglob("*")
        if path.suffix in (".png", ".jpg") and path.name != "frame_0.jpg"
    )
    return read_presses(sources, own, Region.full(own.size), no_contact=[folder / free])
