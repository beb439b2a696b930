"""Does a press rest, and which of its frames is taken? One frame in numbers, and a window of the last few.

Rest is judged over a time, not over frames: a frame is compared with the one `settle_s` before it, so that a slow ramp
looks as slow at 60 frames a second as at 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from edge.core.contact.mask import Touch
from edge.core.contact.settings import ContactSettings

__all__ = ["CLEARLY_INVERSE", "DEPTH_NOISE", "Observation", "Window", "is_moving"]

# Frames come slightly early or late; one that is due after `settle_s` still counts when it is this much early.
_EARLY_SHARE = 0.05
# Frames within this share of the deepest are equally deep.
_DEEPEST_SHARE = 0.03
# A frame that differs from the one before in a smaller share of the touched pixels is as sharp as any.
_CALM_SHARE = 0.05
# Between two frames a press is deeper than in them by no more than its step from frame to frame.
_STEP_SHARE = 0.25
# A rest is foreseen after this share of it: two frame periods of 20 fps. Later misses fewer rests of those that are
# scored in vain, and has less time for the score.
_FORESEEN_SHARE = 0.4
# Of a light press one depth is measured a tenth larger than the next; the strength grows with the square of the depth.
_PEAK_SHARE = 0.1

DEPTH_NOISE: Final = 0.005
"""Sensor noise moves strength and texture by less, in levels over the whole view."""

CLEARLY_INVERSE: Final = -0.7
"""A log ratio of structure (`Relief.gain`): a reference learnt from a pressed gel has more than the free gel."""


@dataclass(frozen=True)
class Observation:
    """One frame in numbers.

    strength, texture: how much the imprint differs from the reference, coarse and fine, levels; both grow with depth.
    """

    timestamp_ns: int
    sequence: int
    touch: Touch | None
    """None while there is no reference to compare with."""
    change: float
    """Share of the view's pixels that differ from the view at rest while learning, and from the view `settle_s` ago
    while something presses; 1 where there is none."""
    motion: float
    """The change against the frame before."""
    is_black: bool = False
    relief: float = 0.0
    """Share of the view with an imprint's fine structure."""
    strength: float = 0.0
    texture: float = 0.0
    imprint: float = 0.0
    """Log ratio of the view's structure to the reference's (`Relief.gain`)."""
    place: Touch | None = None
    """The touched area by relief too, where it is too light for one by itself."""

    @property
    def area(self) -> float:
        return 0.0 if self.touch is None else self.touch.area

    @property
    def contact(self) -> Touch:
        """What is touched, by relief where the area is too light."""
        return self.place or self.touch or Touch(0.0)

    @property
    def depth(self) -> float:
        """All of it together; it grows with depth."""
        return self.strength + self.texture

    @property
    def depths(self) -> tuple[float, float]:
        """The values that grow with depth."""
        return self.strength, self.texture


def is_moving(seen: Observation, settings: ContactSettings) -> bool:
    """Tell whether the view moves: a contact's worth of change without a reference, else a share of what is touched."""
    if seen.touch is None:
        return seen.change > settings.on_area
    return seen.change > settings.still_share * _touched(seen, settings)


@dataclass(frozen=True)
class Window:
    """The frames of one press that may still be chosen: the anchor, which is `settle_s` old, and all after it."""

    frames: tuple[Observation, ...] = ()
    deepest: tuple[float, float] = (0.0, 0.0)
    """The largest depths of the frames before the anchor."""
    peak: Observation | None = None
    """The deepest frame that was sharp, for a press that is lifted before it rests."""

    @property
    def _all(self) -> tuple[Observation, ...]:
        """The oldest first."""
        is_apart = self.peak is not None and self.peak not in self.frames
        return (self.peak, *self.frames) if self.peak is not None and is_apart else self.frames

    @property
    def candidates(self) -> frozenset[int]:
        """The sequences of the frames that may still be chosen."""
        return frozenset(frame.sequence for frame in self._all)

    def anchor(self, now_ns: int, settings: ContactSettings) -> Observation | None:
        """Return the newest frame that is `settle_s` old, if the press lasts so long."""
        latest_ns = now_ns - round(settings.settle_s * (1 - _EARLY_SHARE) * 1e9)
        return next((frame for frame in reversed(self.frames) if frame.timestamp_ns <= latest_ns), None)

    def after(self, seen: Observation, settings: ContactSettings) -> "Window":
        """Add a frame, and leave out those that are too old."""
        anchor = self.anchor(seen.timestamp_ns, settings)
        first_ns = 0 if anchor is None else anchor.timestamp_ns
        old = [frame for frame in self.frames if frame.timestamp_ns < first_ns]
        new = tuple(frame for frame in self.frames if frame.timestamp_ns >= first_ns)
        deepest = _largest([self.deepest, *(frame.depths for frame in old)])
        return Window((*new, seen), deepest, self._peak(seen, settings))

    def _peak(self, seen: Observation, settings: ContactSettings) -> Observation | None:
        """The last frame, now that the one after it is known, where it is sharp and the deepest of such."""
        if len(self.frames) < 2:
            return self.peak
        before, last = self.frames[-2:]
        touched = max(last.area, last.relief)
        is_sharp = (
            touched >= settings.on_area
            and last.imprint > CLEARLY_INVERSE
            and min(before.depth, seen.depth) >= (1 - _STEP_SHARE) * last.depth
            and max(last.motion, seen.motion) <= settings.still_share * touched
        )
        return last if is_sharp and (self.peak is None or last.depth >= self.peak.depth) else self.peak

    def is_growing(self, settings: ContactSettings) -> bool:
        """Tell whether the newest frames are deeper than all before them; true as well while there are none before."""
        anchor = self.anchor(self.frames[-1].timestamp_ns, settings)
        return anchor is None or self._has_grown(anchor, settings)

    def is_at_rest(self, settings: ContactSettings) -> bool:
        """Compare the newest frame with the anchor: hardly changed, no deeper, and not being lifted."""
        if not self.frames:
            return False
        seen = self.frames[-1]
        anchor = self.anchor(seen.timestamp_ns, settings)
        if anchor is None or is_moving(seen, settings):
            return False
        if len(self.frames) == 2 and sum(self.deepest) < (1 - _STEP_SHARE) * anchor.depth:
            return False
        return self._rests_since(anchor, settings)

    def foresee(self, since_ns: int, settings: ContactSettings) -> Observation | None:
        """Choose as at the end of a rest that began with the first frame since which the newest one rests; None before
        it has lasted for `_FORESEEN_SHARE` of `settle_s`."""
        seen = self.frames[-1]
        latest_ns = seen.timestamp_ns - round(settings.settle_s * _FORESEEN_SHARE * 1e9)
        if seen.motion > settings.still_share * _touched(seen, settings):
            return None
        for number, first in enumerate(self.frames):
            if first.timestamp_ns <= latest_ns and self._rests_since(first, settings):
                return replace(self, frames=self.frames[number:]).choose(since_ns, settings)
        return None

    def _rests_since(self, first: Observation, settings: ContactSettings) -> bool:
        """Tell whether the press is no deeper since then, and is not being lifted."""
        is_as_deep = self.frames[-1].depth >= first.depth * (1 - settings.growth_share) - DEPTH_NOISE
        return is_as_deep and not self._has_grown(first, settings)

    def _has_grown(self, since: Observation, settings: ContactSettings) -> bool:
        """Tell whether frames after that one are deeper than it and all before it."""
        early = [frame.depths for frame in self.frames if frame.timestamp_ns <= since.timestamp_ns]
        late = [frame.depths for frame in self.frames if frame.timestamp_ns > since.timestamp_ns]
        before, now = _largest([self.deepest, *early]), _largest(late)
        return any(
            n > b * (1 + settings.growth_share) + DEPTH_NOISE for n, b in zip(now, before, strict=True)
        )

    def choose(self, since_ns: int, settings: ContactSettings) -> Observation:
        """Choose of the deepest frames since then the first that hardly moved, else the one that moved least.

        The first stays the choice while the press rests, so it can be scored before the rest is over.
        """
        frames = [frame for frame in self._all if frame.timestamp_ns >= since_ns] or [self.frames[-1]]
        depth = max(frame.depth for frame in frames)
        deep = [frame for frame in frames if frame.depth >= depth * (1 - _DEEPEST_SHARE)]
        calm = (frame for frame in deep if frame.motion <= _CALM_SHARE * _touched(frame, settings))
        return next(calm, None) or min(reversed(deep), key=lambda frame: frame.motion)

    def choose_peak(self, since_ns: int, strength_peak: float) -> Observation | None:
        """Choose a sharp frame of a press that is over and never rested; None where none since then is as deep as the
        press was. strength_peak: the largest strength of the press, also before an interruption."""
        if self.peak is None or self.peak.timestamp_ns < since_ns:
            return None
        depths = _largest([self.deepest, (strength_peak, 0.0), *(frame.depths for frame in self.frames)])
        return self.peak if self.peak.depth >= (1 - _PEAK_SHARE) * sum(depths) else None


def _touched(seen: Observation, settings: ContactSettings) -> float:
    return max(seen.area, seen.relief, settings.on_area)


def _largest(depths: Sequence[tuple[float, float]]) -> tuple[float, float]:
    return max(strength for strength, _ in depths), max(texture for _, texture in depths)
