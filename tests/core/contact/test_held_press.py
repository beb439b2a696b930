"""A press that has its verdict is not looked at in every frame, and its lift is seen in the same frame as before."""

from itertools import count

import cv2
import numpy as np
import pytest
from ball_frames import PROFILE, frames
from press_films import random_film

from edge.core.contact import press_detector
from edge.core.contact.press_detector import HeldPress, PressDetector
from edge.core.contact.table import State
from edge.core.imaging.decode import decode_view
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.sensor_profile import SensorProfile

Events = list[tuple[str, int]]


def found(shown: list[CameraFrame], monkeypatch: pytest.MonkeyPatch, *, every: bool) -> tuple[Events, int]:
    """The events with their times, and how many frames were decoded. every: each frame of a held press is."""
    decoded = count()

    def decode(frame: CameraFrame, profile: SensorProfile) -> np.ndarray:
        next(decoded)
        return decode_view(frame, profile)

    detector = PressDetector(PROFILE)
    with monkeypatch.context() as patch:
        patch.setattr(press_detector, "decode_view", decode)
        if every:
            patch.setattr(HeldPress, "is_as_before", lambda held, size: False)
        looks = [detector.feed(frame) for frame in shown]
    events = [
        (type(event).__name__, getattr(event, "timestamp_ns", 0)) for look in looks for event in look.events
    ]
    return events, next(decoded)


@pytest.mark.parametrize("lifted_frames", [1, 2, 3, 4])
def test_a_short_lift_ends_a_press_as_before(lifted_frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """From three frames on, which is what a release takes, the next press is another one."""
    lead, held, presses = [0.0] * 60, [1.0] * 25, 4
    shown = list(frames([*lead, *([*held, *([0.0] * lifted_frames)] * presses), *([0.0] * 10)]))
    before, every = found(shown, monkeypatch, every=True)
    after, some = found(shown, monkeypatch, every=False)
    assert after == before
    assert sum(name == "PressBegan" for name, _ in after) == (presses if lifted_frames > 2 else 1)
    assert some < (0.75 if lifted_frames > 2 else 1) * every


@pytest.mark.parametrize("seed", [1002, 1003, 1018])
def test_events_of_films_are_the_same(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """At 30 and 60 frames a second, and for a soft part at 10 whose size does not tell."""
    shown = [
        CameraFrame(
            cv2.imencode(".jpg", np.rint(view[..., ::-1]))[1].tobytes(), 10**9 + round(t * 1e9), number
        )
        for number, (t, view) in enumerate(random_film(seed).frames())
        if t < 12
    ]
    before, every = found(shown, monkeypatch, every=True)
    after, some = found(shown, monkeypatch, every=False)
    assert after == before
    assert sum(name == "PressSettled" for name, _ in after) > 1
    assert some <= every


def held(free: list[int], pressed: int) -> HeldPress:
    press = HeldPress()
    for size in free:
        press.look(State.NO_CONTACT, size, is_settled=False)
    press.look(State.CONTACT, pressed, is_settled=True)
    return press


def test_a_size_on_its_way_back_is_looked_at() -> None:
    press = held([1000, 1002], 1100)
    assert [press.is_as_before(size) for size in (1100, 1120, 1080, 1070, 1001, 1140)] == [True] * 3 + [
        False
    ] * 3


@pytest.mark.parametrize(
    ("free", "pressed"),
    [([1000, 1002], 1005), ([1000, 1040], 1100), ([1000, 1200], 1100), ([], 1100)],
    ids=["hardly larger", "no more than the free gel varies", "between the free gel's", "free gel not seen"],
)
def test_a_size_that_does_not_tell_is_not_used(free: list[int], pressed: int) -> None:
    assert not held(free, pressed).is_as_before(pressed)


def test_another_state_ends_it() -> None:
    """The size of a press that is lifted, or begins again, says nothing until there is a verdict."""
    press = held([1000, 1002], 1100)
    press.look(State.RELEASE, 1100, is_settled=False)
    press.look(State.CONTACT, 1100, is_settled=False)
    assert not press.is_as_before(1100)
