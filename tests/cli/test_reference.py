"""`gelgate station reference`: the charts as text, JSON, CSV and SVG, and a press that is asked for."""

import csv
import io
import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import Outcome, gelgate
from recorded_presses import T0
from station import station_config

from edge.cli.reference import request_press
from edge.core.errors import GelgateError
from edge.core.reference_press.charts import ReferencePress, charts
from edge.core.reference_press.outcome import Imprint
from edge.pictures.control_chart import control_charts_svg
from edge.store.acts import Act
from edge.store.press_store import PressRecord, Store
from edge.store.reference_presses import PieceKey, ReferenceRequest, ReferenceTable, take
from edge.store.ulid import new_ulid

KEY = PieceKey("2BNN4ZE7", "bolt", "crest", "M1")
WOBBLE = (0.0, 1.0, -1.0, 0.5, -0.5)


def record(store: Store, number: int, score: float, key: PieceKey = KEY) -> None:
    """A reference press; the imprint wobbles."""
    time_ns = T0 + number * 3600 * 10**9
    press_id = new_ulid(time_ns, lambda k: number.to_bytes(k, "big"))
    off = WOBBLE[number % 5]
    imprint = Imprint(2.0 + 0.02 * off, 9.0, 7.0, None, 1.0)
    one = ReferencePress(press_id, time_ns, "", "b1", "pass", "pass", score, 1.0, imprint)
    press = PressRecord(press_id, time_ns, key.serial, key.part, "pass", key.position, score, 1.0)
    store.record_press(press, lambda recorded: [], ReferenceTable(key, one))


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Seven presses; the last is out of the limits of the first five."""
    path = tmp_path / "gelgate.db"
    with Store(path) as store:
        for number in range(6):
            record(store, number, 0.4 + 0.01 * WOBBLE[number % 5])
        record(store, 6, 0.8)
    return path


def chart(database: Path, *more: object) -> Outcome:
    return gelgate("station", "reference", "chart", "--database", database, "--learn", "5", *more)


def test_the_charts_are_printed_with_their_presses(database: Path) -> None:
    """Limits of each measure, then each press with what it said."""
    done = chart(database, "--count", "2")
    lines = done.out.splitlines()

    assert done.code == 0
    assert lines[0] == "master piece M1 at bolt/crest, sensor 2BNN4ZE7: 7 presses"
    assert "score                     0.8  limits 0.3" in done.out
    assert lines[2].endswith("beyond limit")
    assert [line.startswith("2026-") for line in lines].count(True) == 2
    assert ["in limits" in line for line in lines[-2:]] == [True, False]
    assert "out of limits" in lines[-1]


def test_charts_are_written_as_json_csv_and_svg(database: Path, tmp_path: Path) -> None:
    """What the topic has; a row for each press with what it said then; a strip for each measure and one red point."""
    found = json.loads(chart(database, "--json").out)
    assert (found["piece"], found["outcome"], len(found["presses"])) == ("M1", "out_of_limits", 7)
    assert {one["measure"]: one["signals"] for one in found["charts"]}["score"] == ["beyond_limit"]

    path = tmp_path / "reference.csv"
    assert chart(database, "-o", path).out == f"7 reference presses in {path}\n"
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    assert [row["outcome"] for row in rows] == ["learning"] * 4 + ["in_limits"] * 2 + ["out_of_limits"]
    assert (rows[0]["score"], rows[0]["turn_deg"], rows[0]["gel_id"]) == ("0.4", "", "2BNN4ZE7-1")

    chart(database, "-o", tmp_path / "reference.svg")
    classes = [one.get("class") for one in ElementTree.parse(tmp_path / "reference.svg").iter()]
    assert [classes.count(name) for name in ("out", "line", "limit")] == [1, 5, 10]


def test_a_point_is_red_by_the_limits_that_other_presses_made() -> None:
    """A first press that gave the wrong verdict made no limits, so it is compared with them; the last of those that
    made them is not."""
    scores = (0.9, *(0.4 + 0.01 * off for off in WOBBLE))
    presses = [
        ReferencePress(str(n), n, "g", "b", "pass", "fail" if n == 0 else "pass", score, 0.5)
        for n, score in enumerate(scores)
    ]
    drawn = control_charts_svg(charts(presses, 5), "M1")

    points = [one.get("class") for one in ElementTree.fromstring(drawn).iter() if one.tag.endswith("circle")]
    assert points == ["out", *["point"] * 5]


def test_a_choice_without_a_press_says_what_there_is(database: Path, tmp_path: Path) -> None:
    """And an empty database what to do."""
    Store(tmp_path / "empty.db").close()

    there = "no such master piece was pressed; there are M1 at bolt/crest, sensor 2BNN4ZE7\n"
    assert chart(database, "--piece", "M2").out == there
    assert "ask for one with `gelgate station reference press`" in chart(tmp_path / "empty.db").out


def test_what_cannot_be_written_is_refused(database: Path, tmp_path: Path) -> None:
    """An ending that is no format; one picture of two pieces; a database that is not there."""
    with Store(database) as store:
        record(store, 9, 0.4, KEY._replace(piece="M2"))
    for done, words in (
        (chart(database, "-o", tmp_path / "a.xlsx"), "known are .csv, .svg"),
        (chart(database, "-o", tmp_path / "a.svg"), "choose with --piece"),
        (chart(tmp_path / "none.db"), "does not exist"),
    ):
        assert (done.code, words in done.err) == (3, True)


class Gateway:
    """A clock whose sleep is a gateway's turn: it does what the test gives it, in order."""

    def __init__(self, *turns: Callable[[], object]) -> None:
        self._turns = list(turns)
        self._now_ns = 0

    def monotonic_ns(self) -> int:
        return self._now_ns

    def time_ns(self) -> int:
        return T0 + self._now_ns

    def sleep(self, seconds: float) -> None:
        self._now_ns += round(seconds * 1e9)
        if self._turns:
            self._turns.pop(0)()


def wish(piece: str | None = "M1") -> ReferenceRequest:
    return ReferenceRequest("r1", "kim", piece, False, T0)


def acted(store: Store, outcome: str, sentence: str | None = None) -> None:
    take(store)
    act = Act(T0, "kim", "reference_press", "r1", outcome=outcome, sentence=sentence)  # type: ignore[arg-type]
    store.begin_act(act)


def test_a_press_that_is_asked_for_is_waited_for(database: Path) -> None:
    """The person is asked to press once the gateway waits; the presses of the piece come back."""
    said: list[str] = []
    with Store(database) as store:
        turns = (lambda: None, lambda: acted(store, "done"), lambda: None, lambda: record(store, 7, 0.4))
        found = request_press(store, Gateway(*turns), wish(), said.append, 60)

    assert said[0].startswith("asked; a gateway takes it within 30 s")
    assert said[1:] == ["press the master piece M1"]
    assert (len(found), found[-1].score) == (8, 0.4)


def test_a_request_that_no_gateway_takes_is_withdrawn(database: Path) -> None:
    """The error names each cause; a gateway that starts later does not do it."""
    with Store(database) as store:
        with pytest.raises(
            GelgateError, match=r"no gateway took the request within 30 s; one must"
        ) as raised:
            request_press(store, Gateway(), wish(), print, 60)
        assert take(store) is None
    for cause in (f"on database {database}", "the gel must be free", "before its configuration named"):
        assert cause in str(raised.value)


def test_a_refusal_of_the_gateway_is_the_answer(database: Path) -> None:
    why = "no master piece of bolt/crest is named 'M9'; known: M1"
    with Store(database) as store, pytest.raises(GelgateError, match=why):
        request_press(store, Gateway(lambda: acted(store, "refused", why)), wish("M9"), print, 60)


def test_a_press_that_does_not_come_is_said(database: Path) -> None:
    with Store(database) as store, pytest.raises(GelgateError, match="no reference press came within 5 s"):
        request_press(store, Gateway(lambda: acted(store, "done")), wish(), print, 5)


def test_a_station_without_master_pieces_is_not_asked(tmp_path: Path) -> None:
    """It is refused at once, without waiting for a gateway."""
    config = station_config(tmp_path, tmp_path / "presses", tmp_path / "bundle")
    done = gelgate("station", "reference", "press", "--config", config)

    assert done.code == 3
    assert "names no master piece" in done.err
