"""The owner of a relay board, on the test's own clock and without its thread."""

import threading
from collections.abc import Callable

import pytest
from fake_io import Changes, FakeRelay, FixedBackoff, run
from waiting import wait_until

from edge.clock import ManualClock
from edge.core.digital_io import OutputRule, StationView
from edge.features.outputs.actuator_driver import ActuatorDriver

MS = 1_000_000
RULES = (
    OutputRule(1, frozenset({"pass"})),
    OutputRule(2, frozenset({"fail", "halted"})),
    OutputRule(3, frozenset({"fail"}), pulse_ns=200 * MS, deadline_ns=300 * MS),
    OutputRule(4, frozenset({"ready"}), safe=False),
)
READY = StationView("ready")


class Bench:
    """A driver of a relay, what it reports, and the time."""

    def __init__(self, rules: tuple[OutputRule, ...] = RULES) -> None:
        self.clock = ManualClock()
        self.relay = FakeRelay(self.clock)
        self.faults = Changes()
        self.late: list[str] = []
        self.driver = ActuatorDriver(
            self.relay.open,
            rules,
            self.clock,
            self.faults.say,
            self.late.append,
            watchdog_ns=2_000 * MS,
            backoff=FixedBackoff(),
        )

    def switched(self) -> list[tuple[int, bool]]:
        """What was written, in order."""
        return [(channel, is_on) for _, channel, is_on in self.relay.history]

    def run(self, seconds: float, view: StationView | None = None) -> None:
        """Time passes; with a view the loop is alive all the time."""
        steps = max(1, round(seconds / 0.05))
        for _ in range(steps):
            if view is not None:
                self.driver.show(view)
            run(self.driver, self.clock, seconds / steps)


def test_a_pulse_starts_in_time_and_has_its_length() -> None:
    """On at the next step, off 200 ms later."""
    bench = Bench()
    bench.run(1, READY)
    started = bench.clock.monotonic_ns() // MS
    bench.driver.pulse("fail", bench.clock.monotonic_ns() - 299 * MS)
    bench.run(1, StationView("ready", "fail"))

    assert [one for one in bench.relay.history if one[1] == 3][1:] == [
        (started, 3, True),
        (started + 200, 3, False),
    ]
    assert bench.late == []


@pytest.mark.parametrize(
    ("verdict", "age_ms", "late"),
    [
        ("pass", 0, []),
        ("fail", 301, ["the pulse on channel 3 for 'fail' was not given: it is 1 ms after its deadline"]),
    ],
)
def test_another_verdict_and_a_late_pulse_switch_nothing(verdict: str, age_ms: int, late: list[str]) -> None:
    """Only the verdicts of the output; a late one would hit the next part, and is reported."""
    bench = Bench()
    bench.run(1, READY)
    bench.driver.pulse(verdict, bench.clock.monotonic_ns() - age_ms * MS)
    bench.run(1, READY)

    assert (3, True) not in bench.switched()
    assert bench.late == late


@pytest.mark.parametrize(
    ("hinder", "why"),
    [
        (
            lambda bench: setattr(bench.relay, "write_s", 0.4),
            "100 ms after its deadline, and is switched off at once",
        ),
        (lambda bench: setattr(bench.relay, "plugged_in", False), "not given: the relay is gone"),
        (lambda bench: bench.clock.sleep(2.5), "not given: the station's loop does not answer"),
    ],
    ids=["writing takes 400 ms", "pulled since the last write", "the loop hangs"],
)
def test_a_pulse_that_is_held_up_opens_no_gate_and_is_reported(
    hinder: Callable[[Bench], object], why: str
) -> None:
    bench = Bench()
    bench.run(0.5, READY)
    hinder(bench)
    bench.driver.pulse("fail", bench.clock.monotonic_ns())
    bench.driver.step()

    assert bench.late == [f"the pulse on channel 3 for 'fail' was {why}"]
    assert 3 not in bench.relay.on


def test_a_pulse_while_the_board_is_away_is_reported_at_its_deadline() -> None:
    """Not when the board comes back, and it is not given then."""
    bench = Bench()
    bench.run(1, READY)
    bench.relay.plugged_in = False
    bench.run(2, READY)
    bench.driver.pulse("fail", bench.clock.monotonic_ns())
    bench.run(0.2, READY)
    assert bench.late == []
    bench.run(0.2, READY)
    assert len(bench.late) == 1
    bench.relay.plugged_in = True
    bench.run(5, READY)

    assert (3, True) not in bench.switched()
    assert len(bench.late) == 1


def test_a_board_that_vanished_in_silence_is_noticed_and_opened_again() -> None:
    """Nothing fails, so presence is polled; after the return every output is written again."""
    bench = Bench()
    bench.run(0.5, READY)
    bench.relay.silent = True
    bench.run(1, READY)
    assert bench.faults == ["relay is gone; plug it in again"]
    assert bench.relay.closings >= 1
    bench.relay.silent = False
    before = len(bench.relay.history)
    bench.run(2, READY)

    assert bench.faults[-1] is None
    assert {channel for _, channel, _ in bench.relay.history[before:]} == {1, 2, 3, 4}


def test_a_loop_that_hangs_puts_the_outputs_into_those_of_a_fault() -> None:
    """After 1 s without a sign of life no pass is shown and no contact, for another part may lie there; after 2 s the
    lamp of `halted` is on; with the loop it is as before."""
    bench = Bench((*RULES, OutputRule(3, frozenset({"lift"}))))
    bench.run(1, StationView("ready", "pass", contact="lift"))
    assert bench.relay.on == {1, 3, 4}
    bench.run(0.9)
    assert bench.relay.on == {1, 3, 4}
    bench.run(0.5)
    assert bench.relay.on == {4}
    bench.run(1)

    assert bench.relay.on == {2}
    assert bench.faults == ["the station's loop does not answer; its outputs are in the state `halted`"]
    bench.run(0.5, StationView("ready", "pass"))
    assert bench.relay.on == {1, 4}
    assert bench.faults[-1] is None


def test_a_pulse_does_not_outlast_a_loop_that_hangs() -> None:
    """A gate that is open when the watchdog ends is closed."""
    bench = Bench((OutputRule(3, frozenset({"fail"}), pulse_ns=60_000 * MS, deadline_ns=300 * MS),))
    bench.run(1, READY)
    bench.driver.pulse("fail", bench.clock.monotonic_ns())
    bench.run(1, READY)
    assert bench.relay.on == {3}
    bench.run(2.5)

    assert bench.relay.on == set()


def test_a_driver_with_a_defect_is_an_alarm_and_is_tried_again(caplog: pytest.LogCaptureFixture) -> None:
    """Not a thread that ends in silence: the traceback is in the log, and a pulse that waits is reported."""
    bench = Bench()
    bench.run(0.5, READY)
    bench.relay.error = KeyError("defect")
    bench.driver.pulse("fail", bench.clock.monotonic_ns())
    bench.driver.step()
    assert bench.faults == ["its driver failed: KeyError('defect'); see the log"]
    assert bench.late == ["the pulse on channel 3 for 'fail' was not given: 'defect'"]
    assert "Traceback" in caplog.text
    bench.relay.error = None
    bench.run(2, READY)

    assert bench.faults[-1] is None


def test_a_board_that_fails_to_close_is_opened_again() -> None:
    """A library may fail to close what is gone; the outputs would stay as they are when it is back, a pass light on."""

    def fail() -> None:
        raise OSError("no such device")

    bench = Bench()
    bench.run(0.5, StationView("ready", "pass"))
    bench.relay.plugged_in, bench.relay.close = False, fail  # type: ignore[method-assign]
    bench.run(0.5, StationView("halted"))
    assert bench.faults == ["the relay is gone"]
    bench.relay.plugged_in = True
    bench.run(2, StationView("halted"))

    assert bench.faults[-1] is None
    assert bench.relay.on == {2}


def test_closing_leaves_the_outputs_of_stopped_and_gives_no_pulse() -> None:
    """A pulse that waits is reported."""
    bench = Bench((*RULES[:3], OutputRule(4, frozenset({"stopped"}))))
    bench.run(1, StationView("ready", "pass"))
    bench.driver.pulse("fail", bench.clock.monotonic_ns())
    bench.driver.close()
    bench.driver.close()

    assert bench.relay.on == {4}
    assert bench.late == ["the pulse on channel 3 for 'fail' was not given: the station ends"]
    assert bench.relay.closings == 1


def test_a_channel_that_the_board_does_not_have_is_a_fault() -> None:
    """With both numbers and where to correct it."""
    bench = Bench((OutputRule(8, frozenset({"fail"})),))
    bench.run(0.1, READY)

    assert bench.faults[0] is not None
    assert (
        "has 4 channels, the configuration names channel 8; correct [[actuators.outputs]]" in bench.faults[0]
    )


def test_a_board_that_does_not_return_is_an_alarm_and_keeps_no_station_from_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The owner is inside the driver: the loop says so, and reports the pulses that are not given. Later it goes on."""
    monkeypatch.setattr("edge.features.outputs.actuator_driver.CLOSE_S", 0.1)
    bench, is_inside, may_return = Bench(), threading.Event(), threading.Event()
    bench.driver.start()
    bench.driver.show(READY)
    wait_until(lambda: bench.relay.on == {4})
    bench.relay.called = lambda: (is_inside.set(), may_return.wait())
    bench.driver.show(StationView("ready", "pass"))
    is_inside.wait()
    bench.driver.pulse("fail", bench.clock.monotonic_ns())
    bench.clock.sleep(0.4)
    bench.driver.show(READY)
    assert bench.late == ["the pulse on channel 3 for 'fail' was not given: it is 100 ms after its deadline"]
    assert bench.faults == []
    bench.clock.sleep(1.7)
    bench.driver.show(READY)
    assert bench.faults == ["a call of its driver does not end; its outputs stay as they are"]
    bench.driver.close()
    may_return.set()
    wait_until(lambda: bench.faults[1:] == [None])
    wait_until(lambda: bench.relay.closings == 1)


def test_the_owner_thread_switches_and_ends() -> None:
    """Started and closed: the outputs of `stopped`, and the board is released by its owner. What came before the start
    is no loop that hangs."""
    bench = Bench()
    bench.clock.sleep(3)
    bench.driver.start()
    wait_until(lambda: bench.relay.openings == 1)
    bench.driver.show(READY)
    wait_until(lambda: (4, True) in bench.switched())
    bench.driver.close()

    assert bench.faults == []
    assert bench.relay.openings == 1
    assert bench.relay.closings == 1
    assert bench.relay.on == set()
