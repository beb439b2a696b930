"""One more press of a piece at a station: asked for, decided together with the first, missed, replayed."""

import json
import logging
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from command_line import gelgate
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.cli.run import press_line
from edge.clock import ManualClock
from edge.core.press import Press
from edge.core.press_again import Costs
from edge.features.press_again import PressAgain
from edge.model.bundle import Bundle
from edge.store.integrity import check_database

KNOWN = {
    "sound": [[0.02, 0.05], [0.04, 0.01], [0.05, 0.02], [0.01, 0.04], [0.03, 0.03], [0.02, 0.03]],
    "damaged": {"dent of 0.1 mm": [0.05 * n for n in range(1, 400)]},
}
COSTS = "[press_again]\nmissed_defect = 1\nfalse_alarm = 1000\n"


@pytest.fixture(scope="module")
def again_bundle(tmp_path_factory: pytest.TempPathFactory, bundle: Path) -> Path:
    """The bundle of the other tests, with what `fit` states of pieces pressed twice and of damage."""
    folder = tmp_path_factory.mktemp("again") / "bundle"
    shutil.copytree(bundle, folder)
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    manifest["facts"]["press_again"] = KNOWN
    nominal = sorted(score for piece in KNOWN["sound"] for score in piece)
    manifest["threshold"] |= {"nominal_scores": nominal, "pieces": 6, "alpha_floor": 1 / 7}
    path.write_text(json.dumps(manifest), encoding="utf-8")
    return folder


def configured(
    folder: Path, bundle: Path, dented: Sequence[int], *, presses: int = 3, extra: str = COSTS
) -> Path:
    """A station that asks for a second press. Presses of these numbers are dented."""
    recording = press_recording(folder / "presses", presses, dented=dented, motion=Motion(hold=10), seed=3)
    config = station_config(folder, recording, bundle)
    text = config.read_text(encoding="utf-8").replace("[inspection]", '[inspection]\npress_again = "unsure"')
    config.write_text(text + extra, encoding="utf-8")
    return config


def played(config: Path) -> tuple[list[dict[str, Any]], list[str], str]:
    """(results, alarms at the end, the text of the alarm that a press is missing)."""
    with SteppedStation(config) as station:
        station.play()
        station.loop.step(None)
        results = [json.loads(report.result.encode()) for report in station.reports]
        retained = {
            message.topic: message.payload for message in station.parts.publisher.retained_state.all()
        }
        text = json.loads(retained.get("alarm/press_again") or b"{}").get("text", "")
        return results, station.raised, text


def test_a_press_a_little_above_the_limit_asks_and_the_lower_score_of_two_is_decided(
    tmp_path: Path, again_bundle: Path
) -> None:
    """The first is unsure, the second passes with its own score; the third is a press of its own. Every press counts
    on the gel, and the pair is in the ledger."""
    results, alarms, _ = played(configured(tmp_path, again_bundle, [0]))
    first, second, third = results
    with closing(sqlite3.connect(tmp_path / "gelgate.db")) as connection:
        pairs = connection.execute("SELECT second_of FROM presses ORDER BY number").fetchall()

    assert [one["verdict"] for one in results] == ["unsure", "pass", "pass"]
    assert first["score"] > first["threshold"]
    assert first["press_again"]["is_asked"] is True
    assert "press the same piece again, a little shifted" in first["press_again"]["reason"]
    assert second["press_again"]["second_of"] == first["press_id"]
    assert second["press_again"]["first_score"] == first["score"]
    assert second["press_again"]["is_asked"] is False
    assert third["press_again"] is None
    assert [one["gel_presses"] for one in results] == [1, 2, 3]
    assert pairs == [(None,), (first["press_id"],), (None,)]
    assert [one for one in check_database(tmp_path / "gelgate.db") if one.is_fault] == []
    assert alarms == []


def test_a_piece_fails_where_both_presses_lie_above(tmp_path: Path, again_bundle: Path) -> None:
    """The damage is there in both. Replay knows that one asked, and what the other was decided with."""
    config = configured(tmp_path, again_bundle, [0, 1])
    results, _, _ = played(config)
    again = gelgate("station", "replay", "--all", "-c", config)

    assert [one["verdict"] for one in results] == ["unsure", "fail", "pass"]
    assert results[1]["press_again"]["reason"].startswith("decided by the lower score of two presses")
    assert again.code == 0, again.out
    assert again.out.count("equal, bit for bit") == 3


def test_a_press_that_does_not_come_in_time_is_said(tmp_path: Path, again_bundle: Path) -> None:
    """With the press that stays unsure; the next press is one of its own, and ends the alarm."""
    config = configured(tmp_path, again_bundle, [2], extra=COSTS + "within_s = 0.5\n")
    with SteppedStation(config) as station:
        station.play()
        station.clock.sleep(1.0)
        station.loop.step(None)
        results = [json.loads(report.result.encode()) for report in station.reports]
        retained = {
            message.topic: message.payload for message in station.parts.publisher.retained_state.all()
        }
        alarms = station.raised

    assert results[2]["verdict"] == "unsure"
    assert alarms == ["press_again"]
    text = json.loads(retained["alarm/press_again"])["text"]
    assert f"the second press after press {results[2]['press_id']} did not come within 0.5 s" in text
    assert "treat the piece as not inspected" in text


def test_a_late_press_is_a_press_of_its_own(tmp_path: Path, again_bundle: Path) -> None:
    """It is not decided with the press before, and the alarm ends."""
    with SteppedStation(configured(tmp_path, again_bundle, [0], extra=COSTS + "within_s = 0.5\n")) as station:
        station.play_until(lambda: len(station.reports) == 1)
        station.clock.sleep(1.0)
        station.play()
        results = [json.loads(report.result.encode()) for report in station.reports]
        alarms = station.raised

    assert [one["verdict"] for one in results] == ["unsure", "pass", "pass"]
    assert [one["press_again"] is None for one in results] == [False, True, True]
    assert alarms == []


def test_a_bundle_without_such_scores_never_asks_and_says_why(
    tmp_path: Path, bundle: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Bundles of earlier versions, and fits without a picture of the free gel."""
    with caplog.at_level(logging.WARNING):
        results, _, _ = played(configured(tmp_path, bundle, [0]))

    assert [one["verdict"] for one in results] == ["fail", "pass", "pass"]
    assert "never: the bundle has no scores of damaged presses" in caplog.text


def test_where_it_does_not_pay_a_press_fails_at_once(tmp_path: Path, again_bundle: Path) -> None:
    """With the costs of the configuration."""
    extra = "[press_again]\nmissed_defect = 1e9\nfalse_alarm = 0\n"
    results, _, _ = played(configured(tmp_path, again_bundle, [0], extra=extra))

    assert [one["verdict"] for one in results] == ["fail", "pass", "pass"]


def test_the_line_of_a_press_says_that_it_asks(tmp_path: Path, again_bundle: Path) -> None:
    """For the person at the terminal."""
    with SteppedStation(configured(tmp_path, again_bundle, [0], presses=2)) as station:
        station.play()
        lines = [press_line(report) for report in station.reports]

    assert ["PRESS AGAIN" in line for line in lines] == [True, False]


def test_a_press_that_waits_is_dropped_with_a_gel_change(tmp_path: Path, again_bundle: Path) -> None:
    """The next press may be of another piece."""
    with SteppedStation(configured(tmp_path, again_bundle, [0])) as station:
        station.play_until(lambda: len(station.reports) == 1)
        station.ask("replace_gel")
        retained = {
            message.topic: message.payload for message in station.parts.publisher.retained_state.all()
        }

    assert (
        "is not waited for any more: the gel was replaced"
        in json.loads(retained["alarm/press_again"])["text"]
    )


def test_inspect_states_what_one_more_press_brings(again_bundle: Path, bundle: Path) -> None:
    """Presses a piece and error rates, at the default costs; or why it is never asked for."""
    stated = gelgate("bundle", "inspect", again_bundle)
    old = gelgate("bundle", "inspect", bundle)

    assert "press again" in stated.out
    assert "never: the bundle has no scores" in old.out


def test_a_second_press_with_the_higher_score_is_decided_by_the_first(again_bundle: Path) -> None:
    """Both lie above, so the piece fails, with the score of its second press."""
    bundle = Bundle.load(again_bundle)
    costs = Costs(missed=1, false_alarm=1000, press=1, defect_rate=0.01)
    again, inspector = PressAgain(costs, 30.0, ManualClock(), Mock()), SimpleNamespace(bundle=bundle)
    again.use(inspector)  # type: ignore[arg-type]
    first, second = (
        again.judge(Press(bundle.manifest.decide(score)), None, inspector)  # type: ignore[arg-type]
        for score in (0.2, 0.3)
    )

    assert (first.word, second.word) == ("unsure", "fail")
    assert second.verdict is not None
    assert (second.verdict.score, second.again and second.again.first_score) == (0.3, 0.2)
