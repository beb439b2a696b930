"""Whether a sensor still shows its gel: a camera that hangs, or whose light is off, goes on sending frames."""

import zlib
from collections import deque
from typing import Final, final

from edge.core.contact.mask import is_black
from edge.core.contact.reference import View

__all__ = ["BLIND_AFTER_S", "Sight"]

# Cameras start with a few black frames, and single frames break: none of that lasts as long.
BLIND_AFTER_S: Final = 2.0
# Of the level over a view: at least 10 on 314 public pictures of twelve sensors, 28 on those of a Mini. A lens that is
# covered, a light that is too bright or a gel that is gone gives one colour.
_LEAST_CONTRAST_LEVELS: Final = 3.0
_WHITE_LEVEL: Final = 247.0
# The noise of a sensor makes every picture another one. A driver that hangs may go round in its buffers.
_BUFFERS: Final = 8


@final
class Sight:
    """Follows the frames of one sensor, by their own times.

    `lost` says why the gel has not been seen for `BLIND_AFTER_S`, and is None while it is seen. `since_ns` is the time
    of the last frame that showed it, or of the first frame where none did.
    """

    def __init__(self) -> None:
        self.lost: str | None = None
        self.since_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_BUFFERS)

    def see(self, view: View, timestamp_ns: int) -> bool:
        """Take one decoded view, float32 (h, w, 3), 0 to 255; returns whether it shows a gel, now or earlier."""
        fault, digest = _blindness(view), zlib.crc32(view.tobytes())
        is_frozen = digest in self._recent
        self._recent.append(digest)
        if fault is None and not is_frozen:
            self.lost, self.since_ns = None, timestamp_ns
        else:
            self.miss(fault or "its picture has not changed", timestamp_ns)
        return fault is None

    def miss(self, fault: str, timestamp_ns: int) -> None:
        """Take one frame that shows nothing. fault: why, as a clause."""
        if self.since_ns is None:
            self.since_ns = timestamp_ns
        if timestamp_ns - self.since_ns >= BLIND_AFTER_S * 1e9:
            self.lost = fault

    def resume(self, timestamp_ns: int) -> None:
        """Begin again after a pause in the stream, which is not the sensor's blindness."""
        if self.lost is None:
            self.since_ns = timestamp_ns


def _blindness(view: View) -> str | None:
    level = float(view.mean())
    if is_black(view):
        return f"its picture is black, mean level {level:.1f}"
    if level > _WHITE_LEVEL:
        return f"its picture is white, mean level {level:.1f}"
    contrast = float(view.std(axis=(0, 1)).max())
    if contrast < _LEAST_CONTRAST_LEVELS:
        return f"its picture is of one colour, which varies by {contrast:.1f} levels over the view"
    return None
