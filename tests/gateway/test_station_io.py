"""A station with a pedal and a relay board, one step at a time, on the virtual HID bus."""

import json
import threading
from pathlib import Path
from typing import Any
from unittest.mock import ANY

import pytest
from fake_io import FakeRelay
from station import JSONL, station_config
from stepped_station import SteppedStation

from edge.clock import ManualClock, SystemClock
from edge.config import load_config
from edge.core.contact.events import PressBegan
from edge.core.digital_io import OutputRule, StationView
from edge.core.errors import ConfigError, DeviceNotFound
from edge.core.press import Press
from edge.core.verdict import decide
from edge.features.outputs.actuator_driver import ActuatorDriver
from edge.features.outputs.opening import describe_actuator
from edge.features.outputs.stage import IoAlarms, Outputs
from edge.features.reference_press import ReferenceGuard
from edge.gateway.gateway import Gateway

ANDON = """
[[actuators]]
plugin = "virtual_hid"
options = {{ log = "switched.jsonl" }}
outputs = [
  {{ channel = 1, when = ["pass"] }},
  {{ channel = 2, when = ["fail", "halted"] }},
  {{ channel = 3, when = ["fail"], pulse_ms = 200, deadline_ms = {deadline_ms} }},
  {{ channel = 4, when = ["stopped"], safe = true }},
]
"""
PEDAL = """
[[triggers]]
plugin = "virtual_hid"
action = "{action}"
options = {{ presses_s = [0.1] }}
"""


def outputs_of(driver: Any) -> Outputs:
    return Outputs((), (driver,), IoAlarms(print), ManualClock())


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

    def alarms(self) -> dict[str, str]:
        raised = [
            m for m in self.parts.publisher.retained_state.all() if m.topic.startswith("alarm/") and m.payload
        ]
        return {m.topic.removeprefix("alarm/"): json.loads(m.payload)["text"] for m in raised}


def configured(folder: Path, recording: Path, bundle: Path, text: str, **given: Any) -> Path:
    path = station_config(folder, recording, bundle, sinks=JSONL % (folder / "out") + text, **given)
    path.write_text(path.read_text().replace("{{", "{").replace("}}", "}"))
    return path


def switched(folder: Path) -> list[tuple[int, bool]]:
    """What the board did, without the first writing of each channel."""
    lines = [json.loads(line) for line in (folder / "switched.jsonl").read_text().splitlines()]
    return [(line["channel"], line["on"]) for line in lines][4:]


def test_the_andon_light_follows_the_verdicts_and_a_fail_is_rejected(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """Pass, fail, pass: green, then red with one pulse, then green; at the end the outputs of `stopped`."""
    config = configured(tmp_path, recording, bundle, ANDON.format(deadline_ms=60_000))
    with IoStation(config) as station:
        station.play()
        assert station.alarms() == {}

    found = switched(tmp_path)
    assert [one for one in found if one[0] == 1] == [(1, True), (1, False), (1, True), (1, False)]
    assert [one for one in found if one[0] == 2] == [(2, True), (2, False)]
    assert [one for one in found if one[0] == 3] == [(3, True), (3, False)]
    assert [one for one in found if one[0] == 4] == [(4, False), (4, True)]


def test_a_pulse_that_is_too_late_is_an_alarm_until_a_person_acknowledges_it(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """The board's owner gets its turn after the deadline. The pedal clears the alarm and the red light."""
    text = ANDON.format(deadline_ms=50) + PEDAL.format(action="acknowledge")
    with IoStation(configured(tmp_path, recording, bundle, text)) as station:
        station.switch()
        while len(station.reports) < 2:
            SteppedStation.play(station, 1)
        station.clock.sleep(0.1)
        station.switch()
        assert station.alarms()["pulse"].startswith(
            "1 pulses were not given in time; a part may have passed."
        )
        station.loop.step(None)
        station.switch()
        assert (2, True) in switched(tmp_path)
        station.step_on_the_pedal()
        station.loop.step(None)
        station.switch()

        assert station.alarms() == {}
        assert switched(tmp_path)[-1] == (2, False)
        assert (3, True) not in switched(tmp_path)


def test_a_pass_is_shown_only_when_it_is_recorded_and_a_fail_at_once(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """While the database refuses, no press is published as a pass; the gate still rejects."""
    config = configured(tmp_path, recording, bundle, ANDON.format(deadline_ms=60_000))
    with IoStation(config) as station, station.refusing("presses"):
        station.play()

        assert (1, True) not in switched(tmp_path)
        assert (2, True) in switched(tmp_path)
        assert (3, True) in switched(tmp_path)


def test_no_light_shows_the_verdict_of_an_earlier_press(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """The pass light goes out when the next press begins, and comes on with its own verdict."""
    lit: list[tuple[bool, bool]] = []
    with IoStation(configured(tmp_path, recording, bundle, ANDON.format(deadline_ms=60_000))) as station:
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


def test_a_pedal_asks_for_the_verdict(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """With trigger = "command" only the held press is scored that the pedal asks for."""
    config = configured(tmp_path, recording, bundle, PEDAL.format(action="trigger"), trigger="command")
    with IoStation(config) as station:
        station.play_until(lambda: station.loop.session is not None and station.loop.session.has_contact)
        station.play(6)
        assert station.reports == []
        station.step_on_the_pedal()
        station.play()

    assert [report.result.verdict for report in station.reports] == ["pass", "rejected", "rejected"]


def test_a_pedal_without_a_press_is_in_the_log(
    tmp_path: Path, recording: Path, bundle: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """No one waits for an answer, so the reason is there, before the first frame and after it."""
    config = configured(tmp_path, recording, bundle, PEDAL.format(action="trigger"))
    with IoStation(config) as station:
        station.step_on_the_pedal()
        station.loop.step(None)
        assert "the trigger gave no verdict: no frame has arrived" in caplog.text


def test_an_unplugged_board_is_an_alarm(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """With its name and what to do; it is cleared when the board is back."""
    text = ANDON.format(deadline_ms=100).replace("log =", "unplugged_s = [0, 5], log =")
    with IoStation(configured(tmp_path, recording, bundle, text)) as station:
        station.switch()
        assert station.alarms()["actuator"].startswith(
            "virtual_hid: no relay board is plugged in; check its cable"
        )
        station.clock.sleep(10)
        station.switch()
        station.loop.step(None)
        station.switch()
        assert station.alarms() == {}


def test_the_check_before_the_start_looks_for_the_board(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """What is there, by name; what is not, with the next step."""
    text = ANDON.format(deadline_ms=100)
    there = load_config(configured(tmp_path, recording, bundle, text))
    away = load_config(
        configured(tmp_path / "away", recording, bundle, text.replace("log =", "unplugged_s = [0, 5], log ="))
    )

    whole = configured(
        tmp_path / "whole",
        recording,
        bundle,
        text.replace('["fail"],', '["fail", "unsure", "rejected", "error"],'),
    )

    assert describe_actuator(there.actuators[0]) == (
        "USBRelay8 at virtual/relay; warning: the pulse on channel 3 leaves out unsure, rejected, error: a reject "
        "gate lets these parts through; add them to `when`"
    )
    assert describe_actuator(load_config(whole).actuators[0]) == "USBRelay8 at virtual/relay"
    with pytest.raises(DeviceNotFound, match="nothing for 'virtual_hid' is plugged in; check the cable"):
        describe_actuator(away.actuators[0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ("deadline_ms = 100", "blink_ms = 500"),
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
def test_a_wrong_table_is_refused_with_its_place(
    tmp_path: Path, recording: Path, bundle: Path, change: tuple[str, str], words: str
) -> None:
    """Before anything is opened."""
    text = ANDON.format(deadline_ms=100)
    assert change[0] in text
    with pytest.raises(ConfigError, match=words):
        load_config(configured(tmp_path, recording, bundle, text.replace(*change)))


def test_faults_of_several_devices_are_one_alarm() -> None:
    """The text names each; it is cleared with the last one."""
    said: list[tuple[str, str | None]] = []
    alarms = IoAlarms(lambda alarm, text: said.append((alarm, text)))
    alarms.fault("actuator", "b", "gone")
    alarms.fault("actuator", "a", "stuck")
    alarms.fault("actuator", "b", None)
    alarms.fault("actuator", "a", None)

    assert [text for _, text in said] == ["b: gone", "a: stuck; b: gone", "a: stuck", None]


class Driver:
    """What an owner of a board is asked for."""

    def __init__(self) -> None:
        self.views: list[StationView] = []
        self.pulses: list[str] = []

    def show(self, view: StationView) -> None:
        self.views.append(view)

    def pulse(self, verdict: str, judged_ns: int) -> None:
        self.pulses.append(verdict)


def test_a_pass_that_is_recorded_after_a_later_fail_is_not_shown() -> None:
    """The lights are those of the newest press."""
    driver = Driver()
    io = outputs_of(driver)
    io.judge(pressed("fail", 200), None, ANY)
    io.record(pressed("pass", 100), ANY)
    io.show(StationView("ready"))

    assert driver.views[-1].verdict == "fail"


def test_the_pulse_of_a_pass_waits_for_the_database_and_that_of_a_fail_does_not() -> None:
    """Each is given once."""
    driver = Driver()
    io = outputs_of(driver)
    io.judge(pressed("pass", 100), None, ANY)
    assert driver.pulses == []
    io.record(pressed("pass", 100), ANY)
    io.judge(pressed("fail", 200), None, ANY)
    io.record(pressed("fail", 200), ANY)

    assert driver.pulses == ["pass", "fail"]


def test_a_running_gateway_switches_and_leaves_the_outputs_of_stopped(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """With its threads, from the start to the end of a recording: the last writing is that of `stopped`."""
    config = load_config(configured(tmp_path, recording, bundle, ANDON.format(deadline_ms=60_000)))
    with Gateway.open(config, SystemClock()) as gateway:
        gateway.run(threading.Event())

    lines = [json.loads(line) for line in (tmp_path / "switched.jsonl").read_text().splitlines()]
    last = {line["channel"]: line["on"] for line in lines}
    assert last == {1: False, 2: False, 3: False, 4: True}


def test_a_master_piece_switches_no_light_and_no_gate(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Pass, then a reference press that fails, then pass: the red light stays off, and no pulse is given."""
    config = configured(tmp_path, recording, bundle, ANDON.format(deadline_ms=60_000))
    config.write_text(config.read_text().replace("[store]", '[[reference.pieces]]\nname = "M1"\n[store]'))
    with IoStation(config) as station:
        while not (len(station.reports) == 1 and not station.loop.session.has_contact):
            station.play(1)
        station.find(ReferenceGuard).request("M1")
        station.play()
        words = [report.word for report in station.reports]

    assert words == ["pass", "reference", "pass"]
    assert station.reports[1].result.verdict == "fail"
    assert [channel for channel, on in switched(tmp_path) if on and channel in (2, 3)] == []
