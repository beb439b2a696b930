"""The motion of one press in time: the depth of the part and the sliding speed of the gel at every frame."""

import math
from dataclasses import dataclass
from typing import Literal

__all__ = ["Moment", "Phase", "PressMotion"]

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


@dataclass(frozen=True)
class PressMotion:
    """Durations of the phases in seconds, and the frame rate."""

    approach_s: float
    press_s: float
    settle_s: float
    hold_s: float
    lift_s: float
    fps: float

    @property
    def frames(self) -> int:
        """Frames of one press: the same for every press."""
        total = self.approach_s + self.press_s + self.settle_s + self.hold_s + self.lift_s
        return max(5, round(total * self.fps))

    def moments(self) -> tuple[Moment, ...]:
        """Every frame of one press, in order."""
        return tuple(self._at(k / self.fps) for k in range(self.frames))

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
