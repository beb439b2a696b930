"""A feature of presses is one stage: a class of some lines, and a line in `build.py`."""

import re
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from stepped_station import SteppedStation

from edge.core.contact.events import PressSettled
from edge.core.press import Press, PressLabel
from edge.features.press_stage import PressStage
from edge.model.inspector import Inspector
from edge.store.gel_ledger import GelRecord

PAGE = Path(__file__).parents[2] / "docs/plugins.md"


def test_the_feature_of_the_page_is_one_class(config: Path) -> None:
    """It sees every press that is recorded, and touches no other file."""
    (code,) = re.findall(
        r"```python\n(class PressesPerShift.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    names: dict[str, Any] = {one.__name__: one for one in (Counter, datetime, PressStage, Press, GelRecord)}
    exec(code, names | {"UTC": UTC}, names)
    with SteppedStation(config, labels=(shifts := names["PressesPerShift"]())) as station:
        station.play()
    assert shifts.counts == {0: 3}


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
    with SteppedStation(config, labels=(told := Told())) as station:
        station.play()
    assert told.calls == [
        call
        for word in ("pass", "fail", "pass")
        for call in ("begin", "admit False", f"judge {word}", f"record {word}")
    ]
