"""Presses of a ball by a simulated sensor that the product does not ship, to be calibrated."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.sensor_fit.ball import Ball, ball_height
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.gel import Gel
from calibration.simulator.renderer import Renderer
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance
from calibration.simulator.streams import Streams
from edge.core.arrays import F32, U8

RADIUS_MM = 2.0
PLACES_MM = ((-6.0, -4.0), (0.0, -3.5), (6.0, -4.0), (-5.5, 3.5), (0.5, 0.5), (5.5, 4.0))
_DEPTH_MM = 0.3
_EFFECTS = tuple(name for name in DEFAULT_EFFECTS if name not in ("pose_jitter", "motion_blur", "led_drift"))


def _unseen() -> SensorAppearance:
    """Colours of one unit, another response (red stronger, green weaker), a softer gel, a raised gel that shines."""
    factors = np.array([[1.3], [0.8], [1.1]])
    per_mm = np.zeros((3, 6))
    per_mm[:, 0] = (15.0, 6.0, 12.0)
    return SensorAppearance(
        "unseen",
        SENSORS["unit_a"].free_gel,
        SENSORS["unit_b"].slope_response * factors,
        per_mm,
        Gel(0.4, 1.1, 0.55),
        (1.0, 2.0, 1.5),
    )


UNSEEN = _unseen()


def renderer(markers: bool = False, sensor: SensorAppearance = UNSEEN) -> Renderer:
    return Renderer(
        LR, (*_EFFECTS, "markers") if markers else _EFFECTS, sensor, streams=Streams(3), gel_id="ball"
    )


def frames(
    places: Sequence[tuple[float, float]] = PLACES_MM,
    markers: bool = False,
    depth_mm: float = _DEPTH_MM,
    sensor: SensorAppearance = UNSEEN,
) -> list[U8]:
    """The free gel, then one press at each place: uint8 (240, 320, 3) each."""
    one = renderer(markers, sensor)
    pressed = [one.free_gel()]
    for number, (x, y) in enumerate(places):
        height = ball_height(Ball(x, y, depth_mm * (1 + 0.1 * (number % 3))), RADIUS_MM, *grids(LR))
        pressed.append(one.press(lambda _x, _y, height=height: height, 0.0, ("ball", number)))  # type: ignore[misc]
    return pressed


def planes(rgb: U8) -> F32:
    return rgb.transpose(2, 0, 1).astype(np.float32)


def nominal(shown: Sequence[U8]) -> NominalPresses:
    """The first picture as free gel, the others as presses named 0, 1, ..."""
    return NominalPresses(
        np.stack(shown[1:]), tuple(f"{k}" for k in range(len(shown) - 1)), no_contact=np.stack(shown[:1])
    )


def without_free_gel(presses: NominalPresses) -> NominalPresses:
    return replace(presses, no_contact=None)


def write_frames(folder: Path, shown: Sequence[U8]) -> tuple[Path, Path]:
    """The presses in a folder, and the free gel's file next to it."""
    (folder / "presses").mkdir(parents=True)
    for number, rgb in enumerate(shown):
        path = folder / "free.png" if number == 0 else folder / "presses" / f"{number:02d}.png"
        cv2.imwrite(str(path), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    return folder / "presses", folder / "free.png"
