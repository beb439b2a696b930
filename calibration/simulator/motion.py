"""The motion of one press in time: the depth of the part and the sliding speed of the gel at every frame."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["Moment", "Motion"]

Seconds = Annotated[float, Field(ge=0, le=60)]
MovingSeconds = Annotated[float, Field(gt=0, le=60)]

Phase = Literal["idle", "approach", "press", "settle", "hold", "lift"]

# A gel yields a little more after the robot has stopped: 3 % of the depth, with this time constant (assumed).
_CREEP = 0.03
_CREEP_S = 0.06
# Sideways speed at the end of the stroke; it decays while the press settles (assumed).
_SLIDE_MM_S = 3.0


@dataclass(frozen=True)
class Moment:
    """One frame's moment."""

    time_s: float
    """Seconds since the press's first frame."""
    phase: Phase
    depth: float
    """Share of the commanded depth, 0 to 1."""
    slide_mm_s: float = 0.0
    """Sideways speed of the gel."""
    since_release_s: float = 0.0
    """Time since the previous press was released."""


class Motion(BaseModel):
    """The phases of one press in seconds: no contact, approach, settling, hold, lift.

    `idle_s` of free gel precede the first press, `tail_s` follow the last.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    idle_s: Seconds = 1.5
    approach_s: Seconds = 0.3
    press_s: MovingSeconds = 0.15
    settle_s: Seconds = 0.15
    hold_s: MovingSeconds = 0.35
    lift_s: MovingSeconds = 0.1
    tail_s: Seconds = 0.5

    def count_frames(self, fps: float) -> int:
        """Count the frames of one press: the same for every press."""
        total = self.approach_s + self.press_s + self.settle_s + self.hold_s + self.lift_s
        return max(5, round(total * fps))

    def moments(self, fps: float) -> Iterator[Moment]:
        """Every frame of one press, in order."""
        return (self._at(k / fps) for k in range(self.count_frames(fps)))

    def _at(self, time_s: float) -> Moment:
        t = time_s - self.approach_s
        if t <= 0:
            return Moment(time_s, "approach", 0.0, since_release_s=time_s)
        if t < self.press_s:
            return Moment(time_s, "press", _eased(t / self.press_s) * (1 - _CREEP), _SLIDE_MM_S)
        t -= self.press_s
        if t < self.settle_s:
            left = math.exp(-t / _CREEP_S)
            return Moment(time_s, "settle", 1 - _CREEP * left, _SLIDE_MM_S * left)
        t -= self.settle_s
        if t < self.hold_s:
            return Moment(time_s, "hold", 1.0)
        t -= self.hold_s
        return Moment(time_s, "lift", 1 - _eased(min(1.0, t / self.lift_s)), _SLIDE_MM_S / 2)


def _eased(t: float) -> float:
    """0 to 1 without a jerk."""
    return t * t * (3 - 2 * t)
