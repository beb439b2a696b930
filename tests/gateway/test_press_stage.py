"""A feature of presses is one stage; tests/plugins has one of another author."""

import json
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar

import pytest
from pydantic import BaseModel, Field
from stepped_station import SteppedStation

from edge import registry
from edge.clock import SystemClock
from edge.config import Config, TriggerTable, load_config
from edge.core.contact.events import PressSettled
from edge.core.errors import ConfigError
from edge.core.press import Press, PressLabel
from edge.gateway.command_table import station_commands
from edge.gateway.features import load_features
from edge.gateway.preflight import preflight
from edge.messaging.alarm_payload import Alarm, AlarmPayload
from edge.messaging.command_payloads import NoArguments
from edge.messaging.sink_worker import RetainedState
from edge.model.inspector import Inspector
from edge.page.server import read_words
from edge.page.shown import Shown
from edge.press_stage import Command, PressStage, StageParts
from edge.store.gel_ledger import GelRecord


def install(monkeypatch: pytest.MonkeyPatch, lamp: str) -> None:
    """Install a package that brings a feature, also of this module, which pytest keeps out of sys.modules."""
    points, load = registry._points, EntryPoint.load
    monkeypatch.setattr(
        EntryPoint, "load", lambda one: globals()[one.attr] if one.module == __name__ else load(one)
    )
    ours = {**points("features"), "lamp": [EntryPoint("lamp", lamp, "gelgate.features")]}
    monkeypatch.setattr(registry, "_points", lambda group: ours if group == "features" else points(group))


def load_with(monkeypatch: pytest.MonkeyPatch, config: Config, lamp: str) -> list[str]:
    """Return the features of a station where another package brings one."""
    install(monkeypatch, lamp)
    return list(load_features(config))


def test_what_is_not_configured_is_not_loaded(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A feature of another package is installed on purpose; it stands before the outputs, which show what it says."""
    few = load_config(config)
    loaded = list(load_features(few))
    assert loaded == [
        "sensing_watch",
        "contact_state",
        "gel_date",
        "gel_proof",
        "shadow",
        "scars",
        "drift",
        "piece",
        "black_box",
        "person_verdicts",
    ]
    more = few.model_copy(update={"triggers": [TriggerTable(plugin="virtual_hid")]})
    assert load_with(monkeypatch, more, "edge.press_stage:PressStage") == [
        *loaded[:-3],
        "lamp",
        "piece",
        "outputs",
        *loaded[-2:],
    ]
    with pytest.raises(ConfigError, match=r"'lamp' of gelgate.features is no class of PressStage"):
        load_with(monkeypatch, few, "math:pi")


class Unprepared(PressStage):
    """Cannot say what it needs."""

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        raise ConfigError("lamp.toml is missing")


class SecondGel(PressStage):
    """Serves a request that every station has."""

    commands = (Command("replace_gel", NoArguments, lambda stage, arguments: {}, "replace it twice"),)


def test_a_feature_that_cannot_be_tried_hides_no_other(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its fault is a finding under its name, and the pedal behind it is tried."""
    install(monkeypatch, f"{__name__}:Unprepared")
    station = load_config(config).model_copy(update={"triggers": [TriggerTable(plugin="virtual_hid")]})
    with preflight(station, SystemClock(), is_start=False) as checked:
        found = {one.part: one.text for one in checked.findings}

    assert found["lamp"] == "lamp.toml is missing"
    assert "trigger virtual_hid" in found


def test_a_request_is_served_by_one(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A feature of another package cannot take the request by which a gel is counted anew."""
    install(monkeypatch, f"{__name__}:SecondGel")

    with pytest.raises(ConfigError, match="the request 'replace_gel' is served twice"):
        station_commands(load_config(config))


@pytest.mark.parametrize(
    ("declared", "sentence"),
    [
        (
            {"gel": Alarm()},
            "the feature 'lamp' declares the alarm 'gel', which is another's; rename it",
        ),
        (
            {"too bright": Alarm()},
            "the feature 'lamp' declares the alarm 'too bright': a topic level has",
        ),
        (["lamp_lost"], "declares the alarms .'lamp_lost'., expected a mapping of each id to an Alarm"),
        ({"lamp_lost": "it is dark"}, "'it is dark'}, expected a mapping of each id to an Alarm"),
    ],
)
def test_an_alarm_is_declared_by_one(
    config: Path, monkeypatch: pytest.MonkeyPatch, declared: object, sentence: str
) -> None:
    """A feature of another package cannot raise or end an alarm of gelgate's; what declares none is refused."""
    monkeypatch.setattr(PressStage, "alarms", declared)
    with pytest.raises(ConfigError, match=sentence):
        load_with(monkeypatch, load_config(config), "edge.press_stage:PressStage")


class Lamp(PressStage):
    """Has one alarm that stays, one that ends by itself, and forgot a third."""

    alarms: ClassVar = {
        "lamp_lost": Alarm("find it", stays=True),
        "lamp_dim": Alarm(),
    }


def test_a_feature_brings_its_alarms(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are cleared at the start, shown with what to do, measured, and acknowledged as gelgate's own."""
    install(monkeypatch, f"{__name__}:Lamp")
    with SteppedStation(config) as station:
        cleared = {message.topic for message in RetainedState().all() if not message.payload}
        assert {"alarm/lamp_lost", "alarm/lamp_dim", "alarm/gel"} <= cleared
        for alarm in ("lamp_lost", "lamp_dim"):
            station.parts.status.say(alarm, "look for the lamp")
        with pytest.raises(ValueError, match="'lamp_dim' ends by itself"):
            station.ask("acknowledge_alarm", alarm="lamp_dim")
        assert station.ask("acknowledge_alarm", alarm="lamp_lost") == {"alarms": ["lamp_dim"]}

        shown = Shown("plant/line1/press2")
        shown.see(AlarmPayload(time_ns=0, alarm="lamp_lost", text="look for it").message())
        assert {"what_to_do": "find it", "can_acknowledge": True}.items() <= shown.station()["alarms"][
            "lamp_lost"
        ].items()
    assert station.alarm("lamp_dim") is None  # the package may be gone at the next start


class Talkative(PressStage):
    """Says something of each press, and says it in German; it also tries what is gelgate's."""

    words: ClassVar = {"de": {"it takes {watts} W": "Bedarf: {watts} W", "pass": "schlecht"}}

    def fields(self, press: Press) -> Mapping[str, object]:
        return {"watts": 5, "verdict": "pass"}


def test_a_feature_speaks_in_result_and_page(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under its name, beside what gelgate says, which it does not change; the check before a start names it."""
    install(monkeypatch, f"{__name__}:Talkative")
    with SteppedStation(config) as station:
        station.play()
        assert station.verdicts == ["pass", "fail", "pass"]
        said = [json.loads(result.encode())["feature"] for result in station.results]
        assert said == [{"lamp": {"watts": 5, "verdict": "pass"}}] * 3

    sentences = read_words("de")["sentences"]
    assert (sentences["it takes {watts} W"], sentences["pass"]) == ("Bedarf: {watts} W", "gut")
    assert "it takes {watts} W" not in read_words("it")["sentences"]
    with preflight(load_config(config), SystemClock(), is_start=False) as checked:
        found = {one.part: one.text for one in checked.findings}
    assert found["feature"] == "lamp of an unknown package takes part in every press"


class Forgetful(PressStage):
    """Raises an alarm that it does not declare."""

    alarm: Callable[[str, str | None], None]

    def record(self, press: Press, gel: GelRecord) -> None:
        self.alarm("lamp_hot", "it is hot")


def test_an_undeclared_alarm_stops_no_inspection(config: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The log has it once, lights and `stats` show it until it is over, and a fault of that name halts the station."""
    forgetful = Forgetful()
    with SteppedStation(config, stages={"lamp": forgetful}) as station:
        status = station.parts.status
        forgetful.alarm = status.say
        station.play()
        station.loop.publish_stats()

        assert len(station.verdicts) == 3
        assert [record.getMessage() for record in caplog.records if record.levelname == "ERROR"] == [
            "alarm lamp_hot: it is hot (declare it in `alarms` of its feature)"
        ]
        assert station.said("alarm/lamp_hot") is None
        assert station.raised == ["lamp_hot"]

        status.say("lamp_hot", None)
        assert station.raised == []
        status.set_fault("lamp_hot", "it burns")
        assert status.view().state == "halted"


def test_an_installation_without_our_features_says_so(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code that was updated in place knows features that its installation does not list."""
    station = load_config(config)
    monkeypatch.setattr(registry, "_points", lambda group: {})

    with pytest.raises(ConfigError, match=r"without its features sensing_watch, .*install it again"):
        load_features(station)


class Told(PressStage):
    """Notes the calls of a press."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        self.calls.append("begin")
        return label

    def admit(self, press: Press) -> Press:
        self.calls.append(f"admit {press.is_decided}")
        return press

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        self.calls.append(f"judge {press.word}")
        return press

    def record(self, press: Press, gel: GelRecord) -> None:
        self.calls.append(f"record {press.word}")


def test_the_calls_of_a_press_come_in_order(config: Path) -> None:
    """Three presses, the second one dented, each from its beginning to its row."""
    with SteppedStation(config, stages={"told": (told := Told())}) as station:
        station.play()
    assert told.calls == [
        call
        for word in ("pass", "fail", "pass")
        for call in ("begin", "admit False", f"judge {word}", f"record {word}")
    ]


class LampOptions(BaseModel, extra="forbid", frozen=True):
    watts: int = Field(default=5, ge=1)


class LampWithOptions(PressStage):
    Options = LampOptions

    def __init__(self, options: LampOptions) -> None:
        self.options = options

    @classmethod
    def open(cls, parts: StageParts) -> "LampWithOptions":
        return cls(parts.options)


@pytest.mark.parametrize(
    ("tables", "sentence"),
    [
        ("[feature.lmp]", "'feature.lmp': no installed feature .* under this name; did you mean 'lamp'?"),
        ("[feature.scars]", "'feature.scars': no installed feature .* under this name; known: lamp"),
        ("[feature.lamp]\nwatt = 3", "'feature.lamp.watt' is not known; did you mean 'watts'?"),
        (
            "[feature.lamp]\nwatts = 0",
            "'feature.lamp.watts' is 0: Input should be greater than or equal to 1",
        ),
        ("[feature]\nlamp = 3", "'feature.lamp' is 3: expected a table"),
    ],
)
def test_options_that_a_feature_does_not_have(
    tables: str, sentence: str, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One sentence; without its table a feature has its defaults."""
    install(monkeypatch, f"{__name__}:LampWithOptions")
    config.write_text(f"{config.read_text()}\n{tables}\n")
    with pytest.raises(ConfigError, match=sentence):
        load_features(load_config(config))


@pytest.mark.parametrize(("tables", "watts"), [("", 5), ("[feature.lamp]\nwatts = 60", 60)])
def test_a_feature_has_its_options(
    tables: str, watts: int, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch, f"{__name__}:LampWithOptions")
    config.write_text(f"{config.read_text()}\n{tables}\n")
    with SteppedStation(config) as station:
        assert station.find(LampWithOptions).options.watts == watts
