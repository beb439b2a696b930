"""Camera frames of a ball that is pressed into a gel and lifted, small and with noise, as JPEGs."""

from collections.abc import Iterable, Iterator
from functools import cache

import cv2
import numpy as np

from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.sensor_profile import SensorProfile

SIZE = (160, 120)
PROFILE = SensorProfile("test", SIZE, (0.0, 0.0), SIZE, 1, 4.0)
FPS = 25


@cache
def picture(depth: float, seed: int) -> bytes:
    """The ball 0 to 1 deep. seed: of the noise."""
    rows, columns = np.mgrid[:120, :160].astype(np.float32)
    radius = max(30 * depth**0.5, 1e-3)
    u, v = (columns - 80) / radius, (rows - 60) / radius
    slopes = np.stack([-60 * v, 55 * u, 60 * v], axis=-1) * (u * u + v * v <= 1)[..., None]
    noise = np.random.default_rng(seed).normal(0, 1.3, slopes.shape)
    level = (110 + rows / 6 + columns / 8)[..., None]
    return cv2.imencode(".jpg", np.clip(level + slopes + noise, 0, 255).astype(np.uint8))[1].tobytes()


def frames(depths: Iterable[float | None]) -> Iterator[CameraFrame]:
    """A frame for each depth, FPS a second; None for a frame that does not come."""
    for number, depth in enumerate(depths):
        if depth is not None:
            yield CameraFrame(picture(depth, number), 10**9 * (FPS + number) // FPS, number)
