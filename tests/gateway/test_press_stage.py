"""A feature of presses is one stage; tests/plugins has one of another author."""

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from stepped_station import SteppedStation

from edge import registry
from edge.config import Config, TriggerTable, load_config
from edge.core.contact.events import PressSettled
from edge.core.errors import ConfigError
from edge.core.press import Press, PressLabel
from edge.gateway.features import load_features
from edge.model.inspector import Inspector
from edge.press_stage import PressStage
from edge.store.gel_ledger import GelRecord


def load_with(monkeypatch: pytest.MonkeyPatch, config: Config, lamp: str) -> list[str]:
    """Return the features of a station where another package brings one."""
    points = {**registry._points("features"), "lamp": [EntryPoint("lamp", lamp, "gelgate.features")]}
    monkeypatch.setattr(registry, "_points", lambda group: points)
    return list(load_features(config))


def test_what_is_not_configured_is_not_loaded(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A feature of another package is installed on purpose; it stands before the outputs, which show what it says."""
    few = load_config(config)
    assert list(load_features(few)) == ["sensing_watch", "gel_proof", "scars", "black_box"]
    more = few.model_copy(update={"triggers": [TriggerTable(plugin="virtual_hid")]})
    assert load_with(monkeypatch, more, "edge.press_stage:PressStage") == [
        "sensing_watch", "gel_proof", "scars", "lamp", "outputs", "black_box"
    ]  # fmt: skip
    with pytest.raises(ConfigError, match=r"'lamp' of gelgate.features is no class of PressStage"):
        load_with(monkeypatch, few, "math:pi")


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
