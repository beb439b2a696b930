"""Which frames are looked at by their compressed size: of a press that has its verdict, and of the free gel."""

from itertools import count

import cv2
import numpy as np
import pytest
from ball_frames import PROFILE, frames
from press_films import random_film

from edge.core.contact import press_detector
from edge.core.contact.press_detector import HeldPress, IdleSizes, PressDetector
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
    lead, held, presses = [0.0] * 60, [1.0] * 25, 2
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


@pytest.mark.parametrize("fps", [10, 18.75, 30, 60])
def test_chance_adds_few_looks_at_the_free_gel(fps: float) -> None:
    """Sizes of noise alone: at most 1.3 times the looks at every 0.15 s."""
    sizes, rng, looks, last_ns = IdleSizes(), np.random.default_rng(5), [0, 0], [-(10**9)] * 2
    for number in range(20_000):
        now_ns = round(number * 1e9 / fps)
        is_record = sizes.is_record(int(rng.normal(10_000, 40)), now_ns)
        for k, is_woken in enumerate((False, is_record)):
            if is_woken or now_ns - last_ns[k] >= 0.15e9:
                looks[k], last_ns[k] = looks[k] + 1, now_ns
    assert looks[0] < looks[1] < 1.3 * looks[0]


@pytest.mark.parametrize(
    ("before", "size", "is_record"),
    [
        ([100, 104, 102], 105, True),
        ([100, 104, 102], 99, True),
        ([100, 104, 102], 104, False),
        ([90, *[102] * 10], 91, True),
        ([102] * 10, 102, False),
        ([], 100, False),
    ],
    ids=["larger", "smaller", "as one before", "as one long ago", "never changes", "first"],
)
def test_a_record_is_beyond_the_last_half_second(before: list[int], size: int, is_record: bool) -> None:
    sizes = IdleSizes()
    for number, earlier in enumerate(before):
        sizes.is_record(earlier, number * 54_000_000)
    assert sizes.is_record(size, len(before) * 54_000_000) is is_record


def phases(depths: list[float]) -> list[str]:
    detector = PressDetector(PROFILE)
    return [detector.feed(frame).phase for frame in frames(depths)]


def test_a_contact_that_begins_is_said_with_its_first_frame() -> None:
    """Not at the next look at the free gel; `start` is every place within the interval of looks."""
    for start in range(60, 64):
        assert phases([*[0.0] * start, *[0.3] * 3])[start] == "touching"


def test_what_touches_after_a_release_is_said_and_begins_no_press() -> None:
    """As foam that springs back: less than a tenth of the last press, within three seconds."""
    after = phases([*[0.0] * 60, *[1.0] * 20, *[0.0] * 10, *[0.02] * 12, *[0.0] * 6])
    assert set(after[86:90]) == {"free"}
    assert set(after[91:102]) == {"touching"}
    assert set(after[103:]) == {"free"}


def test_what_touches_is_not_free_when_the_recovery_is_over() -> None:
    """A light press that begins within three seconds of a release, and outlasts them."""
    after = phases([*[0.0] * 60, *[1.0] * 20, *[0.0] * 40, *[0.02] * 60, *[0.0] * 6])
    assert after[121] == "touching"
    assert "free" not in after[121:180]


def test_a_contact_that_flickers_is_looked_at_in_every_frame() -> None:
    """As at the edge of a soft part: the next frame may show it again."""
    depths = [*[0.0] * 60, 0.3, 0.0, 0.3, 0.3]
    assert phases(depths)[60:] == ["touching", "free", "touching", "touching"]


@pytest.mark.parametrize("start", range(4))
def test_every_frame_is_looked_at_once_something_begins_to_show(start: int) -> None:
    """A slow touch shows too little for the size of a JPEG: at a look it has grown. What stays is not grown."""
    detector = PressDetector(PROFILE)
    depths = [*[0.0] * (60 + start), *[0.004] * 40]
    seen = [detector.feed(frame).seen is not None for frame in frames(depths)][60 + start :]
    first = seen.index(True)
    assert all(seen[first : first + 4])
    assert sum(seen[20:]) < 15


def test_a_light_contact_that_flickers_is_not_free() -> None:
    """It falls below the area of a touch for a frame, and shows less at once; a moment later it is free."""
    after = phases([*[0.0] * 60, 0.3, 0.004, 0.3, 0.3, *[0.0] * 6])
    assert after[60:64] == ["touching", "touching", "touching", "touching"]
    after = phases([*[0.0] * 60, 0.3, *[0.004] * 12])
    assert after[61:63] == ["touching", "touching"]
    assert set(after[66:]) == {"free"}


def test_a_press_that_shows_no_area_is_over_with_that_frame() -> None:
    """A narrow one is over after two, for its area may come and go."""
    assert phases([*[0.0] * 60, *[1.0] * 20, 0.0])[-1] == "free"
    assert phases([*[0.0] * 60, *[0.04] * 20, 0.0])[-1] != "free"


@pytest.mark.parametrize(
    ("depth", "said"), [(0.1, "over it"), (0.2, "over it"), (0.5, "decided"), (1.0, "decided")]
)
def test_a_part_over_what_was_taken_for_a_press_is_said(depth: float, said: str) -> None:
    """As over a hair, or over a mark that went: both are one press, whose verdict is not the part's."""
    shown = phases([*[0.0] * 60, *[depth] * 25, *[1.0] * 15, *[0.0] * 8])
    assert shown[84] == "decided"
    assert set(shown[85:100]) == {said}
    assert shown[-1] == "free"
