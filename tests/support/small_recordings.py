"""Small recordings of small frames."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from edge.recording.format import RecordingHeader, RecordingWriter

PRODUCT, SERIAL = "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7"
PERIOD_NS = 53_333_333  # 18.75 fps


@cache
def jpeg(seed: int, size: tuple[int, int] = (64, 48), suffix: str = ".jpg") -> bytes:
    """A noise picture of (width, height); each seed gives different bytes."""
    picture = np.random.default_rng(seed).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    return cv2.imencode(suffix, picture)[1].tobytes()


def write_recording(
    folder: Path, payloads: Sequence[bytes] | int, *, size: tuple[int, int] = (64, 48), product: str = PRODUCT
) -> Path:
    """A recording of these payloads, or of this number of noise pictures, at 18.75 fps."""
    frames = [jpeg(seed, size) for seed in range(payloads)] if isinstance(payloads, int) else payloads
    with RecordingWriter(folder, RecordingHeader(product, SERIAL, size, 25.0)) as writer:
        for position, payload in enumerate(frames):
            writer.add(payload, position * PERIOD_NS)
    return folder
