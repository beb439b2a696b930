"""A feature of presses is one stage: a class of some lines, and a line in `build.py`."""

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

from station import station_config
from stepped_station import SteppedStation

from edge.core.contact.events import PressSettled
from edge.core.press import Press
from edge.core.press_label import PressLabel
from edge.features.press_stage import PressStage
from edge.model.inspector import Inspector
from edge.store.gel_ledger import GelRecord


class PressesPerShift(PressStage):
    """Counts the presses of each shift of eight hours."""

    def __init__(self) -> None:
        self.counts: Counter[int] = Counter()

    def record(self, press: Press, gel: GelRecord) -> None:
        hour = datetime.fromtimestamp(press.time_ns / 1e9, UTC).hour
        self.counts[hour // 8] += 1


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


def test_a_new_feature_is_one_class(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """It sees every press that is recorded, and touches no other file."""
    shifts = PressesPerShift()
    with SteppedStation(station_config(tmp_path, recording, bundle), labels=shifts) as station:
        station.play()
    assert shifts.counts == {0: 3}


def test_the_calls_of_a_press_come_in_order(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Three presses, the second one dented, each from its beginning to its row."""
    told = Told()
    with SteppedStation(station_config(tmp_path, recording, bundle), labels=told) as station:
        station.play()
    assert told.calls == [
        call
        for word in ("pass", "fail", "pass")
        for call in ("begin", "admit False", f"judge {word}", f"record {word}")
    ]
