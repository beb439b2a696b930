"""A press in which the sensor showed nothing for a moment: what is lifted then may be another part."""

import cv2
import numpy as np
import pytest
from station import gel, jpeg

from edge.core.contact.events import PressBegan, PressNotSettled, PressSettled
from edge.core.contact.press_detector import PressDetector
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.sensor_profile import SensorProfile

FPS = 18.75
SIZE = (320, 240)
PROFILE = SensorProfile("test", SIZE, (0.0, 0.0), SIZE, 1, 15.77)
RNG = np.random.default_rng(4)
BLACK = cv2.imencode(".jpg", np.zeros((240, 320, 3), np.uint8))[1].tobytes()


def unseen(number: int, how: str) -> bytes:
    """A frame that shows nothing: black, or a JPEG whose second half was lost between its markers."""
    if how == "black":
        return BLACK[:2] + b"\xff\xfe\x00\x06" + number.to_bytes(4, "big") + BLACK[2:]
    whole = jpeg(gel(np.random.default_rng(number), 1.0))
    return whole[: len(whole) // 2] + whole[-2:]


@pytest.mark.parametrize("how", ["black", "broken"])
@pytest.mark.parametrize(("frames", "settled"), [(3, True), (100, False)])
def test_a_press_is_not_judged_by_what_was_seen_before_hidden(how: str, frames: int, settled: bool) -> None:
    """It is pressed for four frames, which is too short to rest, then nothing is seen, then it is lifted. Three frames
    are no interruption: it is judged at its peak. In a hundred the part may have been exchanged."""
    detector, events = PressDetector(PROFILE), []
    shown = [*[0.0] * 60, *[1.0] * 4, *[None] * frames, *[0.0] * 12]
    for number, depth in enumerate(shown, 1):
        picture = unseen(number, how) if depth is None else jpeg(gel(RNG, depth))
        events += detector.feed(CameraFrame(picture, round(number * 1e9 / FPS), number)).events

    assert sum(isinstance(event, PressBegan) for event in events) == 1
    verdicts = [event for event in events if isinstance(event, PressSettled | PressNotSettled)]
    assert [isinstance(event, PressSettled) for event in verdicts] == [settled]


@pytest.mark.parametrize(("cut", "fault"), [(3, "black"), (1, "end marker")])
def test_broken_frames_do_not_hide_that_the_sensor_is_blind(cut: int, fault: str) -> None:
    """A slow camera shows black, and every third of its frames, or each, is cut: two seconds after the last picture it
    is lost. No such frame counts as one that shows the gel, and each is counted."""
    detector = PressDetector(PROFILE)
    for number in range(1, 20):
        detector.feed(CameraFrame(jpeg(gel(RNG, 0.0)), number * 143_000_000, number))
    seen_ns = detector.sight.seen_ns
    for number in range(20, 36):
        picture = unseen(number, "black")[: -2 if number % cut == 0 else None]
        detector.feed(CameraFrame(picture, number * 143_000_000, number))
    assert fault in str(detector.sight.lost)
    assert detector.sight.seen_ns == seen_ns
    assert detector.corrupt == 16


def test_a_pause_after_blind_frames_is_as_long_as_nothing_was_seen() -> None:
    """The sensor shows black while it is pressed, then sends nothing for a moment: that moment is not all of it."""
    detector, looks = PressDetector(PROFILE), []
    for number, depth in enumerate([*[0.0] * 60, *[1.0] * 15, *[None] * 60, *[1.0] * 15], 1):
        if not 127 <= number <= 135:
            picture = unseen(number, "black") if depth is None else jpeg(gel(RNG, depth))
            looks.append(detector.feed(CameraFrame(picture, round(number * 1e9 / FPS), number)))

    interruptions_s = [look.interruption_s for look in looks if look.interruption_s]
    assert interruptions_s == pytest.approx([61 / FPS], abs=1.5 / FPS)
