"""Real frames: every frame of another kind of sensor is refused, and no press of the unit that was learnt."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.fitting.presses.colours import nominal_colours
from edge.core.contact.reference import View
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.followed_light import find_light
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.quality import Reason
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_check import NominalColours, check_sensor

SIZE = profile("cropped_lr").size
REGION = Region.centre(SIZE)

# Presses of one ball, each set on one unit.
UNITS = {
    "gelslam 6.31": "rpl-cmu__gelslam/6.310mm/*/gelsight.png",
    "gelslam 9.50": "rpl-cmu__gelslam/9.500mm/*/gelsight.png",
    "gs_sdk 9.47": "skleff1994__gs_sdk/9.470mm/*/gelsight.png",
    "taxim 5.0": "FabPrez__Taxim/gsmini_ball5.0/frame_*.jpg",
}
OTHERS = (
    "RavenLiang1005__UniCal/9DTact/*.png",
    "RavenLiang1005__UniCal/DM-Tac/*.png",
    "RavenLiang1005__UniCal/Tac3D/*.png",
    "Rancho-zhao__FOTS/digit_ball/*.png",
    "Rancho-zhao__FOTS/digit_shadow/*.png",
    "Rancho-zhao__FOTS/gelsight_ball/*.png",
    "Rancho-zhao__FOTS/marker/*.png",
    "gelsightinc__sdkdemo/*/*/*.png",
    "gelsightinc__gsmatlab/groove/*.png",
)


def region(path: Path) -> NDArray[np.uint8]:
    """A picture of any size, as the gateway would see it from a sensor with such a view."""
    bgr = cv2.imread(str(path))
    assert bgr is not None, path
    small = cv2.resize(bgr[..., ::-1], SIZE, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(REGION.crop(np.asarray(small, np.uint8)))


def learnt(paths: Sequence[Path]) -> NominalColours:
    colours = nominal_colours(np.stack([region(path) for path in paths]))
    assert colours is not None
    return colours.nominal()


@pytest.fixture(scope="module")
def others(real_tactile: Path) -> dict[Path, NDArray[np.uint8]]:
    found = {path: region(path) for pattern in OTHERS for path in sorted(real_tactile.glob(pattern))}
    assert len(found) >= 110
    return found


@pytest.fixture(scope="module", params=list(UNITS), ids=lambda name: name.replace(" ", "-"))
def unit(request: pytest.FixtureRequest, real_tactile: Path) -> tuple[NominalColours, list[Path]]:
    """What two of three presses teach, and the third ones."""
    paths = sorted(real_tactile.glob(UNITS[request.param]))
    assert len(paths) >= 23
    held = paths[2::3]
    return learnt([path for path in paths if path not in held]), held


def test_every_frame_of_another_sensor_is_refused(
    unit: tuple[NominalColours, list[Path]], others: dict[Path, NDArray[np.uint8]]
) -> None:
    """DIGIT, DTact, DM-Tac, Tac3D, bench and home-built sensors, whatever unit was learnt."""
    found = {path: check_sensor(rgb, unit[0]) for path, rgb in others.items()}

    assert [path for path, rejection in found.items() if rejection is None] == []
    assert {rejection.reason for rejection in found.values() if rejection} == {Reason.OTHER_SENSOR}


def test_held_out_presses_of_the_unit_are_accepted(unit: tuple[NominalColours, list[Path]]) -> None:
    """Not one of them is refused."""
    colours, held = unit

    assert [path for path in held if check_sensor(region(path), colours)] == []


def test_the_unit_is_known_with_another_ball(real_tactile: Path) -> None:
    """Learnt on one ball, shown another one and the free gel."""
    colours = learnt(sorted(real_tactile.glob(UNITS["gelslam 6.31"])))
    seen = [
        *real_tactile.glob(UNITS["gelslam 9.50"]),
        real_tactile / "rpl-cmu__gelslam/background.png",
    ]

    assert [path for path in seen if check_sensor(region(path), colours)] == []


def test_the_unit_is_known_on_another_day(real_tactile: Path) -> None:
    """Three parts and the free gel learnt; the free gel of that sensor at another time is no stranger."""
    home = real_tactile / "joehjhuang__gs_sdk"
    colours = learnt([home / f"{name}.png" for name in ("bead", "key", "seed", "background")])

    assert check_sensor(region(real_tactile / "rpl-cmu__normalflow/background.png"), colours) is None


MINIS = (
    "rpl-cmu__gelslam/background.png",
    "joehjhuang__gs_sdk/background.png",
    "skleff1994__gs_sdk/background.png",
    "rpl-cmu__normalflow/background.png",
    "FabPrez__Taxim/gsmini_ball5.0/frame_0.jpg",
)
"""The free gel of five sensors of one kind."""


def view(path: Path) -> View:
    bgr = cv2.imread(str(path))
    assert bgr is not None, path
    return np.asarray(cv2.resize(bgr[..., ::-1], VIEW_SIZE, interpolation=cv2.INTER_AREA), np.float32)


def test_the_shading_of_any_gel_of_this_kind_is_followed_and_of_no_other(
    real_tactile: Path, others: dict[Path, NDArray[np.uint8]]
) -> None:
    """Five units, each as the new gel of each other one; pictures of other kinds, whichever is the gel of the fit."""
    minis = [view(real_tactile / name) for name in MINIS]
    for at_fit in minis:
        for new in minis:
            light, is_proven = find_light(new, at_fit, new)
            assert is_proven or light is not None
    strangers = [view(path) for path in others]
    followed = [find_light(new, at_fit, new) for new in strangers for at_fit in minis]
    assert followed == [(None, False)] * len(followed)
