"""One more press of a piece at a station: asked for, decided together with the first, missed, replayed."""

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import gelgate
from sql import execute
from station import Motion, press_recording, station_config, variant
from stepped_station import SteppedStation

from edge.cli.run import press_line
from edge.clock import ManualClock
from edge.core.errors import NotScorable
from edge.core.handshake import Trigger
from edge.core.overview.view import Code, OverviewView
from edge.core.press import Press, ReferenceLabel, ScarFindings
from edge.core.press_again import Costs
from edge.core.registration.pose import Pose, PoseUncertainty, Registered
from edge.core.sentence import Sentence
from edge.core.verdict import Blame, Cause, decide
from edge.features.handshake.stage import HandshakeStage
from edge.features.press_again import PressAgain, find_seen
from edge.model.bundle import Bundle
from edge.store.integrity import check_database
from plugins.handshakes.modbus import ModbusServer

KNOWN = {
    "sound": [[0.02, 0.05], [0.04, 0.01], [0.05, 0.02], [0.01, 0.04], [0.03, 0.03], [0.02, 0.03]],
    "damaged": {"dent of 0.1 mm": [0.05 * n for n in range(1, 400)]},
}
COSTS = "[press_again]\nmissed_defect = 1\nfalse_alarm = 1000\n"


@pytest.fixture(scope="module")
def again_bundle(tmp_path_factory: pytest.TempPathFactory, bundle: Path) -> Path:
    """The bundle of the other tests, with what `fit` states of pieces pressed twice and of damage."""
    manifest = json.loads((bundle / "manifest.json").read_text(encoding="utf-8"))
    scores = sorted(score for piece in KNOWN["sound"] for score in piece)
    limit = manifest["threshold"] | {"nominal_scores": scores, "pieces": 6, "alpha_floor": 1 / 7}
    folder, facts = tmp_path_factory.mktemp("again") / "bundle", manifest["facts"] | {"press_again": KNOWN}
    return variant(bundle, folder, facts=facts, threshold=limit)


Make = Callable[..., SteppedStation]


@pytest.fixture
def asking(tmp_path: Path, again_bundle: Path) -> Make:
    """A station of three presses that asks for a second one; those of these numbers are dented."""

    def make(*dented: int, tables: str = COSTS, bundle: Path = again_bundle) -> SteppedStation:
        recording = press_recording(tmp_path / "presses", 3, dented=dented, motion=Motion(hold=10), seed=3)
        lines = f'press_again = "unsure"\nbundle = "{bundle}"'
        return SteppedStation(station_config(tmp_path, recording, lines, tables=tables))

    return make


def test_a_press_just_above_the_limit_asks_and_the_lower_score_decides(tmp_path: Path, asking: Make) -> None:
    """The first is unsure, the second passes with its own score; the third is a press of its own. Every press counts
    on the gel, the pair is in the ledger, and the line at the terminal says that it asks."""
    with asking(0) as station:
        station.play()
        lines = [press_line(report) for report in station.reports]
    first, second, third = results = station.results
    pairs = execute(tmp_path / "gelgate.db", "SELECT second_of FROM presses ORDER BY number")

    assert station.verdicts == ["unsure", "pass", "pass"]
    assert (first.score or 0) > (first.threshold or 9)
    assert first.press_again is not None
    assert first.press_again.is_asked
    assert "press the same piece again, a little shifted" in str(first.press_again.reason)
    assert second.press_again is not None
    assert (second.press_again.second_of, second.press_again.is_asked) == (first.press_id, False)
    assert second.press_again.first_score == first.score
    assert third.press_again is None
    assert [result.gel_presses for result in results] == [1, 2, 3]
    assert pairs == [(None,), (first.press_id,), (None,)]
    assert [one for one in check_database(tmp_path / "gelgate.db") if one.is_fault] == []
    assert station.raised == []
    assert ["PRESS AGAIN" in line for line in lines] == [True, False, False]


def test_a_piece_fails_where_both_presses_lie_above(tmp_path: Path, asking: Make) -> None:
    """The damage is there in both. Replay knows that one asked, and what the other was decided with."""
    with asking(0, 1) as station:
        station.play()
    again = gelgate("station", "replay", "--all", "-c", tmp_path / "gelgate.toml")

    assert station.verdicts == ["unsure", "fail", "pass"]
    decided = station.results[1].press_again
    assert decided is not None
    assert decided.first_score == station.results[0].score != station.results[1].score
    assert str(decided.reason).startswith("decided by the lower score of two presses")
    assert again.code == 0, again.out
    assert again.out.count("equal, bit for bit") == 3


def test_a_second_press_without_a_score_is_asked_for_once_more(
    asking: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The piece still waits, for the press after it, which is decided together with the first one."""
    with asking(0) as station:
        station.play_presses(1)
        with monkeypatch.context() as broken:
            fails = Mock(side_effect=NotScorable("not finite"))
            broken.setattr(station.parts.selection.inspector.scorer, "score_prepared", fails)
            station.play_presses(2)
        station.play_presses(3)
        assert "press_again" not in station.raised

    assert station.verdicts == ["unsure", None, "pass"]
    first, *others = station.results
    said = [one.press_again for one in others]
    assert [(one.is_asked, one.second_of) for one in said if one] == [
        (True, first.press_id),
        (False, first.press_id),
    ]
    assert str(said[0] and said[0].reason) == "this second press has no score; press the same piece once more"


PLAN = '[piece]\nplaces = [{ part = "PZ0", position = "pos1" }]\n'


def test_the_second_press_is_of_the_same_piece_of_several_places(asking: Make) -> None:
    """The unsure place is pressed again, and the piece passes with it."""
    with asking(0, tables=COSTS + PLAN) as station:
        station.play_until(lambda: len(station.reports) == 2)
        said = station.said("piece")

    first, second = station.results
    assert station.verdicts == ["unsure", "pass"]
    assert first.piece_id == second.piece_id == said["last_id"]
    assert said["last_verdict"] == "pass"


def test_a_press_of_the_next_piece_is_no_second_press(asking: Make) -> None:
    """It is decided by its own score alone, and that the other did not come is said."""
    with asking(0, 1, tables=COSTS + PLAN) as station:
        station.play_presses(1)
        station.ask("begin_piece", piece_id="P2")
        station.play_until(lambda: len(station.reports) == 2)

    second = station.results[1].press_again
    assert second is not None
    assert second.second_of is None


@pytest.mark.parametrize(
    ("pieces", "plan", "is_second"),
    [(("P1", "P2"), "", False), (("", ""), "", False), (("P1", "P1"), "", True), (("", ""), PLAN, True)],
    ids=["of another piece", "of no piece", "of the same piece", "of a plan's piece"],
)
def test_a_press_that_answers_another_trigger_is_no_second_press_unless_its_piece_is_named(
    pieces: tuple[str, str], plan: str, is_second: bool, asking: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A PLC sees that the first is unsure, not that a second one is asked for: it takes the piece away."""
    serve = partial(ModbusServer, "127.0.0.1", 0)
    monkeypatch.setattr("plugins.handshakes.modbus.Modbus.open", lambda self, options, clock: serve(clock))
    plc = '[handshake]\nplugin = "modbus"\noptions = { port = 1 }\n'
    with asking(0, tables=COSTS + plc + plan) as station:
        port = station.find(HandshakeStage).port
        for trigger_id, piece in enumerate(pieces, 1):
            station.play_until(lambda: port.read().is_ready)
            assert port.trigger(Trigger(trigger_id, piece)) is None
            station.play_presses(trigger_id)
            port.acknowledge()
        said = station.alarm("press_again")

    assert station.verdicts == ["unsure", "pass"]
    assert (station.results[1].press_again is not None) == is_second
    assert ("is not waited for any more: another piece is pressed" in str(said)) != is_second


@pytest.mark.parametrize(
    ("first", "second", "is_second"),
    [
        (("A",), ("A",), True),
        (("A",), ("B",), False),
        (("bolt", "A"), ("bolt", "B"), False),
        (("A",), (), True),
        ((), (), True),
    ],
)
def test_codes_of_another_piece_end_the_wait(
    again_bundle: Path, first: tuple[str, ...], second: tuple[str, ...], is_second: bool
) -> None:
    """The last code has the id of the piece. One that could not be read says nothing."""
    bundle = Bundle.load(again_bundle)
    costs = Costs(missed=1, false_alarm=1000, press=1, defect_rate=0.01)
    again, inspector = PressAgain(costs, 30.0, ManualClock(), Mock()), SimpleNamespace(bundle=bundle)
    again.use(inspector)  # type: ignore[arg-type]

    def press(texts: tuple[str, ...]) -> Press:
        codes = tuple(Code("qr", text) for text in texts)
        seen = OverviewView(b"", None, codes=codes, piece_ids=texts[-1:])
        return again.judge(Press(bundle.manifest.decide(0.2), overview=seen), None, inspector)  # type: ignore[arg-type]

    press(first)
    now = press(second).again
    assert now is not None
    assert (now.second_of is not None) == is_second


def test_a_press_that_does_not_come_in_time_is_said(asking: Make) -> None:
    """With the press that stays unsure; the next press is one of its own, and ends the alarm."""
    with asking(0, tables=COSTS + "within_s = 0.5\n") as station:
        station.play_until(lambda: len(station.reports) == 1)
        station.clock.sleep(1.0)
        station.turn()
        late = str(station.alarm("press_again"))
        station.play()

    first = station.results[0].press_id
    assert f"the second press after press {first} did not come within 0.5 s" in late
    assert "treat the piece as not inspected" in late
    assert station.verdicts == ["unsure", "pass", "pass"]
    assert [result.press_again is None for result in station.results] == [False, True, True]
    assert station.raised == []


def test_a_restart_ends_the_wait_and_says_so_until_the_next_press(tmp_path: Path, asking: Make) -> None:
    with asking(0) as station:
        station.play_presses(1)
    with SteppedStation(tmp_path / "gelgate.toml") as restarted:
        said = restarted.alarm("press_again")
        restarted.play_presses(2)  # the recording again
        raised = restarted.raised
    with SteppedStation(tmp_path / "gelgate.toml") as again:
        assert again.alarm("press_again") is None

    assert f"after press {station.results[0].press_id} is not waited for any more: the station" in str(said)
    assert raised == []


def test_a_bundle_without_such_scores_never_asks_and_says_why(
    asking: Make, bundle: Path, again_bundle: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Bundles of earlier versions, and fits without a picture of the free gel; `inspect` says the same."""
    with caplog.at_level(logging.WARNING), asking(0, bundle=bundle) as station:
        station.play()

    assert station.verdicts == ["fail", "pass", "pass"]
    assert "never: the bundle has no scores of damaged presses" in caplog.text
    assert "never: the bundle has no scores" in gelgate("bundle", "inspect", bundle).out
    assert "press again" in gelgate("bundle", "inspect", again_bundle).out


def test_where_it_does_not_pay_a_press_fails_at_once(asking: Make) -> None:
    with asking(0, tables="[press_again]\nmissed_defect = 1e9\nfalse_alarm = 0\n") as station:
        station.play()
    assert station.verdicts == ["fail", "pass", "pass"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda station: station.ask("replace_gel"), "the gel was replaced"),
        (
            lambda station: station.loop.session.use(station.loop.session.inspector),
            "PZ0/pos1 is inspected now",
        ),
    ],
    ids=["another gel", "another bundle"],
)
def test_a_press_that_waits_is_dropped_with_a_change(
    asking: Make, change: Callable[[SteppedStation], object], why: str
) -> None:
    """The next press may be of another piece."""
    with asking(0) as station:
        station.play_until(lambda: len(station.reports) == 1)
        change(station)
        assert f"is not waited for any more: {why}" in str(station.alarm("press_again"))


def test_what_scars_hide_is_not_compared() -> None:
    """The first press shows nothing there, so the place of the part is not judged by it, wherever the part lay."""
    score_map, hidden = np.full((9, 9), 0.5, np.float32), np.zeros((9, 9), bool)
    hidden[4, 7] = True
    placed = Registered(
        np.zeros((9, 9, 3), np.uint8),
        np.ones((9, 9), bool),
        Pose(3.0, 0.0),
        PoseUncertainty(0.1, 0.1, None),
        match=0.9,
        seen_share=1.0,
    )
    press = Press(decide(0.5, 0.4), score_map=score_map, registered=placed)
    scars = ScarFindings(Blame(Cause.UNSURE, Sentence("nowhere")), hidden)
    whole, masked = find_seen(press), find_seen(replace(press, scars=scars))
    assert whole is not None
    assert masked is not None
    assert whole.is_judged.all()
    assert np.argwhere(~masked.is_judged).tolist() == [[4, 4]]


def test_a_master_piece_is_no_second_press(again_bundle: Path) -> None:
    """It passes through unchanged, and the piece that waits still waits."""
    bundle = Bundle.load(again_bundle)
    costs = Costs(missed=1, false_alarm=1000, press=1, defect_rate=0.01)
    again, inspector = PressAgain(costs, 30.0, ManualClock(), Mock()), SimpleNamespace(bundle=bundle)
    again.use(inspector)  # type: ignore[arg-type]
    press = Press(bundle.manifest.decide(0.2))
    first = again.judge(press, None, inspector).again  # type: ignore[arg-type]
    master = replace(press, label=ReferenceLabel("M1", "pass", 5))
    assert again.judge(master, None, inspector) is master  # type: ignore[arg-type]
    second = again.judge(press, None, inspector).again  # type: ignore[arg-type]
    assert first is not None
    assert second is not None
    assert second.second_of is not None
