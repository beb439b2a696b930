"""A fit of the smallest detector: its presses and its configuration, each with what a test changes."""

import dataclasses
import sys
from collections.abc import Iterator

import pytest
import tiny

from calibration.fitting.fit import FitConfig
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk
from edge import registry


def presses(n: int, **changes: object) -> NominalPresses:
    frames = tiny.presses(n)
    return dataclasses.replace(NominalPresses(frames, tuple(f"press {k}" for k in range(n))), **changes)  # type: ignore[arg-type]


def config(**changes: object) -> FitConfig:
    whole = FitConfig(
        part="bolt",
        position="crest",
        profile=tiny.PROFILE,
        region=tiny.REGION,
        detector=tiny.TINY,
        trunk=Trunk("tiny", tiny.tiny_trunk()),
    )
    return dataclasses.replace(whole, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def other_package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The tiny detector and backbone as another distribution installs its own: through entry points."""
    site = tmp_path_factory.mktemp("site")
    info = site / "other_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other_package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[gelgate.detectors]\ntiny = tiny:TINY\n[gelgate.backbones]\ntiny = tiny:TINY_BACKBONE\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path, str(site)])
        registry._installed.cache_clear()
        registry._points.cache_clear()
        yield
    registry._installed.cache_clear()
    registry._points.cache_clear()
