"""Whether a sensor still sees presses: its frames show the gel, and no contact lasts much longer than the usual ones.

A camera that hangs, or whose light is off, goes on sending frames; what holds a contact open hides those that follow.
"""

import zlib
from collections import deque
from statistics import median
from typing import Final, TypeAlias, final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import BLACK_LEVEL
from edge.core.contact.reference import View
from edge.core.contact.signals import Phase
from edge.core.sentence import Sentence

__all__ = ["BLIND_AFTER_S", "Light", "LongContact", "Sight", "measure_light"]

Light: TypeAlias = tuple[float, float]
"""The level of a view, and its largest deviation of a colour."""

# Cameras start with a few black frames, and single frames break: none of that lasts as long.
BLIND_AFTER_S: Final = 2.0
# Of the level over a view: at least 10 on 314 public pictures of twelve sensors, 28 on those of a Mini. A lens that is
# covered, a light that is too bright or a gel that is gone gives one colour.
_LEAST_CONTRAST_LEVELS: Final = 3.0
_WHITE_LEVEL: Final = 247.0
# Of the light and of the contrast of the free gel: at least .9 on 172 public pictures of presses on five gels.
_LEAST_SHARE: Final = 0.5
# Times without sight, of at most `BLIND_AFTER_S` each and longer than single frames; sight pays them back more slowly.
_OUTAGE_S: Final = 0.3
_OFTEN_S: Final = 4.0
_PAID_BACK: Final = 0.25
# The noise of a sensor makes every picture another one. A driver that hangs may go round in its buffers.
_BUFFERS: Final = 8
_AGAIN: Final = Sentence(
    "the gel was free for a moment, too short to end the press, and is pressed again: of two parts one is neither "
    "judged nor counted. Lift for 0.2 s between parts"
)
_OVER_IT: Final = Sentence(
    "what touched the gel lightly was taken for a press, and now the gel is pressed far more: a part that came "
    "meanwhile is neither judged nor counted. Look at the gel, wipe it, and press the part again"
)


@final
class Sight:
    """Follows the frames of one sensor, by their own times.

    `lost` says why the gel has not been seen for `BLIND_AFTER_S`, and is None while it is seen. `seen_ns` is the time
    of the last frame that showed it. `since_ns` is the same, but of the first frame where none did, or of the first
    one after a pause of the stream.
    """

    def __init__(self) -> None:
        self.lost: str | None = None
        self.since_ns: int | None = None
        self.seen_ns: int | None = None
        self.comes_and_goes = False
        self._fault = ""
        self._owed_s = 0.0
        self._recent: deque[int] = deque(maxlen=_BUFFERS)

    def see(self, view: View, timestamp_ns: int, usual: Light | None = None) -> bool:
        """Take one decoded view, float32 (h, w, 3), 0 to 255; returns whether it shows a gel, now or earlier.

        usual: the light of the free gel that was learnt from this sensor; another gel or sensor may have any.
        """
        pixels = view.astype(np.uint8)  # a quarter of the bytes
        fault, digest = _blindness(pixels, usual), zlib.crc32(pixels.data)
        is_frozen = digest in self._recent
        self._recent.append(digest)
        if fault is None and not is_frozen:
            self._pay_back(timestamp_ns)
            self.lost = self._fault if self.comes_and_goes else None
            self.since_ns = self.seen_ns = timestamp_ns
        else:
            self.miss(fault or Sentence("its picture has not changed"), timestamp_ns)
        return fault is None

    def miss(self, fault: str, timestamp_ns: int) -> None:
        """Take one frame that shows nothing. fault: why, as a clause."""
        if self.since_ns is None:
            self.since_ns = timestamp_ns
        self._fault = fault
        if timestamp_ns - self.since_ns >= BLIND_AFTER_S * 1e9:
            self.lost = fault

    def resume(self, timestamp_ns: int) -> None:
        """Begin again after a pause in the stream, which is not the sensor's blindness."""
        if self.lost is None:
            self.since_ns = timestamp_ns

    def _pay_back(self, timestamp_ns: int) -> None:
        """Add up the times without sight that come again and again, each of them too short to be a fault alone."""
        passed_s = 0.0 if self.since_ns is None else (timestamp_ns - self.since_ns) / 1e9
        if passed_s > _OUTAGE_S:
            self._owed_s = min(self._owed_s + min(passed_s, BLIND_AFTER_S), _OFTEN_S)
        else:
            self._owed_s = max(self._owed_s - _PAID_BACK * passed_s, 0.0)
        self.comes_and_goes = self._owed_s >= (_OFTEN_S / 2 if self.comes_and_goes else _OFTEN_S)


def measure_light(view: View | NDArray[np.uint8]) -> Light:
    """Return the level of a view and its largest deviation of a colour, in levels."""
    levels, deviations = cv2.meanStdDev(view)  # many times as fast as numpy's
    return float(levels.mean()), float(deviations.max())


def _blindness(pixels: NDArray[np.uint8], usual: Light | None) -> str | None:
    level, contrast = measure_light(pixels)
    if level < BLACK_LEVEL:
        return Sentence(f"its picture is black, mean level {level:.1f}")
    if level > _WHITE_LEVEL:
        return Sentence(f"its picture is white, mean level {level:.1f}")
    if contrast < _LEAST_CONTRAST_LEVELS:
        return Sentence(f"its picture is of one colour, which varies by {contrast:.1f} levels over the view")
    if usual is None:
        return None
    light, detail = level / usual[0], contrast / usual[1]
    if light < _LEAST_SHARE:
        return Sentence(f"its picture has {light:.0%} of the light in which the free gel was learnt")
    if detail < _LEAST_SHARE:
        return Sentence(f"its picture has {detail:.0%} of the contrast of the free gel")
    return None


_CONTACTS_KEPT: Final = 9
# This many times the usual length is an alarm, and twice as long a fault. A station that holds every part for a minute
# is used to it; one that knows no usual length yet has half a minute.
_TIMES: Final = 4.0
_LEAST_S: Final = 3.0
_FIRST_S: Final = 15.0


@final
class LongContact:
    """Follows the contacts of one sensor, by the frames' own times, as long as they are seen."""

    def __init__(self) -> None:
        self._lengths_s: deque[float] = deque(maxlen=_CONTACTS_KEPT)
        self._began_ns: int | None = None
        self._is_lifted = False
        self._again: Sentence | None = None

    def begin(self, timestamp_ns: int) -> None:
        """A press began."""
        self._began_ns = timestamp_ns
        self._is_lifted, self._again = False, None

    def see(self, phase: Phase) -> None:
        """Notice that the gel is pressed again, after it was free or over what lies there, before the press is over."""
        if self._began_ns is None:
            return
        if phase == "free":
            self._is_lifted = True
        elif phase == "over it":
            self._again = self._again or _OVER_IT
        elif self._is_lifted and phase != "unseen":
            self._again = _AGAIN

    def leave_out(self, seconds: float, until_ns: int) -> None:
        """Nothing was seen for so long until then: that time is no part of the contact."""
        if self._began_ns is not None and seconds > BLIND_AFTER_S:
            self._began_ns = min(self._began_ns + round(seconds * 1e9), until_ns)

    def end(self, timestamp_ns: int) -> None:
        """The gel is free again."""
        if self._began_ns is not None:
            self._lengths_s.append((timestamp_ns - self._began_ns) / 1e9)
        self._began_ns = None
        self._is_lifted, self._again = False, None

    @property
    def limit_s(self) -> float:
        """The length at which a contact is an alarm; at twice this it is a fault."""
        return max(_TIMES * median(self._lengths_s), _LEAST_S) if self._lengths_s else _FIRST_S

    def look(self, timestamp_ns: int) -> tuple[Sentence | None, bool]:
        """Return what is to be said of the contact now, None while it is of a usual length and of one part; and
        whether it is a fault."""
        lasted_s = 0.0 if self._began_ns is None else (timestamp_ns - self._began_ns) / 1e9
        if lasted_s < self.limit_s:
            return self._again, False
        usual = Sentence(f", usually {median(self._lengths_s):.1f} s") if self._lengths_s else ""
        # A text that stays the same is published once.
        text = Sentence(
            f"something has pressed the gel for more than {self.limit_s:.0f} s{usual}; presses over it are not seen "
            "and not counted. Lift the part and look at the gel: wipe off what stays on it"
        )
        return text, lasted_s >= 2 * self.limit_s
