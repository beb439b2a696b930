"""The owner of a pedal, on the test's own clock and without its thread."""

import threading

import pytest
from fake_io import Changes, FakePedal, FixedBackoff, run

from edge.clock import ManualClock
from edge.features.outputs.trigger_reader import TriggerReader

MS = 1_000_000


class Bench:
    """A reader of a pedal, the times of its presses in milliseconds, and its faults."""

    def __init__(self, *changes: tuple[float, bool]) -> None:
        self.clock = ManualClock(0)
        self.pedal = FakePedal(self.clock, *changes)
        self.presses: list[int] = []
        self.faults = Changes()
        self.reader = TriggerReader(
            self.pedal.open,
            self.clock,
            lambda: self.presses.append(self.clock.monotonic_ns() // MS),
            self.faults.say,
            debounce_ns=40 * MS,
            backoff=FixedBackoff(),
        )

    def run(self, seconds: float) -> None:
        run(self.reader, self.clock, seconds)


def test_a_press_is_reported_once_after_the_debounce_time() -> None:
    """Held for a second with a bounce at each end; then again."""
    bench = Bench(
        (500, True), (505, False), (508, True), (1500, False), (1503, True), (1506, False), (2000, True)
    )
    bench.run(3)

    assert bench.presses == [548, 2040]
    assert bench.faults == []


def test_a_read_of_a_pedal_that_rests_ends_in_a_quarter_of_a_second() -> None:
    """So long `close` waits, and so often it is looked whether the pedal is there."""
    bench = Bench()
    bench.reader.step()

    assert bench.clock.monotonic_ns() == 250 * MS


def test_a_pedal_that_vanished_in_silence_is_noticed_and_opened_again() -> None:
    """It reads as unchanged, so presence is polled; presses count again after the return."""
    bench = Bench((5000, True))
    bench.run(0.5)
    bench.pedal.silent = True
    bench.run(1)
    assert bench.faults == ["pedal is gone; plug it in again"]
    bench.pedal.silent = False
    bench.run(5)

    assert bench.faults[-1] is None
    assert bench.pedal.openings > 1
    assert bench.presses == [5040]


def test_a_pedal_that_is_lost_while_down_gives_no_press_when_it_is_back() -> None:
    """Nothing is known of what happened in between."""
    bench = Bench((450, True))
    bench.run(0.45)
    bench.pedal.plugged_in = False
    bench.run(0.1)
    bench.pedal.plugged_in = True
    bench.run(5)

    assert bench.presses == []


def test_a_missing_pedal_is_tried_again_with_pauses() -> None:
    """Not in a busy loop."""
    bench = Bench()
    bench.pedal.plugged_in = False

    assert bench.reader.step() == 1.0
    assert bench.reader.step() == 1.0
    assert bench.faults == ["no pedal is plugged in"]


def test_the_owner_thread_releases_the_pedal() -> None:
    """Closing during a read hangs in hidapi, so the owner closes; closing again is harmless."""
    bench = Bench()
    bench.reader.start()
    bench.reader.close()
    bench.reader.close()

    assert bench.pedal.closings == bench.pedal.openings


def test_a_pedal_that_does_not_return_keeps_no_station_from_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is left as it is: only its owner may close it."""
    monkeypatch.setattr("edge.features.outputs.trigger_reader.CLOSE_S", 0.1)
    bench, is_inside, may_return = Bench(), threading.Event(), threading.Event()

    def hang(deadline_ns: int) -> None:
        is_inside.set()
        may_return.wait()

    monkeypatch.setattr(bench.pedal, "read", hang)
    bench.reader.start()
    is_inside.wait()
    bench.reader.close()
    assert bench.pedal.closings == 0
    may_return.set()


def test_a_driver_with_a_defect_is_an_alarm_and_is_tried_again() -> None:
    """Not a thread that ends in silence."""
    bench = Bench((5000, True))
    bench.run(0.5)
    bench.pedal.error = KeyError("defect")
    bench.run(0.3)
    assert bench.faults == ["its driver failed: KeyError('defect'); see the log"]
    bench.pedal.error = None
    bench.run(5)

    assert bench.faults[-1] is None
    assert bench.presses == [5040]


def test_a_pedal_that_fails_to_close_is_opened_again() -> None:
    """A library may fail to close what is gone; its owner would end in silence, and the pedal would be dead."""

    def fail() -> None:
        raise OSError("no such device")

    bench = Bench((5000, True))
    bench.run(0.5)
    bench.pedal.plugged_in, bench.pedal.close = False, fail  # type: ignore[method-assign]
    bench.run(0.3)
    assert bench.faults == ["the pedal is gone"]
    bench.pedal.plugged_in = True
    bench.run(5)

    assert bench.faults[-1] is None
    assert bench.presses == [5040]
