"""The handshake with a PLC, without a clock: which press answers which trigger, and what is never shown."""

from collections.abc import Callable
from typing import Any

import pytest
from handshake_bench import TIMEOUT_S, WATCHDOG_S, Bench, S
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from edge.core.digital_io import LOOP_S, State, StationView
from edge.core.handshake import Code, Trigger, check_trigger


def test_a_handshake_from_the_trigger_to_the_next() -> None:
    """Ready; busy with its id; done with the result of its press; ready again, and nothing is left of it."""
    bench = Bench()
    assert (bench.seen.is_ready, bench.result) == (True, ("idle", 0, None, Code.NONE))
    assert bench.trigger(7) is Code.NONE
    assert (bench.seen.is_ready, bench.result) == (False, ("busy", 7, None, Code.NONE))
    bench.press("pass")
    assert (bench.seen.is_ready, bench.result) == (False, ("done", 7, "pass", Code.NONE))
    assert (bench.seen.press_id, bench.seen.score_ratio, bench.seen.gel_left_percent) == ("P1", 0.5, 42)
    bench.wait(3600)
    assert bench.result == ("done", 7, "pass", Code.NONE), "it stays until it is acknowledged"
    bench.machine.acknowledge(bench.now_ns)
    assert (bench.seen.is_ready, bench.result) == (True, ("idle", 0, None, Code.NONE))
    assert (bench.seen.press_id, bench.seen.score_ratio) == ("", None)


STORIES: dict[str, Callable[[Bench], Any]] = {
    "it began before": lambda b: (b.begin(), b.trigger(7), b.judge("pass"), b.record()),
    "the gel was touched before": lambda b: (b.look(True), b.trigger(7), b.press("pass")),
    "seen late": lambda b: (b.trigger(7, is_behind=True), b.press("pass"), b.machine.reach(7)),
    "not recorded": lambda b: (b.trigger(7), b.begin(), b.judge("pass")),
    "another one is recorded": lambda b: (b.trigger(7), b.begin(), b.judge("pass"), b.record("P0")),
    # As with a press that was a master piece's when it began.
    "without a begin": lambda b: (b.trigger(7), b.judge("pass"), b.record()),
}


def held_back(bench: Bench) -> None:
    """The sensor's bus gives the frames of before the trigger after it."""
    before_ns = bench.now_ns
    bench.wait(1)
    bench.trigger(7)
    bench.look(True)
    bench.machine.begin(bench.now_ns, before_ns)
    bench.judge("pass")
    bench.record()


@pytest.mark.parametrize("given", [*STORIES.values(), held_back], ids=[*STORIES, "held back"])
def test_what_does_not_answer_a_trigger(given: Callable[[Bench], None]) -> None:
    """It stays busy, and ends as an error in time."""
    bench = Bench()
    given(bench)
    assert bench.result == ("busy", 7, None, Code.NONE)
    bench.wait(TIMEOUT_S)
    assert bench.result == ("done", 7, "error", Code.TIMED_OUT)
    bench.record()
    assert bench.result == ("done", 7, "error", Code.TIMED_OUT), "too late"


def test_the_next_press_answers_where_one_had_begun() -> None:
    """The gel has been free since the trigger."""
    bench = Bench()
    STORIES["it began before"](bench)
    bench.lift()
    bench.press("fail", "P2")
    assert (bench.result, bench.seen.press_id) == (("done", 7, "fail", Code.NONE), "P2")


@pytest.mark.parametrize("state", ["starting", "halted", "stopped"])
@pytest.mark.parametrize("steps", range(4))
def test_a_station_that_does_not_inspect_ends_it_without_a_pass(state: State, steps: int) -> None:
    """At each step, also when the pass is shown. What failed stays failed."""
    bench = Bench()
    for step in [lambda: bench.trigger(7), bench.begin, lambda: bench.judge("pass"), bench.record][
        : steps + 1
    ]:
        step()
    bench.show(state)
    assert bench.result == ("done", 7, "error", Code.HALTED)
    bench.show("ready")
    bench.record()
    assert bench.result == ("done", 7, "error", Code.HALTED), "it does not come back"

    bench.machine.acknowledge(bench.now_ns)
    bench.lift()
    bench.trigger(8)
    bench.press("fail", "P2")
    bench.show(state)
    assert bench.result == ("done", 8, "fail", Code.NONE)


def test_a_loop_that_hangs_is_no_station() -> None:
    """Nobody shows its state any more: no pass is shown, no contact is known, and no trigger is taken."""
    bench = Bench()
    bench.trigger(7)
    bench.press("pass")
    bench.machine.show(StationView("ready", contact="lift"), 42, bench.now_ns)
    bench.now_ns += S
    assert bench.seen.station == StationView("ready", contact="lift")
    bench.now_ns += S // 10
    assert bench.seen.station == StationView("ready"), "another part may lie there"
    bench.now_ns += round((LOOP_S - 1) * S)
    assert bench.seen.station == StationView("halted")
    assert bench.result == ("done", 7, "error", Code.HALTED)
    bench.machine.acknowledge(bench.now_ns)
    assert bench.trigger(8) is Code.NOT_READY


def test_the_time_ends_it_where_the_loop_hangs() -> None:
    """A read alone is enough."""
    bench = Bench()
    bench.trigger(7)
    bench.now_ns += 3600 * S
    assert bench.seen.step == "done"
    assert bench.seen.word == "error"


def test_an_acknowledgement_while_busy_ends_it_and_its_press_answers_nothing() -> None:
    """Neither the next trigger."""
    bench = Bench()
    bench.trigger(7)
    bench.begin()
    bench.machine.acknowledge(bench.now_ns)
    assert bench.trigger(8) is Code.NONE
    bench.judge("pass")
    bench.record()
    assert bench.result == ("busy", 8, None, Code.NONE)


def test_two_presses_begin_and_the_first_has_no_verdict() -> None:
    """The second may be another piece's."""
    bench = Bench()
    bench.trigger(7)
    bench.begin()
    bench.begin()
    assert bench.result == ("done", 7, "error", Code.NOT_JUDGED)


def test_the_verdict_of_another_part_is_an_error() -> None:
    bench = Bench()
    bench.trigger(7, "B/1")
    bench.press("pass")
    assert bench.result == ("done", 7, "error", Code.OTHER_PART)
    bench.machine.acknowledge(bench.now_ns)
    bench.trigger(8, "A/1")
    bench.press("pass", "P2")
    assert bench.result == ("done", 8, "pass", Code.NONE)


@pytest.mark.parametrize(
    ("given", "code"),
    [
        (lambda b: (b.trigger(7), b.trigger(8)), Code.BUSY),
        (lambda b: (b.trigger(7), b.press("fail"), b.trigger(8)), Code.NOT_ACKNOWLEDGED),
        (lambda b: (b.trigger(7), b.machine.acknowledge(b.now_ns), b.trigger(7)), Code.ID_TWICE),
        (lambda b: (b.show("halted"), b.trigger(7)), Code.NOT_READY),
        (lambda b: (b.trigger(0),), Code.BAD_VALUE),
        (lambda b: (b.trigger(2**32),), Code.BAD_VALUE),
    ],
)
def test_a_trigger_that_is_refused(given: Callable[[Bench], Any], code: Code) -> None:
    """With its code, which stays until one is taken; what was busy or done stays that."""
    bench = Bench()
    assert given(bench)[-1] is code
    assert bench.seen.refused is code
    bench.show("ready")
    bench.machine.acknowledge(bench.now_ns)
    assert bench.seen.refused is code
    assert bench.trigger(9) is Code.NONE
    assert bench.seen.refused is Code.NONE


@pytest.mark.parametrize("text", ["ä", "\n", "x" * 33, "a\0b"])
def test_a_text_that_is_refused(text: str) -> None:
    for trigger in (Trigger(1, text), Trigger(1, "", text)):
        refusal = check_trigger(trigger)
        assert refusal is not None
        assert refusal.code is Code.BAD_VALUE
    assert check_trigger(Trigger(1, "A 17-b/3", "x" * 32)) is None


def test_a_plc_that_gives_no_sign_of_life() -> None:
    """Triggers are refused before the first and after the last one; a pass is withdrawn, and does not come back."""
    bench = Bench(watchdog_s=WATCHDOG_S)
    assert bench.trigger(7) is Code.NO_BEAT
    assert not bench.machine.is_silent(bench.now_ns), "it may still come"
    bench.machine.beat(bench.now_ns)
    assert bench.trigger(7) is Code.NONE
    bench.press("pass")
    assert bench.seen.is_pass
    bench.wait(1.1 * WATCHDOG_S)
    assert bench.machine.is_silent(bench.now_ns)
    assert bench.result == ("done", 7, "error", Code.NO_BEAT)
    bench.machine.beat(bench.now_ns)
    assert bench.result == ("done", 7, "error", Code.NO_BEAT)
    bench.machine.acknowledge(bench.now_ns)
    assert bench.trigger(8) is Code.NONE
    bench.wait(1.1 * WATCHDOG_S)
    assert bench.result == ("done", 8, "error", Code.NO_BEAT)


def test_by_command_the_press_that_is_held_answers() -> None:
    """It has begun before; where nothing is pressed the result is an error at once."""
    bench = Bench(is_command=True)
    bench.begin()
    bench.trigger(7)
    bench.judge("pass")
    bench.record()
    assert bench.result == ("done", 7, "pass", Code.NONE)
    bench.machine.acknowledge(bench.now_ns)
    bench.trigger(8)
    bench.machine.miss(Code.NOTHING_PRESSED, bench.now_ns)
    assert bench.result == ("done", 8, "error", Code.NOTHING_PRESSED)


def test_an_error_and_a_rejection_are_done_at_once() -> None:
    """Only a pass waits for the database."""
    for word, code in (("error", Code.NOT_JUDGED), ("rejected", Code.NONE), ("unsure", Code.NONE)):
        bench = Bench()
        bench.trigger(7)
        bench.begin()
        bench.judge(word)
        assert bench.result == ("done", 7, word, code)


def test_a_pass_of_one_place_is_no_pass() -> None:
    """It waits for the database, too."""
    bench = Bench()
    bench.trigger(7)
    bench.begin()
    bench.judge("place")
    assert bench.seen.step == "busy"
    bench.record()
    assert bench.result == ("done", 7, "place", Code.NONE)
    assert not bench.seen.is_pass


class AnyOrder(RuleBasedStateMachine):
    """Every order of what the PLC and the loop may do. The oracle knows of each press when it began, and what it is."""

    def __init__(self) -> None:
        super().__init__()
        self.bench = Bench(watchdog_s=5)
        self.bench.machine.beat(self.bench.now_ns)
        self.presses: dict[str, dict[str, Any]] = {}
        self.open: str | None = None
        self.next_id, self.trigger_ns, self.number, self.is_behind = 1, 0, 0, False

    @rule(trigger_again=st.booleans(), is_behind=st.booleans())
    def trigger(self, trigger_again: bool, is_behind: bool) -> None:
        number = self.next_id - 1 if trigger_again else self.next_id
        if self.bench.trigger(number, is_behind=is_behind) is Code.NONE:
            assert number == self.next_id, "an id was taken twice"
            self.next_id, self.trigger_ns = self.next_id + 1, self.bench.now_ns
            self.is_behind = is_behind

    @precondition(lambda self: self.is_behind)
    @rule()
    def catch_up(self) -> None:
        self.bench.machine.reach(self.next_id - 1)
        self.trigger_ns, self.is_behind = self.bench.now_ns, False

    @rule()
    def acknowledge(self) -> None:
        self.bench.machine.acknowledge(self.bench.now_ns)

    @rule()
    def beat(self) -> None:
        self.bench.machine.beat(self.bench.now_ns)

    @rule(seconds=st.sampled_from([0.01, 0.5, 4.0, 9.0]))
    def wait(self, seconds: float) -> None:
        self.bench.wait(seconds)

    @rule(state=st.sampled_from(["ready", "ready", "halted", "starting"]))
    def change(self, state: State) -> None:
        self.bench.show(state)

    @precondition(lambda self: self.open is None)
    @rule(is_part=st.booleans())
    def begin(self, is_part: bool) -> None:
        self.number += 1
        self.open = f"P{self.number}"
        self.bench.now_ns += 1
        self.presses[self.open] = {
            "began": self.bench.now_ns,
            "is_part": is_part,
            "word": None,
            "recorded": False,
        }
        self.bench.look(True)
        if is_part:
            self.bench.machine.begin(self.bench.now_ns)

    @precondition(lambda self: self.open is not None)
    @rule(word=st.sampled_from(["pass", "pass", "fail", "unsure", "rejected", "error"]))
    def judge(self, word: str) -> None:
        assert self.open is not None
        press, press_id = self.presses[self.open], self.open
        press["word"], press["state"] = word, self.bench.state
        if press["is_part"]:
            self.bench.judge(word, press_id)
        self.open = None

    @rule()
    def lift(self) -> None:
        self.bench.lift()

    @precondition(lambda self: any(one["word"] and not one["recorded"] for one in self.presses.values()))
    @rule(data=st.data())
    def record(self, data: st.DataObject) -> None:
        waiting = [key for key, one in self.presses.items() if one["word"] and not one["recorded"]]
        press_id = data.draw(st.sampled_from(waiting))
        self.presses[press_id]["recorded"] = True
        if self.presses[press_id]["is_part"]:
            self.bench.record(press_id)

    @invariant()
    def shows_only_what_is_so(self) -> None:
        view = self.bench.seen
        assert (view.step == "idle") == (view.trigger_id == 0)
        assert (view.step == "done") == (view.word is not None)
        assert view.trigger_id in (0, self.next_id - 1), "another id"
        if view.word in ("pass", "fail", "unsure", "rejected"):
            press = self.presses[view.press_id]
            assert press["word"] == view.word
            assert press["is_part"]
            assert press["began"] > self.trigger_ns, "the press began before the trigger"
            assert not self.is_behind, "the press was seen in a frame of before the trigger"
        if view.is_pass:
            assert self.presses[view.press_id]["recorded"]
            assert self.bench.state == "ready"
            assert self.bench.machine.has_beat(self.bench.now_ns)


AnyOrder.TestCase.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
TestAnyOrder = AnyOrder.TestCase
