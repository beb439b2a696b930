"""A film turned into a recording: its frames as they are decoded, at the film's own times."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DatasetError
from edge.core.imaging.sensor_profile import cut_to_aspect
from edge.recording.format import RecordingHeader, RecordingWriter

__all__ = ["VIDEO_SUFFIXES", "Film", "film_of", "record_video"]

VIDEO_SUFFIXES = frozenset({".avi", ".mkv", ".mov", ".mp4", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv"})


@dataclass(frozen=True)
class Film:
    """What the file says of itself: (width, height), frames per second (a mean; each frame has its own time)."""

    path: Path
    size: tuple[int, int]
    fps: float
    frames: int = 0
    """As many as it says it has; 0 where it does not say. Some formats only estimate it."""


def film_of(path: Path) -> Film:
    """Read size, rate and length of a film. Errors: DatasetError for a file that the decoder cannot read."""
    film = _open(path)
    try:
        size = (round(film.get(cv2.CAP_PROP_FRAME_WIDTH)), round(film.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        fps = float(film.get(cv2.CAP_PROP_FPS))
        frames = max(0, round(film.get(cv2.CAP_PROP_FRAME_COUNT)))
    finally:
        film.release()
    if min(size) < 1:
        raise DatasetError(f"{path} has no picture; give a film that a player shows")
    return Film(path, size, fps if 0 < fps < 1000 else 25.0, frames)


def record_video(
    out: Path, film: Film, *, size: tuple[int, int] | None, product: str, serial: str, profile: str = ""
) -> int:
    """Write the recording, frames as PNG, and return how many. size: cut to its aspect and scale to it; None: as is.

    Errors: DatasetError for a film without frames; RecordingError, StoreError as `RecordingWriter`.
    """
    header = RecordingHeader(product, serial, size or film.size, film.fps, profile=profile)
    with RecordingWriter(out, header) as writer:
        for time_ns, bgr in _frames(film):
            picture = bgr if size is None else _scale(bgr, size)
            # The fastest compression: a recording is read far more often than it is kept.
            payload = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
            writer.add(payload, time_ns, {"source": film.path.name, "frame": len(writer)})
        if len(writer) == 0:
            raise DatasetError(
                f"{film.path} has no frame that can be decoded; give a film that a player shows"
            )
        return len(writer)


def _open(path: Path) -> Any:
    if not path.is_file():
        raise DatasetError(f"there is no film at {path}; check the path")
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not film.isOpened():
        raise DatasetError(f"{path} is no film that can be decoded; convert it, for example to MP4 (H.264)")
    return film


def _frames(film: Film) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Time since the film began and picture, BGR; a time that does not rise is put one nominal period on."""
    capture = _open(film.path)
    last_ns, period_ns = -1, round(1e9 / film.fps)
    try:
        while (picture := capture.read())[0]:
            time_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            last_ns = time_ns if time_ns > last_ns else last_ns + period_ns
            yield last_ns, picture[1]
    finally:
        capture.release()


def _scale(bgr: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    height, width = bgr.shape[:2]
    x, y = cut_to_aspect((width, height), size)
    left, top = round(width * x), round(height * y)
    middle = bgr[top : height - top, left : width - left]
    return np.asarray(cv2.resize(middle, size, interpolation=cv2.INTER_AREA), np.uint8)
