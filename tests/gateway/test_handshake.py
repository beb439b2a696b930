"""A station with a PLC: recorded presses, one step at a time, and the PLC's side as its server asks."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from station import station_config, two_parts, variant
from stepped_station import SteppedStation

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import ConfigError
from edge.core.handshake import Code, HandshakeView, Trigger
from edge.features.handshake.stage import HandshakeStage
from edge.features.reference_press import ReferenceGuard
from edge.gateway.build import _list_earlier
from edge.gateway.preflight import preflight
from plugins.handshakes.modbus import ModbusServer

PLC = '[handshake]\nplugin = "modbus"\n%s\noptions = { port = 1 }\n'


@pytest.fixture(autouse=True)
def any_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """No connection is made: a port that is free is enough."""
    monkeypatch.setattr(
        "plugins.handshakes.modbus.Modbus.open",
        lambda self, options, clock: ModbusServer("127.0.0.1", 0, clock),
    )


Make = Callable[..., Path]


@pytest.fixture
def configure(tmp_path: Path, recording: Path, bundle: Path) -> Make:
    def make(keys: str = "", tables: str = "", inspection: Path | str = bundle, **given: Any) -> Path:
        return station_config(tmp_path, recording, inspection, tables=PLC % keys + tables, **given)

    return make


class PlcStation(SteppedStation):
    """A stepped station, and what its PLC does."""

    def trigger(self, trigger_id: int, piece: str = "", part: str = "") -> Code:
        refusal = self.find(HandshakeStage).port.trigger(Trigger(trigger_id, piece, part))
        return Code.NONE if refusal is None else refusal.code

    def acknowledge(self) -> None:
        self.find(HandshakeStage).port.acknowledge()

    @property
    def seen(self) -> HandshakeView:
        return self.find(HandshakeStage).port.read()

    @property
    def result(self) -> tuple[str, int, str | None, Code]:
        return self.seen.step, self.seen.trigger_id, self.seen.word, self.seen.code

    def play_until_ready(self) -> None:
        self.play_until(lambda: self.seen.is_ready)

    def play_until_pressed(self) -> None:
        self.play_until(lambda: self.loop.session is not None and self.loop.session.has_contact)


def test_each_trigger_is_answered_by_its_press(configure: Make) -> None:
    """Pass, fail, pass: with the press of the result, which names the trigger; a press without one answers nothing. Of
    the gel it says what is left, and nothing of a worn one."""
    with PlcStation(configure()) as station:
        assert station.trigger(1) is Code.NOT_READY
        station.play_until_ready()
        for trigger_id, word in ((1, "pass"), (2, "fail")):
            assert station.trigger(trigger_id) is Code.NONE
            station.play_until_pressed()
            assert station.result == ("busy", trigger_id, None, Code.NONE)
            assert station.seen.station.contact in ("touching", "pressing", "deep_enough", "unknown")
            station.play_presses(trigger_id)
            assert station.result == ("done", trigger_id, word, Code.NONE)
            assert station.seen.press_id == station.results[-1].press_id
            assert station.seen.score_ratio == pytest.approx(station.results[-1].score_ratio)
            station.acknowledge()
        station.play()
        assert [result.trigger_id for result in station.results] == [1, 2, None]
        assert station.seen.gel_left_percent == 99
        worn = replace(station.reports[-1].gel, wear_index=1.0)
        station.find(HandshakeStage).mount(worn)
        station.turn()
        assert station.seen.gel_left_percent == 0


def test_at_a_threshold_below_zero_there_is_no_ratio(tmp_path: Path, configure: Make, bundle: Path) -> None:
    """A PLC that reads it would take the worst press for the best; as in the result, and as on the page of a start."""
    below = variant(bundle, tmp_path / "below", threshold={"value": -1.0})
    with PlcStation(configure(inspection=below)) as station:
        station.play_until_ready()
        assert station.trigger(1) is Code.NONE
        station.play_presses(1)
        assert station.result == ("done", 1, "fail", Code.NONE)
        assert (station.seen.score_ratio, station.results[0].score_ratio) == (None, None)
        assert [one["score_ratio"] for one in _list_earlier(station.parts.store, 9)] == [None]


def test_a_press_that_began_before_the_trigger_is_not_its_answer(configure: Make) -> None:
    """At any frame of its contact; the next press is."""
    with PlcStation(configure()) as station:
        station.play_until_ready()
        station.play_until(lambda: station.seen.station.contact != "free")
        assert station.trigger(1) is Code.NONE
        station.play_presses(1)
        assert station.result == ("busy", 1, None, Code.NONE)
        station.play_presses(2)
        assert station.result == ("done", 1, "fail", Code.NONE)
        assert [result.trigger_id for result in station.results] == [None, 1]


def test_a_pass_that_the_database_refuses_is_an_error(configure: Make) -> None:
    """The station halts; the press is recorded later, and the PLC has long been told."""
    with PlcStation(configure()) as station:
        station.play_until_ready()
        station.trigger(1)
        with station.refusing("presses"):
            station.play_until(lambda: station.loop.is_halted)
            assert station.result == ("done", 1, "error", Code.HALTED)
        station.turn()
        assert station.verdicts == ["pass"]
        assert station.result == ("done", 1, "error", Code.HALTED)


def test_a_master_piece_answers_no_trigger(configure: Make) -> None:
    with PlcStation(configure(tables='[[reference.pieces]]\nname = "M1"\n')) as station:
        station.play_until_ready()
        station.find(ReferenceGuard).request("M1")
        station.trigger(1)
        station.play_presses(1)
        assert station.result == ("busy", 1, None, Code.NONE)
        station.play_presses(2)
        assert station.result == ("done", 1, "fail", Code.NONE)


def test_by_command_the_trigger_asks_for_the_verdict_of_the_press_that_is_held(configure: Make) -> None:
    """Without a press, and for one that has its verdict, the result is an error at once."""
    with PlcStation(configure(trigger="command")) as station:
        station.play_until_ready()
        station.trigger(1)
        station.turn()
        assert station.result == ("done", 1, "error", Code.NOTHING_PRESSED)
        station.acknowledge()
        station.play_until_pressed()
        station.play(6)
        assert station.reports == []
        station.trigger(2)
        station.play(3)
        assert station.result == ("done", 2, "pass", Code.NONE)
        station.acknowledge()
        station.trigger(3)
        station.turn()
        assert station.result == ("done", 3, "error", Code.NOTHING_PRESSED)


def test_by_command_no_frame_of_before_the_trigger_is_judged(configure: Make) -> None:
    """The loop is some frames behind, and the part was lifted before the trigger: its press is no answer, even though
    the loop still sees it."""
    with PlcStation(configure(trigger="command", pace=1.0)) as station:
        station.play_until_ready()
        station.play_until_pressed()
        station.read(14)
        assert station.trigger(1) is Code.NONE
        assert station.loop.session is not None
        station.look()
        assert not station.loop.session.has_contact
        station.play(1)
        assert station.result == ("done", 1, "error", Code.NOTHING_PRESSED)
    assert [(result.verdict, result.trigger_id) for result in station.results] == [("rejected", None)]


def test_a_trigger_selects_its_part(tmp_path: Path, configure: Make, bundle: Path) -> None:
    """An act of the PLC; a press of another one is an error, as where a person selects that meanwhile. A part without
    its position is refused where it has several: any bundle of it could judge the press."""
    two_parts(tmp_path / "bundles", bundle)
    variant(bundle, tmp_path / "bundles" / "c", part="PZ2")
    variant(bundle, tmp_path / "bundles" / "d", part="PZ2", position="pos2")
    with PlcStation(configure(inspection=f'bundle_folder = "{tmp_path / "bundles"}"')) as station:
        station.play_until_ready()
        assert station.trigger(1, part="PZ2") is Code.UNKNOWN_PART
        station.turn()
        refused = station.parts.store.acts(1)[0].sentence
        assert refused == "the part 'PZ2' has 2 positions here; name one of PZ2/pos1, PZ2/pos2"
        assert station.trigger(1, "piece 1", "PZ1") is Code.NONE
        station.play_presses(1)
        assert station.result == ("done", 1, "pass", Code.NONE)
        assert station.results[-1].part == "PZ1"
        act = next(act for act in station.parts.store.acts() if act.verb == "select_part")
        assert (act.who, act.outcome, act.arguments["piece"]) == ("plc", "done", "piece 1")
        station.acknowledge()
        station.trigger(2, part="PZ1/pos1")
        station.turn()
        station.ask("select_part", part="PZ0")
        station.play_presses(2)
        assert station.result == ("done", 2, "error", Code.OTHER_PART)


def test_a_trigger_replaces_a_selection_that_waits(tmp_path: Path, configure: Make, bundle: Path) -> None:
    """Also for the part that is inspected until the end of the press."""
    two_parts(tmp_path / "bundles", bundle)
    with PlcStation(configure(inspection=f'bundle_folder = "{tmp_path / "bundles"}"')) as station:
        station.play_until_pressed()
        assert station.ask("select_part", part="PZ1")["is_waiting"]
        station.trigger(1, part="PZ0")
        station.play_presses(2)
        assert station.result == ("done", 1, "fail", Code.NONE)
        assert station.results[-1].part == "PZ0"


def test_a_part_that_cannot_be_selected_is_an_error(tmp_path: Path, configure: Make, bundle: Path) -> None:
    """Its bundle goes between the trigger and its turn, or the act cannot be recorded: no other bundle answers."""
    two_parts(tmp_path / "bundles", bundle)
    with PlcStation(configure(inspection=f'bundle_folder = "{tmp_path / "bundles"}"')) as station:
        station.play_until_ready()
        assert station.trigger(1, part="PZ1") is Code.NONE
        with station.refusing("acts"):
            station.turn()
        assert station.result == ("done", 1, "error", Code.OTHER_PART)
        station.acknowledge()
        assert station.trigger(2, part="PZ1") is Code.NONE
        shutil.rmtree(tmp_path / "bundles" / "b")
        selection = station.parts.selection
        selection.reload()
        selection.worker.step()
        selection.step(is_pressed=False)
        station.turn()
        assert station.result == ("done", 2, "error", Code.UNKNOWN_PART)


def test_what_is_refused_is_an_act_once(configure: Make) -> None:
    """A PLC repeats what it writes many times a second."""
    with PlcStation(configure()) as station:
        station.play_until_ready()
        for _ in range(50):
            assert station.trigger(1, part="PZ9") is Code.UNKNOWN_PART
        station.trigger(1)
        for _ in range(50):
            assert station.trigger(2) is Code.BUSY
        station.find(HandshakeStage).port.refuse("write", "a second client writes")
        assert station.find(HandshakeStage).port.read().refused is Code.BUSY
        station.turn()
        acts = [act for act in station.parts.store.acts() if act.who == "plc"]
    assert [(act.verb, act.outcome, act.arguments.get("trigger_id")) for act in acts] == [
        ("write", "refused", None),
        ("trigger", "refused", 2),
        ("trigger", "refused", 1),
    ]
    assert acts[2].sentence == "this station has no bundle of the part 'PZ9'; add it to [inspection]"
    assert str(acts[1].sentence).startswith("trigger 2 came while trigger 1 is busy; wait for done")


def test_what_is_refused_for_hours_is_an_act_a_minute(configure: Make) -> None:
    """Else the ledger says that a PLC which is wired wrongly was refused once, hours ago."""
    with PlcStation(configure()) as station:
        for _ in range(181):
            assert station.trigger(1, part="PZ9") is Code.UNKNOWN_PART
            station.turn()
            station.clock.sleep(1)
        assert len([act for act in station.parts.store.acts() if act.who == "plc"]) == 4


@pytest.mark.parametrize(("trigger_id", "part"), [(0, "PZ9"), (1, "M\xfcller"), (1, "PZ\n9")])
def test_a_value_never_right_is_told_before_the_search(configure: Make, trigger_id: int, part: str) -> None:
    with PlcStation(configure()) as station:
        assert station.trigger(trigger_id, part=part) is Code.BAD_VALUE


def test_a_trigger_that_the_server_refuses_has_a_code(configure: Make) -> None:
    """Else a PLC that asks why reads that nothing was refused."""
    with PlcStation(configure()) as station:
        port = station.find(HandshakeStage).port
        port.refuse("trigger", "it is 1 from the beginning")
        assert port.read().refused is Code.BAD_VALUE


def test_a_flood_of_refusals_fills_no_disk(configure: Make) -> None:
    """Each another one: so many a minute are recorded, and all are refused."""
    with PlcStation(configure()) as station:
        for number in range(500):
            assert station.trigger(1, part=f"X{number}") is Code.UNKNOWN_PART
        station.turn()
        assert 50 < len(station.parts.store.acts(1000)) <= 61


def test_a_refused_text_of_any_length_fills_no_disk(configure: Make) -> None:
    """OPC UA sends strings of megabytes, and whoever reaches its port may."""
    with PlcStation(configure()) as station:
        assert station.trigger(1, "p" * 1_000_000, "n" * 1_000_000) is Code.BAD_VALUE
        station.turn()
        assert len(str(station.parts.store.acts(1)[0])) < 1000


def test_a_refusal_waits_for_the_database_and_the_plc_does_not(configure: Make) -> None:
    """It would be silent for seconds, and what was refused meanwhile would be in no table."""
    with PlcStation(configure()) as station:
        with station.refusing("acts"):
            assert station.trigger(1, part="PZ9") is Code.UNKNOWN_PART
            station.turn()
        station.turn()
        (act,) = [act for act in station.parts.store.acts() if act.who == "plc"]
    assert (act.verb, act.outcome, act.arguments["trigger_id"]) == ("trigger", "refused", 1)


def test_a_watchdog_that_stands_still_is_an_alarm(configure: Make) -> None:
    """Not before it is overdue; it ends with the next sign of life."""
    with PlcStation(configure("watchdog_s = 1")) as station:
        station.play_until(lambda: station.loop.session is not None)
        assert station.alarm("plc") is None
        station.clock.sleep(1.1)
        station.turn()
        assert station.alarm("plc") == "the PLC's watchdog stands still, so its triggers are refused"
        station.find(HandshakeStage).port.beat()
        station.turn()
        assert station.alarm("plc") is None


def test_a_result_that_is_not_acknowledged_is_an_alarm(configure: Make) -> None:
    """Not before twice the time-out; it ends with the acknowledgement."""
    with PlcStation(configure("timeout_s = 5")) as station:
        station.play_until_ready()
        station.trigger(1)
        station.play_presses(1)
        assert station.seen.step == "done"
        assert station.alarm("plc") is None
        station.clock.sleep(10.1)
        station.turn()
        assert station.alarm("plc") == (
            "the PLC does not acknowledge the result of trigger 1, so the next is refused"
        )
        station.acknowledge()
        station.turn()
        assert station.alarm("plc") is None


def test_a_server_that_ends_by_itself_is_an_alarm(configure: Make) -> None:
    """The PLC has lost its connection, and nobody else would know."""
    with PlcStation(configure()) as station:
        station.play_until_ready()
        stage = station.find(HandshakeStage)
        stage.start()
        station.turn()
        assert station.alarm("plc") is None
        server = stage._server
        assert isinstance(server, ModbusServer)
        server.shutdown()
        server._thread.join()
        station.turn()
        assert "has ended by itself, so the PLC reaches nothing" in str(station.alarm("plc"))


def test_after_a_restart_nothing_is_left(configure: Make) -> None:
    """No result of before, and no trigger."""
    config = configure()
    with PlcStation(config) as station:
        station.play_until_ready()
        station.trigger(1)
        station.play_presses(1)
        assert station.seen.is_pass
    with PlcStation(config) as station:
        assert station.result == ("idle", 0, None, Code.NONE)
        station.play_until_ready()
        station.play_presses(1)
        assert station.result == ("idle", 0, None, Code.NONE)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('"modbus"', '"modbsu"'), "no handshakes plugin is named 'modbsu'; did you mean 'modbus'"),
        (("port = 1", "port = 0"), "handshake.options"),
        (("port = 1", "map = 1"), "handshake.options"),
        (("[handshake]", "[handshake]\ntimeout_s = 0"), "handshake.timeout_s"),
        (("[handshake]", "[[handshake]]"), "handshake"),
    ],
)
def test_a_wrong_table_is_refused_at_its_place(configure: Make, change: tuple[str, str], words: str) -> None:
    config = configure()
    text = config.read_text()
    assert change[0] in text
    config.write_text(text.replace(*change))
    with pytest.raises(ConfigError, match=words):
        load_config(config)


def test_the_check_before_the_start_takes_the_port(configure: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is taken is a finding with its sentence."""
    with preflight(load_config(configure()), SystemClock()) as checked:
        (finding,) = (one for one in checked.findings if one.part == "handshake modbus")
    assert finding.error is None
    assert finding.text.startswith("Modbus TCP at 127.0.0.1:")
    monkeypatch.undo()
    server = ModbusServer("127.0.0.1", 0, SystemClock())
    port = server.name.rpartition(":")[2]
    config = configure()
    config.write_text(config.read_text().replace("port = 1", f"port = {port}"))
    with preflight(load_config(config), SystemClock()) as checked:
        (finding,) = (one for one in checked.findings if one.part == "handshake modbus")
    server.close()
    assert "Address already in use); choose another port" in str(finding.error)


PIECE = """
[piece]
order = "%s"
places = [{ part = "PZ0", position = "pos1" }, { part = "PZ1", position = "pos1" }]
"""


Planned = Callable[..., PlcStation]


@pytest.fixture
def planned(tmp_path: Path, configure: Make, bundle: Path) -> Planned:
    """Open a station that inspects pieces of two places, and play it until it is ready."""

    def make(order: str = "fixed", **given: Any) -> PlcStation:
        bundles = two_parts(tmp_path / "bundles", bundle) + '\npart = "PZ0"'
        station = PlcStation(configure(tables=PIECE % order, inspection=bundles, **given))
        station.play_until_ready()
        return station

    return make


@pytest.mark.parametrize("trigger", ["automatic", "command"])
def test_a_trigger_begins_its_piece(planned: Planned, trigger: str) -> None:
    """The next trigger with its id is for its next place; one with the id of a piece that is over is an error."""
    with planned(trigger=trigger) as station:
        for trigger_id in (1, 2):
            if trigger == "command":
                station.play_until_pressed()
            assert station.trigger(trigger_id, piece="P1") is Code.NONE
            station.play_until(lambda: station.seen.step == "done")
            assert station.seen.word != "error"
            assert (station.seen.station.piece_id == "P1") == (trigger_id == 1)
            station.play_until(lambda: not station.loop.is_pressed)
            station.acknowledge()
        if trigger == "command":
            station.play_until_pressed()
        assert station.trigger(3, piece="P1") is Code.NONE
        station.turn()
        assert station.result == ("done", 3, "error", Code.PIECE)
        act = station.parts.store.acts()[0]

    assert [(result.piece_id, result.place) for result in station.results[:2]] == [
        ("P1", "PZ0/pos1"),
        ("P1", "PZ1/pos1"),
    ]
    assert (act.who, act.verb, act.outcome) == ("plc", "begin_piece", "refused")
    assert "the piece P1 is over (" in str(act.sentence)


@pytest.mark.parametrize("when", ["as it touches", "while it is pressed", "when `free` is said"])
def test_a_piece_begins_when_the_part_before_is_lifted(planned: Planned, when: str) -> None:
    """A trigger that comes earlier, also one that a PLC gives as soon as it reads that nothing touches the gel, waits
    for that. The press that is held then is of the piece before."""
    with planned() as station:
        station.play_until(lambda: station.seen.station.contact == "touching")
        if when != "as it touches":
            station.play_until_pressed()
        if when == "when `free` is said":
            station.play_until(lambda: station.seen.station.contact == "free")
        assert station.loop.is_pressed == (when != "as it touches")
        assert station.trigger(1, piece="P1") is Code.NONE
        station.play_until(lambda: station.seen.step == "done")
        assert station.result[:3] in (("done", 1, "place"), ("done", 1, "fail"))
    before, first = station.results[:2]
    assert before.piece_id != "P1"
    assert first.piece_id == "P1"


def test_after_an_interruption_the_next_press_is_of_the_piece_that_is_asked_for(planned: Planned) -> None:
    """The gel was free, and for a moment nothing can be trusted: a trigger of then that waited for the free gel would
    leave its press to the part that was selected before."""
    with planned("free") as station:
        station.play(1)
        station.read(8)
        while station.parts.acquisition.next(0) is not None:
            pass
        station.play(1)
        assert (station.seen.station.contact, station.loop.is_pressed) == ("unknown", False)
        assert station.trigger(1, piece="P1", part="PZ1") is Code.NONE
        station.play_until(lambda: station.seen.step == "done")
    assert [(result.part, result.trigger_id) for result in station.results] == [("PZ1", 1)]


@pytest.mark.parametrize("is_pressed", [False, True], ids=["at once", "while it waits for the free gel"])
def test_a_trigger_that_is_taken_back_begins_no_piece(planned: Planned, is_pressed: bool) -> None:
    """It would end the one in progress."""
    with planned() as station:
        if is_pressed:
            station.play_until_pressed()
        assert station.trigger(1, piece="P1") is Code.NONE
        if is_pressed:
            station.turn()
        station.acknowledge()
        station.play_presses(2)
    assert "P1" not in [result.piece_id for result in station.results]


def test_the_next_piece_answers_no_trigger_of_before(planned: Planned) -> None:
    """The piece was in progress when its trigger came, and the press that was held then ended it."""
    with planned() as station:
        assert station.trigger(1, piece="P1") is Code.NONE
        station.play_until(lambda: station.seen.step == "done")
        station.acknowledge()
        station.play_until(lambda: not station.loop.is_pressed)
        station.play_until_pressed()
        assert station.trigger(2, piece="P1") is Code.NONE
        station.play_until(lambda: station.seen.step == "done")
        assert station.result == ("done", 2, "error", Code.PIECE)

    pieces = [result.piece_id for result in station.results]
    assert pieces[:2] == ["P1", "P1"]
    assert pieces[2] not in ("P1", None)


@pytest.mark.parametrize("is_pressed", [False, True], ids=["free", "while a part presses"])
def test_a_press_of_a_place_that_comes_later_fills_no_other_place(planned: Planned, is_pressed: bool) -> None:
    """The plan selects its first place as the piece begins, and the PLC says that the part lies at the second."""
    with planned() as station:
        if is_pressed:
            station.play_until_pressed()
        assert station.trigger(1, piece="P1", part="PZ1") is Code.NONE
        station.play_until(lambda: station.seen.step == "done")
        assert station.result == ("done", 1, "rejected", Code.NONE)
    answer = station.results[-1]
    assert (answer.piece_id, answer.place, answer.trigger_id) == ("P1", None, 1)
    assert "PZ1/pos1 comes later; select and press PZ0/pos1" in str(answer.reason)


def test_a_press_of_another_bundle_fills_no_place(planned: Planned) -> None:
    """The press that was held when the trigger came was recorded after it, and then the plan has selected its next
    place."""
    with planned() as station:
        assert station.trigger(1, piece="P1") is Code.NONE
        station.play_until_pressed()
        station.acknowledge()
        assert station.trigger(2, piece="P1", part="PZ0") is Code.NONE
        station.play_until(lambda: station.seen.step == "done")
        assert station.result == ("done", 2, "error", Code.OTHER_PART)
    first, answer = station.results[:2]
    assert (first.place, first.trigger_id) == ("PZ0/pos1", None)
    assert (answer.verdict, answer.trigger_id) == ("rejected", None)
    assert str(answer.reason).startswith("other_part: the PLC asks for PZ0/pos1")
