"""A feature of presses is one stage; tests/plugins has one of another author."""

from pathlib import Path

from stepped_station import SteppedStation

from edge.core.contact.events import PressSettled
from edge.core.press import Press, PressLabel
from edge.model.inspector import Inspector
from edge.press_stage import PressStage
from edge.store.gel_ledger import GelRecord


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
