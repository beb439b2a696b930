"""The hand that presses parts on the sensor, and the pictures that the camera then takes."""

import random
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import repeat

import cv2
import numpy as np
from numpy.typing import NDArray
from station import gel, jpeg

SIZE = (160, 120)
"""That of the contact view, so nothing is scaled: a simulated camera is not what is tried."""
Phase = tuple[float, str]
"""Depth, 0 to 1, and what is on the gel: `sound`, `dented` or `glaring`."""
FREE: Phase = (0.0, "sound")
NOT_SETTLED = {"rejected"}
WAYS = ("steady", "slow", "hesitating", "brief", "long", "hard")
HARD = 3.0
"""So much deeper than other presses is a hard one."""
ROBOT_WAITS_S = 2.5
"""For the word of the station; then it lifts."""
TAKES_FRAMES = 4
"""So many frames before it is pressed a part is seen; the one before is seen until then."""
SLIPS_AFTER, SLIPPED = 22, 1.3
"""So many presses later the stop has slipped, and parts lie so much deeper."""
MARKS = (*((left, top) for left in (56, 80, 100) for top in (36, 72)), (92, 56))
"""Left and top of what has damaged a gel: together they hide more of a press than may be hidden."""
PATIENCE = 0.9
"""The share of people who wait half a second more for a station that is not ready."""


@dataclass
class MadePress:
    """A press of the hand. why: the faults while it was made or recorded; with one it may be lost, never doubled."""

    number: int
    begin_ns: int
    what: str
    way: str = "steady"
    end_ns: int = 0
    may_count: bool = False
    """It was made while the disk refused, so it may count on the gel without a row."""
    must_count: bool = False
    """It was made on a full disk, and counts on the gel although the process was killed."""
    is_asked: bool = True
    """The station judges by itself, or a person asked for the verdict."""
    part: str = ""
    """Which it is, where the hand takes parts of several kinds."""
    master_ns: int = 0
    """It is of the master piece, which was asked for then."""
    is_taken: bool = False
    """People call it good although it is dented, and a bundle that passes it may take over."""
    is_others: bool = True
    """Another sensor was plugged in all the time."""
    why: set[str] = field(default_factory=set)

    @property
    def is_bad(self) -> bool:
        """It must never pass."""
        return self.what != "sound" and not (self.is_taken and self.what == "dented")

    @property
    def words(self) -> set[str]:
        """The verdicts that it may have without any fault."""
        word = {"sound": "pass", "dented": "fail", "glaring": "error"}[self.what]
        if not self.is_asked:
            return NOT_SETTLED
        taken = {"pass"} if word == "fail" and not self.is_bad else set[str]()
        if self.way == "hard":
            return {word, "fail", "error", *NOT_SETTLED, *taken}
        return {word, *NOT_SETTLED, *taken} if self.way == "brief" else {word, *taken}


def draw_gel(rng: np.random.Generator, depth: float, what: str) -> NDArray[np.uint8]:
    """Draw BGR uint8 (120, 160, 3). glaring: so bright a place that the detector's score is not a number."""
    if depth < 0:
        return np.zeros((SIZE[1], SIZE[0], 3), np.uint8)  # covered: nothing is seen
    picture = cv2.resize(gel(rng, depth, what == "dented"), SIZE, interpolation=cv2.INTER_AREA)
    if what == "glaring":
        cv2.circle(picture, (75, 50), 9, (250, 250, 250), cv2.FILLED)
    return np.asarray(picture, np.uint8)


@cache
def pictures(phase: Phase, *, is_marked: bool = False) -> Sequence[bytes]:
    """JPEGs of one phase, each with other noise: so many that none comes again within the eight that the station
    remembers, also where it looks at one of seven; of a covered sensor they are all alike."""
    rng = np.random.default_rng(200 + round(100 * phase[0]) + len(phase[1]))
    drawn: dict[bytes, None] = {}
    while len(drawn) < (61 if phase[0] >= 0 else 1):
        drawn[jpeg(_mark(draw_gel(rng, *phase), is_marked=is_marked))] = None
    return tuple(drawn)


def _mark(picture: NDArray[np.uint8], *, is_marked: bool) -> NDArray[np.uint8]:
    for left, top in MARKS if is_marked else ():
        place = picture[top : top + 4, left : left + 4]
        place[:] = np.maximum(place, 70) - 70
    return picture


class Hand:
    """Presses one part after the other. period_s: of the camera's frames, for each phase is one frame."""

    def __init__(self, rng: random.Random, period_s: float) -> None:
        self._rng, self._period_s = rng, period_s
        self.presses: list[MadePress] = []
        self.most_presses = 0
        self.may_lift: Callable[[], bool] | None = None
        """What a robot looks at; None for a hand."""
        self.lifted_at_word = 0
        self.lain: MadePress | None = None
        """The part that was put on a gel before that was learnt, until somebody says so."""
        self.dents = 0
        """So many of the next parts are dented."""
        self.takes_dents = False
        """People call dented parts good, and a shadow passes them that may take over."""
        self.is_marked = False
        """The gel is damaged."""
        self.marked_ns: list[int] = []
        """When it was damaged, or is whole again."""
        self.is_slow = False
        """Most of its presses take long until they rest."""
        self.parts: Sequence[str] = ()
        """The kinds of part that it takes; empty where the station is told which comes."""
        self.part = ""
        """Of the part that lies there: it is pressed now, or next."""
        self.master_ns = 0
        """The next press is of the master piece, which was asked for then."""
        self._was_off = False
        self._phase = FREE
        self._phases: deque[Phase] = deque(repeat(FREE, round(2.2 / period_s)))

    @property
    def press(self) -> MadePress | None:
        """The press that is made now."""
        return self.presses[-1] if self.presses and not self.presses[-1].end_ns else None

    @property
    def is_done(self) -> bool:
        """All presses are made, and the gel is free."""
        return len(self.presses) >= self.most_presses and self.press is None

    @property
    def is_pressing_soon(self) -> bool:
        """The gel is free, and not for long."""
        return self.press is None and len(self._phases) < 8

    @property
    def is_down(self) -> bool:
        """The part lies as deep as it will; the tiny detector sees no dent of one that is being lifted."""
        return self._phase[0] >= 1.0

    @property
    def depth(self) -> float:
        """How deep the part lies now."""
        return self._phase[0]

    @property
    def free_s(self) -> float:
        """The gel is free for so long from now on, where it is not pressed."""
        return len(self._phases) * self._period_s

    def move(self, now_ns: int, is_ready: bool) -> Phase:
        """Go on by one frame. is_ready: the station says so; otherwise most people wait for it."""
        if not self._phases:
            if len(self.presses) >= self.most_presses:
                return FREE
            if not is_ready and self._rng.random() < PATIENCE:
                self.wait(0.5)
            else:
                self._begin(now_ns)
        phase, press = self._phases.popleft(), self.press
        self._phase = phase
        if press and self.may_lift is not None and phase[0] >= 1.0 and press.way != "brief":
            self._hold(press, phase, now_ns)
        if press and phase == FREE:
            press.end_ns = now_ns
        if self.press is None and len(self._phases) == TAKES_FRAMES:
            self.take_part()
        return phase

    def _hold(self, press: MadePress, phase: Phase, now_ns: int) -> None:
        """A robot holds the part until it may lift it."""
        assert self.may_lift is not None
        while self._phases[0] == phase:
            self._phases.popleft()
        is_on, was_off = self.may_lift(), self._was_off
        self._was_off |= not is_on  # a board that is unplugged may stay on
        if is_on and was_off:
            self.lifted_at_word += 1
        elif now_ns - press.begin_ns < ROBOT_WAITS_S * 10**9:
            self._phases.appendleft(phase)

    def hold(self, seconds: float) -> None:
        """Let the part lie for this long, as deep as it is now."""
        self._phases.extendleft(repeat(self._phase, round(seconds / self._period_s)))

    def lie(self, now_ns: int, seconds: float) -> None:
        """Put a part down at once, for so long."""
        self.lain = MadePress(len(self.presses), now_ns, "sound", "long", part=self.part)
        self.presses.append(self.lain)
        down = repeat((1.0, "sound"), round(seconds / self._period_s))
        self._phases = deque(
            ((0.5, "sound"), *down, (0.3, "sound"), *repeat(FREE, round(3 / self._period_s)))
        )

    def wait(self, seconds: float) -> None:
        """Leave the gel free for this long, from the end of the press on."""
        self._phases.extend(repeat(FREE, round(seconds / self._period_s)))

    def take_part(self) -> None:
        """Take the next part."""
        if self.parts:
            self.part = self._rng.choice(self.parts)

    def _begin(self, now_ns: int) -> None:
        what = self._rng.choices(("sound", "dented", "glaring"), (77, 20, 3))[0]
        what, self.dents = "dented" if self.dents else what, max(0, self.dents - 1)
        way = self._rng.choices(WAYS, (30, 15, 41, 4, 6, 4) if self.is_slow else (70, 8, 8, 4, 6, 4))[0]
        self._was_off = False
        if self.master_ns:
            what, way = "sound", "steady"
        self.presses.append(
            MadePress(len(self.presses), now_ns, what, way, part=self.part, master_ns=self.master_ns)
        )
        self.master_ns, self.presses[-1].is_taken = 0, self.takes_dents
        rests = SLIPPED if self.presses[-1].number >= SLIPS_AFTER else 1.0
        self._phases.extend((rests if depth == 1.0 else depth, what) for depth in self._depths(way))
        self._phases.extend(repeat(FREE, self._frames(0.35, 0.75, 4)))

    def _depths(self, way: str) -> Iterator[float]:
        """Depths from the first touch to the lift."""
        if way == "brief":
            yield from (0.5, *repeat(1.0, self._frames(0.25, 0.32, 2)), 0.3)
            return
        yield 0.5
        if way == "slow":
            steps = self._frames(0.6, 1.6, 5)
            yield from (round(0.4 + 0.6 * step / steps, 1) for step in range(steps))
        elif way == "hesitating":
            yield from repeat(0.6, self._frames(0.12, 0.2, 2))
        least_s, most_s = (1.5, 2.5) if way in ("long", "hard") else (0.5, 0.75)
        yield from repeat(HARD if way == "hard" else 1.0, self._frames(least_s, most_s, 5))
        yield 0.3

    def _frames(self, least_s: float, most_s: float, fewest: int) -> int:
        return max(fewest, round(self._rng.uniform(least_s, most_s) / self._period_s))
