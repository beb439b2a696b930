"""Reference presses through a station: asked for, judged by their charts, due, and parts refused meanwhile."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.core.verdict import Kind
from edge.features.reference_press import ReferenceGuard
from edge.store import reference_presses
from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import check_database
from edge.store.outbox import Outbox
from edge.store.reference_presses import ReferenceRequest

LEARN = 5
TABLE = """
[reference]
enforce = "{enforce}"
every_h = 8
learn = 5
within_s = 60
[[reference.pieces]]
name = "M1"
"""


@pytest.fixture(scope="session")
def presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine presses; those numbered 6 and 7 are dented."""
    folder = tmp_path_factory.mktemp("reference") / "presses"
    return press_recording(folder, 9, dented=[6, 7], motion=Motion(free=56, hold=8), seed=5)  # learnt twice


@pytest.fixture
def config(tmp_path: Path, presses: Path, bundle: Path) -> Callable[..., Path]:
    """A station with one master piece."""

    def make(enforce: str = "warn", tables: str = "") -> Path:
        return station_config(tmp_path, presses, bundle, tables=TABLE.format(enforce=enforce) + tables)

    return make


def start(station: SteppedStation) -> None:
    """Until the free gel is learnt."""
    station.play_until(lambda: station.find(ReferenceGuard)._is_gel_known)


def ask(station: SteppedStation, **arguments: Any) -> dict[str, Any]:
    return dict(station.ask("reference_press", **arguments))


def reference(station: SteppedStation, count: int = 1) -> None:
    """The next presses are reference presses."""
    for _ in range(count):
        ask(station)
        station.play_presses(len(station.reports) + 1)


def published(config: Path, topic: str) -> list[dict[str, Any]]:
    """The waiting messages of a topic."""
    with Outbox(config.parent / "gelgate.db") as outbox:
        outbox.register(["test"])
        return [
            json.loads(row.message.payload)
            for row in outbox.pending("test", 500)
            if row.message.topic == topic
        ]


def test_a_master_piece_that_is_lifted_before_it_rests_is_not_measured(tmp_path: Path, bundle: Path) -> None:
    """A part is judged at its peak then; the charts would learn a press that may be less deep."""
    film = press_recording(tmp_path / "film", 1, motion=Motion(hold=3), seed=5)
    path = station_config(tmp_path / "station", film, bundle, tables=TABLE.format(enforce="warn"))
    with SteppedStation(path) as station:
        start(station)
        reference(station)
    (sent,) = published(path, "reference")

    assert (sent["outcome"], sent["score"]) == ("not_measured", None)
    assert "lifted before it rested" in str(sent)


def test_a_reference_press_is_no_result_and_counts_on_the_gel(config: Callable[..., Path]) -> None:
    """A missing one is said, and with warn parts pass. It has its own topic with its charts, whose measures are those
    of the press; the part presses before and after have numbers without a gap."""
    path = config("warn")
    with SteppedStation(path) as station:
        station.play_presses(1)
        due, state = str(station.alarm("reference")), station.said("state")["state"]
        answer = ask(station)
        station.play_presses(3)
        gel, profile = station.loop.session.gel.presses, station.parts.selection.inspector.bundle.profile
    (sent,) = published(path, "reference")
    measures = {chart["measure"]: chart["values"][0] for chart in sent["charts"]}

    assert due.startswith(
        "a reference press of M1 is due: there was none with this gel and bundle; ask for it"
    )
    assert (state, station.verdicts[0]) == ("ready", Kind.PASS)
    assert answer == {"piece": "M1", "is_waiting": True, "within_s": 60.0}
    assert gel == 3
    assert dict(station.loop.summary.verdicts) == {"pass": 2, "reference": 1}
    assert [one["sequence"] for one in published(path, "result")] == [1, 2]
    assert [row.number for row in read_history(path.parent / "gelgate.db", HistoryQuery())] == [1, 2]
    assert (sent["kind"], sent["number"], sent["piece"], sent["gel_presses"]) == ("reference", 1, "M1", 2)
    assert (sent["outcome"], sent["sentences"]) == ("learning", ["limits are learnt: 1 of 5 presses"])
    assert check_database(path.parent / "gelgate.db") == []
    # The part lies in the middle of the picture; the noise is that of the recording after the view's averaging.
    assert measures["x_mm"] == pytest.approx(160 * profile.mm_per_pixel[0], abs=0.3)
    assert measures["y_mm"] == pytest.approx(120 * profile.mm_per_pixel[1], abs=0.3)
    assert measures["score"] == pytest.approx(sent["score"], rel=1e-5)
    assert measures["strength_levels"] > 1
    assert 0.3 < measures["noise_levels"] < 1.5


def test_parts_are_rejected_until_the_reference_press_is_good(config: Callable[..., Path]) -> None:
    """With refuse: due, then good with the five presses that make the limits, then out of them with the dented piece,
    and the alarm says what to do; then good again. A refused press has no score, and counts."""
    with SteppedStation(config("refuse")) as station:
        station.play_presses(1)
        states = [station.said("state")["state"]]
        reference(station, LEARN)
        states.append(station.said("state")["state"])
        reference(station)  # dented
        raised = str(station.alarm("reference"))
        station.play_presses(8)
        reference(station)
        states.append(station.said("state")["state"])
        gel = station.loop.session.gel.presses

    due, out = station.results[0], station.results[7]
    assert [(one.verdict, one.score) for one in (due, out)] == [(Kind.REJECTED, None)] * 2
    assert str(due.reason).startswith("reference: a reference press of M1 is due")
    assert str(out.reason).startswith("reference: the reference press of M1 is out of limits")
    assert "score is " in raised
    assert "then press it again" in raised
    assert states == ["halted", "ready", "ready"]
    assert gel == 9


def test_it_is_due_again_after_the_configured_hours(config: Callable[..., Path]) -> None:
    """Without a press and without a restart."""
    with SteppedStation(config("refuse")) as station:
        start(station)
        reference(station)
        good = station.said("state")["state"]
        station.clock.sleep(8 * 3600)
        station.turn()
        due = station.said("state")["state"]

    assert (good, due) == ("ready", "halted")
    assert "is due: the last one is more than 8 h old" in str(station.alarm("reference"))


def test_a_new_gel_is_due_at_once(config: Callable[..., Path]) -> None:
    """Its charts begin again and say so; the limits of the place remain."""
    path = config("refuse")
    with SteppedStation(path) as station:
        start(station)
        reference(station, LEARN)
        station.ask("replace_gel", gel_id="second")
        station.turn()
        due = str(station.alarm("reference"))
    with SteppedStation(path) as station:  # the recording again, from its free gel on
        start(station)
        reference(station)
        first = station.reports[-1].sentences
    newest = published(path, "reference")[-1]
    limits = {chart["measure"]: chart["low"] for chart in newest["charts"]}

    assert "there was none with this gel and bundle" in due
    assert any("the first one on gel second: its charts begin again" in one for one in first)
    assert limits["score"] is None
    assert limits["x_mm"] is not None


def test_a_reference_press_on_what_it_was_not_asked_for_is_no_part(config: Callable[..., Path]) -> None:
    """The gel changes before it comes: it is rejected, and the press after it is a part's."""
    with SteppedStation(config("off")) as station:
        start(station)
        ask(station)
        station.ask("replace_gel", gel_id="second")
        station.turn()
        said = str(station.alarm("reference"))
        station.play_presses(2)
        station.clock.sleep(60)
        station.turn()

    assert "changed before the reference press of M1 came: the next press is rejected" in said
    assert station.verdicts == ["rejected", "pass"]
    assert str(station.results[0].reason).startswith("reference: part, bundle, gel or sensor changed")
    assert station.alarm("reference") is None


def test_what_was_learnt_is_there_after_a_restart(config: Callable[..., Path]) -> None:
    """Limits and the last press: nothing is due, and the next press is compared."""
    path = config("refuse")
    with SteppedStation(path) as station:
        start(station)
        reference(station, LEARN)
    with SteppedStation(path) as station:
        start(station)
        state = station.said("state")
        reference(station)

    assert "reference press" not in (state["reason"] or "")
    assert station.reports[-1].sentences == () or "limits" not in station.reports[-1].sentences[0]
    assert {chart["learnt"] for chart in published(path, "reference")[-1]["charts"]} == {LEARN}


@pytest.mark.parametrize("is_cancelled", [True, False])
def test_a_press_that_never_comes_is_not_waited_for(config: Callable[..., Path], is_cancelled: bool) -> None:
    """In time, or because it was cancelled: the next press is a part's; the alarm says while it is waited for. With
    off it says nothing else, and a reference press can be made."""
    with SteppedStation(config("off")) as station:
        start(station)
        assert station.alarm("reference") is None
        ask(station)
        waiting = station.alarm("reference")
        if is_cancelled:
            assert ask(station, cancel=True) == {"is_waiting": False}
        else:
            station.clock.sleep(61)
            station.turn()
        after = station.alarm("reference")
        with pytest.raises(ValueError, match="no reference press is waited for"):
            ask(station, cancel=True)
        station.play_presses(1)

    assert waiting == "the next press is the reference press of M1: press it within 60 s"
    assert after is None
    assert station.reports[0].press.label is None


def test_a_piece_that_is_not_known_is_refused_with_the_nearest(config: Callable[..., Path]) -> None:
    """And before the sensor is known, and while something presses the gel."""
    with SteppedStation(config("off")) as station:
        with pytest.raises(ValueError, match="no frame has arrived from a sensor yet"):
            ask(station)
        start(station)
        with pytest.raises(ValueError, match=r"no master piece of PZ0/pos1 is named 'M2'; known: M1"):
            ask(station, piece="M2")
        station.play_until(lambda: station.loop.session.has_contact)
        station.turn()
        with pytest.raises(ValueError, match="something presses the gel; lift it"):
            ask(station)


def test_several_pieces_are_named(config: Callable[..., Path]) -> None:
    """One that must fail, of this part; one of another part is not pressed here."""
    more = '[[reference.pieces]]\nname = "bad"\npart = "PZ0"\nverdict = "fail"\n[[reference.pieces]]\nname = "other"\n'
    with SteppedStation(config("refuse", more + 'part = "PZ9"\n')) as station:
        start(station)
        due = str(station.alarm("reference"))
        with pytest.raises(ValueError, match=r"PZ0/pos1 has several master pieces \(M1, bad\); name one"):
            ask(station)
        ask(station, piece="bad")
        station.play_presses(1)

    assert ("press of M1 is due" in due, "press of bad is due" in due, "other" in due) == (True, True, False)
    assert "this master piece must give fail" in station.reports[0].sentences[0]


def test_the_command_line_asks_through_the_database(config: Callable[..., Path]) -> None:
    """Taken once, with its row in the table of acts; one that is old, or cannot be done, is refused there."""
    with SteppedStation(config("off")) as station:
        start(station)
        now_ns = station.clock.time_ns()
        for request, piece, time_ns in (
            ("a", None, now_ns),
            ("b", "M7", now_ns),
            ("c", None, now_ns - 61 * 10**9),
        ):
            wish = ReferenceRequest(request, "kim, command line", piece, False, time_ns)
            station.parts.store.write("asking", partial(reference_presses.ask, wish=wish))
            station.clock.sleep(1)
            station.turn()
        acts = {act.request: act for act in station.parts.store.acts() if act.verb == "reference_press"}
        station.play_presses(1)

    assert (acts["a"].outcome, acts["a"].who) == ("done", "kim, command line")
    assert (acts["b"].outcome, "no master piece" in str(acts["b"].sentence)) == ("refused", True)
    assert (acts["c"].outcome, "while no gateway ran" in str(acts["c"].sentence)) == ("refused", True)
    assert station.reports[0].press.label is not None


def test_it_is_asked_for_when_the_gel_is_known(config: Callable[..., Path]) -> None:
    """Before that no press is noticed: the master piece would be pressed in vain, and the next part taken for it."""
    with SteppedStation(config()) as station:
        station.play_until(lambda: station.loop.session is not None)
        with pytest.raises(ValueError, match="not known yet"):
            ask(station)
        start(station)
        ask(station)
        station.ask("relearn")
        with pytest.raises(ValueError, match="wait until the station is ready"):
            ask(station)


def test_the_command_line_waits_until_the_gel_is_free(config: Callable[..., Path]) -> None:
    """Asked for while a part presses, it is neither taken nor refused before the gel is free."""
    with SteppedStation(config("off")) as station:
        start(station)
        guard, mounted = station.find(ReferenceGuard), station.loop.session.mounted
        wish = ReferenceRequest("a", "kim", None, False, station.clock.time_ns())
        station.parts.store.write("asking", partial(reference_presses.ask, wish=wish))
        station.clock.sleep(1)
        guard.turn(replace(mounted, has_contact=True))
        pressed = station.parts.store.acts()
        station.clock.sleep(1)
        guard.turn(mounted)
        (act,) = station.parts.store.acts()

    assert pressed == []
    assert act.outcome == "done"
    assert guard.begin(None) is not None


def test_a_reference_press_waits_for_the_database_as_others_do(config: Callable[..., Path]) -> None:
    """It is recorded, judged and counted once the database accepts it."""
    path = config("refuse")
    with SteppedStation(path) as station:
        start(station)
        ask(station)
        with station.refusing("reference_presses"):
            station.play_until(lambda: station.loop.is_halted)
            assert station.reports == []
        station.turn()

    assert len(station.reports) == 1
    assert station.alarm("reference") is None
