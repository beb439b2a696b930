"""A station with a pedal and a relay board, one step at a time, on the virtual HID bus."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import ANY, Mock

import pytest
from fake_io import FakeRelay
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.clock import ManualClock, SystemClock
from edge.config import load_config
from edge.core.contact.events import PressBegan, PressSettled
from edge.core.digital_io import OutputRule, StationView
from edge.core.errors import ConfigError, DeviceNotFound
from edge.core.press import Press
from edge.core.verdict import decide
from edge.features.outputs.actuator_driver import ActuatorDriver
from edge.features.outputs.stage import Outputs, describe_actuator
from edge.features.reference_press import ReferenceGuard
from edge.features.snapshots import Snapshots
from edge.gateway.build import open_station
from edge.model.inspector import Inspector
from edge.press_stage import PressStage
from edge.store.gel_ledger import GelRecord

ANDON = """
[[actuators]]
plugin = "virtual_hid"
options = { log = "switched.jsonl" }
outputs = [
  { channel = 1, when = ["pass"] },
  { channel = 2, when = ["fail", "halted"] },
  { channel = 3, when = ["fail"], pulse_ms = 200, deadline_ms = 60000 },
  { channel = 4, when = ["stopped"], safe = true },
]
"""
PEDAL = """
[[triggers]]
plugin = "virtual_hid"
action = "trigger"
options = { presses_s = [0.1] }
"""


def outputs_of(driver: Any) -> Outputs:
    outputs = Outputs(print, ManualClock())
    outputs.drivers = [driver]
    return outputs


def pressed(word: str, judged_ns: int) -> Press:
    return Press(decide({"pass": 0.0, "fail": 2.0}[word], 1.0), judged_ns=judged_ns)


class IoStation(SteppedStation):
    """The owner of the board takes its turn after the loop's."""

    def play(self, steps: int | None = None) -> None:
        while not self.has_ended and steps != 0:
            super().play(1)
            self.switch()
            steps = None if steps is None else steps - 1

    def switch(self) -> None:
        for driver in self.find(Outputs).drivers:
            driver.step()

    def step_on_the_pedal(self) -> None:
        """Its script: 0.1 s after it was opened."""
        for _ in range(3):
            self.find(Outputs).readers[0].step()


Make = Callable[..., Path]


@pytest.fixture
def configure(tmp_path: Path, recording: Path, bundle: Path) -> Make:
    """Write the configuration of a station with these tables, in a folder of its own."""

    def make(tables: str, folder: Path = tmp_path, **given: Any) -> Path:
        return station_config(folder, recording, bundle, tables=tables, **given)

    return make


def switched(folder: Path) -> list[tuple[int, bool]]:
    """What the board did, without the first writing of each channel."""
    lines = [json.loads(line) for line in (folder / "switched.jsonl").read_text().splitlines()]
    return [(line["channel"], line["on"]) for line in lines][4:]


def on(folder: Path) -> set[int]:
    """The channels that are on now."""
    return {channel for channel, is_on in dict(switched(folder)).items() if is_on}


def test_the_andon_light_follows_the_verdicts_and_a_fail_is_rejected(tmp_path: Path, configure: Make) -> None:
    """Pass, fail, pass: green, then red with one pulse, then green; at the end the outputs of `stopped`."""
    config = configure(ANDON)
    with IoStation(config) as station:
        station.play()
        assert station.raised == []

    found = switched(tmp_path)
    assert [one for one in found if one[0] == 1] == [(1, True), (1, False), (1, True), (1, False)]
    assert [one for one in found if one[0] == 2] == [(2, True), (2, False)]
    assert [one for one in found if one[0] == 3] == [(3, True), (3, False)]
    assert [one for one in found if one[0] == 4] == [(4, False), (4, True)]


def test_a_late_pulse_is_an_alarm_until_a_person_acknowledges_it(tmp_path: Path, configure: Make) -> None:
    """The board's owner gets its turn after the deadline. The pedal clears the alarm and the red light."""
    text = ANDON.replace("60000", "50") + PEDAL.replace('trigger"', 'acknowledge"')
    with IoStation(configure(text)) as station:
        station.switch()
        while len(station.reports) < 2:
            SteppedStation.play(station, 1)
        station.clock.sleep(0.1)
        station.switch()
        assert str(station.alarm("pulse")).startswith(
            "1 pulses were not given in time; a part may have passed."
        )
        station.turn()
        station.switch()
        assert (2, True) in switched(tmp_path)
        station.step_on_the_pedal()
        station.turn()
        station.switch()

        assert station.raised == []
        assert switched(tmp_path)[-1] == (2, False)
        assert (3, True) not in switched(tmp_path)


@pytest.mark.parametrize("late_s", [0.0, 1.0])
def test_what_is_not_judged_has_no_more_time(tmp_path: Path, configure: Make, late_s: float) -> None:
    """The process gets no time while a press ends that nobody asked for: its part may be gone."""
    text = ANDON.replace('["fail"], pulse', '["rejected"], pulse').replace("60000", "500")
    with IoStation(configure(text, trigger="command", pace=1.0)) as station:
        station.play_until(lambda: station.loop.is_pressed)
        station.read(14)
        station.clock.sleep(late_s)
        station.look()
        assert station.verdicts == ["rejected"]
        station.switch()
        assert (station.alarm("pulse") is not None) == bool(late_s)
    assert ((3, True) in switched(tmp_path)) == (not late_s)


LIFT_NOW = """
[[actuators]]
plugin = "virtual_hid"
options = { log = "switched.jsonl" }
outputs = [
  { channel = 1, when = ["lift"] },
  { channel = 2, when = ["free"] },
  { channel = 3, when = ["unknown"] },
  { channel = 4, when = ["touching", "pressing", "deep_enough", "at_rest", "judged"] },
]
"""


def test_a_relay_says_when_the_part_may_be_lifted(tmp_path: Path, configure: Make) -> None:
    """From the recorded verdict to the free gel, once a press; and never two of the four at once."""
    with IoStation(configure(LIFT_NOW)) as station:
        while not station.has_ended:
            station.play(1)
            assert len(on(tmp_path)) <= 1
            if 1 in on(tmp_path):
                assert station.loop.session is not None
                assert station.loop.session.has_contact
                assert station.loop.session.unrecorded == 0
        assert len(station.reports) == 3
    assert [one for one in switched(tmp_path) if one[0] == 1] == [(1, True), (1, False)] * 3
    assert on(tmp_path) == {3}, "a station that has ended sees nothing"


def test_without_frames_nothing_is_said_of_the_contact(tmp_path: Path, configure: Make) -> None:
    """The sensor goes while a part is held whose verdict is recorded: `lift` does not stay."""
    with IoStation(configure(LIFT_NOW)) as station:
        station.play(1)
        station.play_until(lambda: on(tmp_path) == {1})
        station.turn()
        station.switch()
        assert on(tmp_path) == {1}
        station.clock.sleep(0.3)
        station.turn()
        station.switch()
        assert on(tmp_path) == {3}


def test_a_frame_that_waited_while_the_process_was_frozen_tells_nothing_of_the_contact(
    tmp_path: Path, bundle: Path
) -> None:
    held = press_recording(tmp_path / "held", 1, motion=Motion(hold=80))
    with IoStation(station_config(tmp_path, held, bundle, pace=1.0, tables=LIFT_NOW)) as station:
        station.play(1)
        station.play_until(lambda: on(tmp_path) == {1})
        station.read(6)
        station.clock.sleep(3)
        station.look()
        station.switch()
        assert station.loop.is_pressed
        assert on(tmp_path) == {3}


def test_a_pass_does_not_outlive_a_time_in_which_the_loop_did_not_look(
    tmp_path: Path, bundle: Path, configure: Make
) -> None:
    """Its disk hung for 2 s: what presses now may be another part."""
    held = press_recording(tmp_path / "held", 1, motion=Motion(hold=80))
    with IoStation(station_config(tmp_path, held, bundle, pace=1.0, tables=ANDON)) as station:
        station.play(1)
        station.play_until(lambda: on(tmp_path) == {1})
        station.read(38)
        station.look()
        station.turn()
        station.switch()
        assert station.loop.is_pressed
        assert on(tmp_path) == set()


class Slow(PressStage):
    """Takes long to judge a press, or to record it."""

    is_awaited = True

    def __init__(self, where: str) -> None:
        self.where, self.clock = where, ManualClock()

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        self.clock.sleep(2.0 * (self.where == "judge"))
        return press

    def record(self, press: Press, gel: GelRecord) -> None:
        self.clock.sleep(2.0 * (self.where == "record"))


@pytest.mark.parametrize("where", ["judge", "record"])
def test_no_pass_and_no_lift_come_of_a_turn_that_took_long(
    tmp_path: Path, configure: Make, where: str
) -> None:
    """The detector, or the disk, hung for 2 s: what presses now may be another part, which a robot would lift."""
    slow = Slow(where)
    with IoStation(configure(LIFT_NOW.replace("free", "pass")), {"slow": slow}) as station:
        slow.clock = station.clock
        station.play_until(lambda: len(station.reports) == 1)
        assert station.verdicts == ["pass"]
        assert not on(tmp_path) & {1, 2}


def test_a_frame_that_waited_shows_no_pass(tmp_path: Path, configure: Make) -> None:
    """The detector hung, and the sensor is silent since: what waited meanwhile is older than half a second."""
    slow = Slow("judge")
    with IoStation(configure(ANDON, pace=1.0), {"slow": slow}) as station:

        def hang(_: float) -> None:
            slow.clock = ManualClock()  # once
            station.read(3)
            station.clock.sleep(0.6)

        slow.clock = Mock(sleep=hang)
        station.play(1)
        while not station.reports:
            station.read(1)
            station.look()
        station.switch()
        assert station.verdicts == ["pass"]
        assert 1 not in on(tmp_path)


def test_a_pass_is_shown_only_when_it_is_recorded_and_a_fail_at_once(tmp_path: Path, configure: Make) -> None:
    """While the database refuses, no press is published as a pass, and no part is lifted; the gate still rejects."""
    config = configure(ANDON.replace('["stopped"], safe = true', '["lift"]'))
    with IoStation(config) as station, station.refusing("presses"):
        station.play()

        assert station.loop.session is not None
        assert station.loop.session.unrecorded
        assert (4, True) not in switched(tmp_path)
        assert (1, True) not in switched(tmp_path)
        assert (2, True) in switched(tmp_path)
        assert (3, True) in switched(tmp_path)


def test_no_light_shows_the_verdict_of_an_earlier_press(tmp_path: Path, configure: Make) -> None:
    """The pass light goes out when the next press begins, and comes on with its own verdict."""
    lit: list[tuple[bool, bool]] = []
    with IoStation(configure(ANDON)) as station:
        while not station.has_ended:
            station.play(1)
            if station.loop.session is not None and len(station.reports) == 1:
                lit.append((station.loop.session.has_contact, switched(tmp_path)[-1:] == [(1, True)]))
    held = [is_lit for has_contact, is_lit in lit[-30:] if has_contact]
    assert lit[3] == (True, True), "the first press, judged and still held"
    assert (False, True) in lit, "the gel is free, and the light stays on"
    assert False in held, "the next press is held, and not judged yet"


def test_a_verdict_does_not_outlive_the_state_ready() -> None:
    """Halted and ready again: nothing was judged since, so nothing is shown."""
    relay = FakeRelay(clock := ManualClock())
    rules = [OutputRule(1, frozenset({"pass"})), OutputRule(2, frozenset({"fail"}))]
    driver = ActuatorDriver(relay.open, rules, clock, print, print, watchdog_ns=10**12)
    io = outputs_of(driver)
    for verdict, channel in (("pass", 1), ("fail", 2)):
        io.judge(pressed(verdict, 1), None, ANY)
        io.record(pressed(verdict, 1), ANY)
        for state, on in (("ready", {channel}), ("halted", set()), ("ready", set())):
            io.show(StationView(state))
            driver.step()
            assert relay.on == on, (verdict, state)


def test_a_pass_that_is_recorded_after_a_halt_is_not_shown(
    tmp_path: Path, bundle: Path, configure: Make
) -> None:
    """The database refuses a press, and the sensor is away for a second meanwhile: another part may press now."""
    held = press_recording(tmp_path / "held", 1, motion=Motion(hold=40))
    config = station_config(tmp_path, held, bundle, pace=1.0, tables=ANDON, faults=["stall@48:1"])
    with IoStation(config) as station:
        with station.refusing("presses"):
            station.play_until(lambda: station.loop.is_halted)
            while station.parts.acquisition.status.frames < 52:
                station.read(1)
                while (frame := station.parts.acquisition.next(0)) is not None:
                    station.loop.step(frame)
        station.turn()
        station.switch()
        assert station.verdicts == ["pass"]
        assert station.loop.is_pressed
        assert on(tmp_path) == set()


def test_a_pass_that_is_recorded_after_the_next_press_began_is_not_shown() -> None:
    """The database was slow: the light would be the other part's."""
    relay = FakeRelay(clock := ManualClock())
    driver = ActuatorDriver(
        relay.open, [OutputRule(1, frozenset({"pass"}))], clock, print, print, watchdog_ns=10**12
    )
    io = outputs_of(driver)
    io.judge(pressed("pass", 1), None, ANY)
    io.see(PressBegan(0, 0))
    io.record(pressed("pass", 1), ANY)
    io.show(StationView("ready"))
    driver.step()
    assert relay.on == set()


def test_a_pedal_asks_for_the_verdict(tmp_path: Path, configure: Make) -> None:
    """With trigger = "command" only the held press is scored that the pedal asks for."""
    config = configure(PEDAL, trigger="command")
    with IoStation(config) as station:
        station.play_until(lambda: station.loop.session is not None and station.loop.session.has_contact)
        station.play(6)
        assert station.reports == []
        station.step_on_the_pedal()
        station.play()

    assert station.verdicts == ["pass", "rejected", "rejected"]


def test_a_pedal_without_a_press_is_in_the_log(configure: Make, caplog: pytest.LogCaptureFixture) -> None:
    """No one waits for an answer, so the reason is there, before the first frame and after it."""
    config = configure(PEDAL)
    with IoStation(config) as station:
        station.step_on_the_pedal()
        station.turn()
        assert "the trigger gave no verdict: no frame has arrived" in caplog.text


def test_an_unplugged_board_is_an_alarm(tmp_path: Path, configure: Make) -> None:
    """With its name and what to do; it is cleared when the board is back."""
    with IoStation(configure(UNPLUGGED)) as station:
        station.switch()
        assert str(station.alarm("actuator")).startswith(
            "virtual_hid: no relay board is plugged in; check its cable"
        )
        station.clock.sleep(10)
        station.switch()
        station.turn()
        station.switch()
        assert station.raised == []


WHOLE = ANDON.replace('["fail"],', '["fail", "unsure", "rejected", "error"],')
UNPLUGGED = ANDON.replace("log =", "unplugged_s = [0, 5], log =")


def test_the_check_before_the_start_looks_for_the_board(configure: Make) -> None:
    """What is there, by name, with a warning of a gate that lets parts through; what is not, with the next step."""

    def found(tables: str) -> str:
        return describe_actuator(load_config(configure(tables)).actuators[0])

    assert found(ANDON) == (
        "USBRelay8 at virtual/relay; warning: the pulse on channel 3 leaves out unsure, rejected, error: a reject "
        "gate lets these parts through; add them to `when`"
    )
    assert found(WHOLE) == "USBRelay8 at virtual/relay"
    with pytest.raises(DeviceNotFound, match="nothing for 'virtual_hid' is plugged in; check the cable"):
        found(UNPLUGGED)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ("deadline_ms = 60000", "blink_ms = 500"),
            "the output on channel 3 has a pulse and a deadline, or neither",
        ),
        (("channel = 3", "channel = 1"), "channel 1 gives a pulse, so it has one output alone"),
        (('["fail", "halted"]', '["red"]'), "outputs.1.when.0"),
        (
            ('"virtual_hid"', '"virtual_hdi"'),
            "no actuators plugin is named 'virtual_hdi'; did you mean 'virtual_hid'",
        ),
        (("log =", "logs ="), "actuators.0.options"),
    ],
)
def test_a_wrong_table_is_refused_at_its_place(configure: Make, change: tuple[str, str], words: str) -> None:
    assert change[0] in ANDON
    with pytest.raises(ConfigError, match=words):
        load_config(configure(ANDON.replace(*change)))


def test_faults_of_several_devices_are_one_alarm() -> None:
    """The text names each; it is cleared with the last one."""
    said: list[tuple[str, str | None]] = []
    outputs = Outputs(lambda alarm, text: said.append((alarm, text)), ManualClock())
    outputs.note_fault("actuator", "b", "gone")
    outputs.note_fault("actuator", "a", "stuck")
    outputs.note_fault("actuator", "b", None)
    outputs.note_fault("actuator", "a", None)

    assert [text for _, text in said] == ["b: gone", "a: stuck; b: gone", "a: stuck", None]


def test_the_pulse_of_a_pass_waits_for_the_database_and_that_of_a_fail_does_not() -> None:
    """Each is given once. A pass that is recorded after a later fail is not shown: the lights are the newest
    press's."""
    io = outputs_of(driver := Mock())
    io.judge(pressed("pass", 100), None, ANY)
    driver.pulse.assert_not_called()
    io.judge(pressed("fail", 200), None, ANY)
    io.record(pressed("pass", 100), ANY)
    io.show(StationView("ready"))
    io.record(pressed("fail", 200), ANY)

    assert [call.args[0] for call in driver.pulse.call_args_list] == ["fail", "pass"]
    assert driver.show.call_args.args[0].verdict == "fail"


def test_a_running_gateway_switches_and_leaves_outputs_of_stopped(tmp_path: Path, configure: Make) -> None:
    """With its threads, from the start to the end of a recording: the last writing is that of `stopped`."""
    config = load_config(configure(ANDON))
    with open_station(config, SystemClock()) as gateway:
        gateway.run(threading.Event())

    lines = [json.loads(line) for line in (tmp_path / "switched.jsonl").read_text().splitlines()]
    last = {line["channel"]: line["on"] for line in lines}
    assert last == {1: False, 2: False, 3: False, 4: True}


def test_no_light_and_no_state_waits_for_work_in_the_background(
    tmp_path: Path, configure: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pass is shown, a reload and a snapshot take long, and the station ends: outputs and state are those of
    `stopped` before anybody waits for either."""
    seen: list[tuple[set[int], str]] = []
    (stop := threading.Event()).set()
    with IoStation(configure(ANDON + '[commands]\nunsigned = ["snapshot"]\n')) as station:
        station.play_presses(1)
        assert switched(tmp_path)[-1] == (1, True)
        for worker in (station.parts.selection.worker, station.find(Snapshots).worker):
            monkeypatch.setattr(
                worker, "close", lambda: seen.append((on(tmp_path), station.said("state")["state"]))
            )
        station.loop.turn_until(stop)

    assert seen == [({4}, "stopped"), ({4}, "stopped")]


def test_a_master_piece_switches_no_light_and_no_gate(tmp_path: Path, configure: Make) -> None:
    """Pass, then a reference press that fails, then pass: the red light stays off, and no pulse is given."""
    with IoStation(configure(ANDON + '[[reference.pieces]]\nname = "M1"\n')) as station:
        station.play_presses(1)
        station.find(ReferenceGuard).request("M1")
        station.play()
        words = [report.word for report in station.reports]

    assert words == ["pass", "reference", "pass"]
    assert station.verdicts[1] == "fail"
    assert [channel for channel, on in switched(tmp_path) if on and channel in (2, 3)] == []
