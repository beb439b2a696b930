"""An interruption while something presses is said: a lift and a new press in it count as one press."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from ball_frames import FPS, PROFILE, frames

from edge.clock import ManualClock
from edge.core.contact.events import PressBegan, ReferenceReady
from edge.core.contact.press_detector import PressDetector
from edge.features.sensing_watch import SensingWatch
from edge.store.press_store import Store

FREE, PRESSED = [0.0] * 60, [1.0] * 25
SHORT, LONG = [None] * 12, [None] * 60
BLACK = cv2.imencode(".jpg", np.zeros((120, 160, 3), np.uint8))[1].tobytes()


@pytest.mark.parametrize(
    ("shown", "presses", "said"),
    [
        ([*FREE, *PRESSED, *SHORT, *PRESSED], 1, [0.5]),
        ([*FREE, *PRESSED, *SHORT, *PRESSED, *SHORT, *PRESSED], 1, [0.5]),
        ([*FREE, *PRESSED, *SHORT, 0.0, 0.0, *PRESSED], 1, [0.5]),
        ([*FREE, *PRESSED, *SHORT, *FREE, *PRESSED], 2, [0.5]),
        ([*FREE, *PRESSED, *FREE, *SHORT, *PRESSED], 2, []),
        ([*FREE, *SHORT, *PRESSED, *FREE], 1, []),
        ([*FREE, *PRESSED, *PRESSED], 1, []),
        ([*FREE, *PRESSED, *LONG, *PRESSED], 1, [2.4]),
    ],
    ids=[
        "while pressed",
        "twice in one press",
        "with a new press just after it",
        "lifted after it",
        "between two presses",
        "before a press",
        "none",
        "longer than the sensor's blindness",
    ],
)
def test_an_interrupted_press_is_an_act(
    shown: list[float | None],
    presses: int,
    said: list[float],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The act has the seconds. The first of each press is said, so that a stream that is always interrupted does not
    fill the ledger."""
    detector, began = PressDetector(PROFILE), 0
    with Store(tmp_path / "gelgate.db") as store:
        watch = SensingWatch(Mock(), store, ManualClock())
        for frame in frames(shown):
            look = detector.feed(frame)
            for event in look.events:
                began += isinstance(event, PressBegan)
                watch.see(event)
            watch.look(look)
            watch.turn(None)
        acts = [act for act in store.acts() if act.verb == "not_seen"]
    assert began == presses
    assert sorted(act.arguments["seconds"] for act in acts) == pytest.approx(said, abs=1.5 / FPS)
    assert ("both are one press" in caplog.text) == bool(said)
    assert any("both are one press" in act.arguments["why"] for act in acts) == bool(said)


def test_each_time_without_sight_is_kept_while_the_database_refuses(tmp_path: Path) -> None:
    """The act of a short one does not take the place of a long one that waits, nor the other way round."""
    detector = PressDetector(PROFILE)
    with Store(tmp_path / "gelgate.db") as store:
        watch = SensingWatch(Mock(), store, ManualClock())
        for frame in frames([*FREE, *LONG, *FREE, *PRESSED, *SHORT, *PRESSED, *FREE, *LONG, *FREE]):
            look = detector.feed(frame)
            for event in look.events:
                watch.see(event)
            watch.look(look)
        watch.turn(None)
        acts = [act for act in reversed(store.acts()) if act.verb == "not_seen"]

    assert [act.arguments["seconds"] for act in acts] == pytest.approx([2.4, 0.5, 2.4], abs=0.2)


def test_a_time_without_sight_that_a_start_falls_into_is_kept(tmp_path: Path) -> None:
    """From the first frame on: presses may have been made in it, and nobody has seen the gel before."""
    detector = PressDetector(PROFILE)
    with Store(tmp_path / "gelgate.db") as store:
        watch = SensingWatch(Mock(), store, ManualClock())
        for frame in frames([*FREE, *FREE]):
            is_covered = frame.sequence < len(FREE)
            watch.look(detector.feed(replace(frame, payload=BLACK) if is_covered else frame))
        watch.turn(None)
        acts = [act for act in store.acts() if act.verb == "not_seen"]

    assert [act.arguments["seconds"] for act in acts] == pytest.approx([len(FREE) / FPS])
    assert "blind" in acts[0].arguments["why"]


TOO_SHORT = [*[1.0] * 8, *[0.0] * 8] * 26


@pytest.mark.parametrize(
    ("shown", "is_said", "is_over"),
    [
        ([*TOO_SHORT, *FREE], True, True),
        ([1.0] * 400, True, False),
        ([*FREE, *TOO_SHORT], False, True),
    ],
    ids=["lifts too short to learn from", "a part that lies there", "learnt at the start"],
)
def test_a_free_gel_that_is_never_seen_at_rest_is_an_alarm(
    shown: list[float | None], is_said: bool, is_over: bool, tmp_path: Path
) -> None:
    """After 15 s, and no warning: until it is learnt the station inspects nothing. It ends when it is."""
    earlier, said, faults = PressDetector(PROFILE), list[str | None](), list[str | None]()
    for frame in frames(FREE):
        earlier.feed(frame)
    detector = PressDetector(PROFILE, stored=earlier.tracker.reference)
    with Store(tmp_path / "gelgate.db") as store:
        alarms = Mock(set_fault=lambda _, text: faults.append(text))
        alarms.say = lambda _, text, severity: said.append(text and f"{severity}: {text}")
        watch = SensingWatch(alarms, store, ManualClock())
        for frame in frames(shown):
            look = detector.feed(frame)
            for event in look.events:
                watch.see(event)
            watch.look(look)
    late = "error: the free gel was not seen at rest for more than 15 s"
    assert any((text or "").startswith(late) for text in said) == is_said
    assert (said[-1] is None) == is_over
    assert not any(faults)


@pytest.mark.parametrize(("free_frames", "is_said"), [(0, False), (1, True), (3, False)])
def test_a_lift_that_is_too_short_to_end_a_press_is_an_alarm(
    free_frames: int, is_said: bool, tmp_path: Path
) -> None:
    """Of two parts that follow each other so, the second is neither judged nor counted."""
    detector, said = PressDetector(PROFILE), list[str | None]()
    with Store(tmp_path / "gelgate.db") as store:
        watch = SensingWatch(Mock(say=lambda _, text, severity: said.append(text)), store, ManualClock())
        for frame in frames([*FREE, *PRESSED, *[0.0] * free_frames, *PRESSED, *FREE]):
            look = detector.feed(frame)
            for event in look.events:
                watch.see(event)
            watch.look(look)
    assert any(said) == is_said
    assert said[-1] is None


def test_a_picture_that_comes_and_goes_is_said_with_what_it_shows_meanwhile(tmp_path: Path) -> None:
    """Sight that is lost for good is said with its time instead."""
    look = [PressDetector(PROFILE).feed(frame) for frame in frames(FREE)][-1]
    with Store(tmp_path / "gelgate.db") as store:
        for comes_and_goes, words in ((True, "comes and goes"), (False, "nothing was seen since")):
            alarms = Mock()
            sight = Mock(lost="its picture is black", comes_and_goes=comes_and_goes, seen_ns=0, since_ns=0)
            SensingWatch(alarms, store, ManualClock()).look(replace(look, sight=sight))
            (said,) = alarms.set_blind.call_args.args
            assert words in said
            assert "its picture is black" in said


def test_a_free_gel_that_is_learnt_again_and_not_seen_at_rest_is_an_alarm_again(tmp_path: Path) -> None:
    """As after another gel was mounted: after 15 s that began with it."""
    look = [PressDetector(PROFILE).feed(frame) for frame in frames(FREE)][-1]
    said = list[str | None]()
    with Store(tmp_path / "gelgate.db") as store:
        watch = SensingWatch(Mock(say=lambda _, text, severity: said.append(text)), store, ManualClock())
        watch.see(ReferenceReady(0))
        for seconds in (0, 16, 17, 31, 33):
            if seconds == 17:
                watch.relearn()
            at_ns = seconds * 10**9
            sight = Mock(lost=None, seen_ns=at_ns)
            watch.look(replace(look, timestamp_ns=at_ns, sight=sight))
    assert ["not seen at rest" in (text or "") for text in said] == [False, False, False, False, True]
