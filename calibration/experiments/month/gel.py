"""The gel of one station and the camera that looks at it: what each piece, speck and scar shows, as camera frames."""

import math
from collections.abc import Iterator
from itertools import islice
from typing import Final

import cv2
import numpy as np

from calibration.experiments.month.plan import DEPTH_MM, Month, PlannedPress
from calibration.simulator.camera import CAMERA_QUALITY, encode_jpeg
from calibration.simulator.defects import Damaged
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import HeightField, Pose, sample
from calibration.simulator.renderer import Exposure, Key, Renderer
from calibration.simulator.scars import Scar, mark_gel
from calibration.simulator.sensor_appearance import SENSORS, another_gel
from edge.core.arrays import F32, U8

__all__ = ["FRAME_S", "MountedGel"]

FRAME_S: Final = 0.1
"""Between two frames."""

# Frames of a press: halfway down, held, halfway up.
_HELD: Final = 6
_HALF: Final = 0.5
# Seconds since the release at which the residual imprint is shown until the next press.
_RESIDUE_S: Final = 0.5
# The lamps are warm.
_POWERED_S: Final = 3600.0
_PRESSED_MM: Final = 0.02
# How far from the first press of a piece the next one is made.
_ELSEWHERE_MM: Final = 0.4


class MountedGel:
    """One gel of a month on one station's sensor. Dust is the station's own, for its operator wipes it or not."""

    def __init__(self, month: Month, number: int = 0, since: int = 0) -> None:
        """number: 0 is the first of the month. since: the press before which it was mounted."""
        self.month, self.number, self.since = month, number, since
        sensor = SENSORS["unit_b"]
        if number:
            sensor = another_gel(sensor, np.random.default_rng([month.seed, 3, number]))
        # Dust is the month's, and the camera's bytes are JPEG in every case.
        effects = [name for name in (*DEFAULT_EFFECTS, "residual_imprint") if name not in ("dust", "jpeg")]
        jitter = PARTS["PZ3" if month.part % 2 else "PZ5"].jitter
        self._renderer = Renderer(LR, effects, sensor, jitter, month.streams, f"gel {number}", "month")
        self.specks: list[Scar] = []
        self._left: F32 | None = None
        self._frame = 0

    def height(self, press: PlannedPress, attempt: int = 0) -> tuple[F32, float]:
        """Return the piece as it lies, mm, float32 (240, 320), and the depth to which it is pressed."""
        whole: HeightField = self.month.piece(press)
        across, down = press.pose.shift_mm
        if attempt:  # a second press is made a little elsewhere
            way = self.month.streams("elsewhere", press.number, attempt).uniform(0, 2 * math.pi)
            across, down = across + _ELSEWHERE_MM * math.cos(way), down + _ELSEWHERE_MM * math.sin(way)
        pose = Pose((across, down), press.pose.turn_rad)
        placed = self._renderer.place(pose, (press.number, attempt))
        shown = whole if press.defect is None else Damaged(whole, press.defect)
        return sample(shown, placed, LR), DEPTH_MM * press.depth_factor * placed.depth_factor

    def press(self, press: PlannedPress, attempt: int = 0) -> Iterator[bytes]:
        """Yield the camera's frames from the approach to the lift."""
        height, depth_mm = self.height(press, attempt)
        scars = self.month.scars(press, self.since)
        half = self._renderer.imprint(height, _HALF * depth_mm)
        whole = self._renderer.imprint(height, depth_mm)
        moving = self._film(self._light(half, press, scars), press)
        held = self._film(self._light(whole, press, scars), press)
        yield next(moving)
        yield from islice(held, _HELD)
        yield next(moving)
        self._left = whole

    def free(self, press: PlannedPress, seconds: float) -> Iterator[bytes]:
        """Yield frames of the free gel, with what the last press has left. press: of the moment."""
        flat = np.zeros(LR.shape, np.float32)
        light = self._light(flat, press, self.month.scars(press, self.since), self._left)
        yield from islice(self._film(light, press), max(3, round(seconds / FRAME_S)))

    def is_marked(self, press: PlannedPress) -> bool:
        """Tell whether dust lies where the piece touches."""
        height, depth_mm = self.height(press)
        touched = self._renderer.imprint(height, depth_mm) > _PRESSED_MM
        return any(
            bool((np.abs(speck.relief(LR)) > 0.2 * abs(speck.strength))[touched].any())
            for speck in self.specks
        )

    def nominal(self, piece: int, attempt: int) -> U8:
        """Take the picture of a press of the fit, uint8 (240, 320, 3)."""
        shape = self.month.nominal_piece(piece)
        placed = self._renderer.place(Pose(), ("nominal", piece, attempt))
        imprint = self._renderer.imprint(sample(shape, placed, LR), DEPTH_MM * placed.depth_factor)
        return self._still(self._renderer.light(self._renderer.surface(imprint)), ("nominal", piece, attempt))

    def nominal_free(self, number: int) -> U8:
        """Take a picture of the free gel for the fit, uint8 (240, 320, 3)."""
        light = self._renderer.light(self._renderer.surface(np.zeros(LR.shape, np.float32)))
        return self._still(light, ("nominal free", number))

    def _still(self, light: F32, key: tuple[str | int, ...]) -> U8:
        rgb = self._renderer.expose(light, key, Exposure(0, _POWERED_S, (0.0, 0.0)))
        read = cv2.imdecode(np.frombuffer(encode_jpeg(rgb, CAMERA_QUALITY), np.uint8), cv2.IMREAD_COLOR_RGB)
        return np.asarray(read, np.uint8)

    def _light(
        self,
        imprint: F32,
        press: PlannedPress,
        scars: tuple[tuple[Scar, float], ...],
        left: F32 | None = None,
    ) -> F32:
        previous = None if left is None else (left, _RESIDUE_S)
        age = self.month.wear(press.number - self.since)
        surface = self._renderer.surface(imprint, age, previous)
        marked, coat = mark_gel(surface, (*scars, *((speck, 1.0) for speck in self.specks)), LR)
        return np.asarray(self._renderer.light(marked, age) * coat, np.float32)

    def _film(self, light: F32, press: PlannedPress) -> Iterator[bytes]:
        """Yield the camera's frames of this light without end."""
        exposure = Exposure(0, _POWERED_S, (0.0, 0.0))
        for rgb in self._renderer.film(light * np.float32(press.light), self._keys(press.number), exposure):
            yield encode_jpeg(rgb, CAMERA_QUALITY)

    def _keys(self, number: int) -> Iterator[Key]:
        """Count the frames, whatever light they are of, and name each."""
        while True:
            self._frame += 1
            yield "frame", number, self._frame
