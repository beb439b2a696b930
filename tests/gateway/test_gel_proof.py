"""A new gel through a station: the state says that the bundle is not yet proven on it, until presses have shown it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.core.verdict import Kind
from edge.features.gel_proof import GelProofWatch

Config = Callable[..., Path]


@pytest.fixture(scope="module")
def presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five presses, the fourth one dented."""
    folder = tmp_path_factory.mktemp("proof") / "presses"
    return press_recording(folder, 5, dented=[3], motion=Motion(hold=8, idle=34), seed=5)


@pytest.fixture
def config(tmp_path: Path, presses: Path, bundle: Path) -> Config:
    """A station whose gel is replaced."""

    def made(unproven: str = "warn") -> Path:
        path = station_config(tmp_path, presses, bundle)
        path.write_text(path.read_text().replace("[store]", f'[gel]\nunproven = "{unproven}"\n[store]'))
        return path

    return made


def until_press(station: SteppedStation, number: int) -> None:
    """Play until this number of presses is recorded, and the gel is free again."""
    station.play_until(lambda: len(station.reports) == number and not station.loop.session.has_contact)


def replace(station: SteppedStation) -> None:
    """A new gel; the loop looks at it with the next frame, and learns its picture."""
    station.ask("replace_gel")
    station.play(30)


def said(station: SteppedStation, topic: str) -> dict[str, Any] | None:
    """What is retained there now."""
    kept = {message.topic: message.payload for message in station.parts.publisher.retained_state.all()}
    return json.loads(kept[topic]) if kept.get(topic) else None


def unproven(station: SteppedStation) -> str | None:
    state = said(station, "state")
    assert state is not None
    return state["unproven"]


def test_a_new_gel_is_said_in_the_state_and_as_an_alarm(config: Config) -> None:
    """With the gel before, the presses since and what to do; the verdicts stay as they are."""
    with SteppedStation(config()) as station:
        until_press(station, 1)
        before = unproven(station), said(station, "alarm/gel_proof")
        replace(station)
        until_press(station, 3)
        text, alarm = unproven(station), said(station, "alarm/gel_proof")
        verdicts = [report.result.verdict for report in station.reports]

    assert before == (None, None)
    assert text is not None
    assert alarm is not None
    assert text.startswith("bundle PZ0/pos1 (")
    assert (
        "is not yet proven on gel TEST0001-2: it was used on gel TEST0001-1; 2 presses on this gel with"
        in text
    )
    assert (alarm["text"], alarm["severity"]) == (text, "warning")
    assert verdicts == [Kind.PASS] * 3


def test_it_is_said_after_a_restart_too(config: Config) -> None:
    """With the presses of the process before."""
    path = config()
    with SteppedStation(path) as station:
        until_press(station, 1)
        replace(station)
        until_press(station, 3)
    with SteppedStation(path) as again:
        again.play_until(lambda: again.loop.session is not None)
        text = unproven(again)

    assert text is not None
    assert "2 presses on this gel with no alarm" in text


def test_an_alarm_is_counted(config: Config) -> None:
    """A damaged part on the new gel is one, for the station does not know that it is damaged."""
    with SteppedStation(config()) as station:
        until_press(station, 1)
        replace(station)
        until_press(station, 4)
        text = unproven(station)

    assert text is not None
    assert "3 presses on this gel with 1 alarm allow" in text


def test_parts_are_refused_where_that_is_configured(config: Config) -> None:
    """The station halts, and a press is rejected with the reason; it is not scored and does not count."""
    with SteppedStation(config("refuse")) as station:
        until_press(station, 1)
        replace(station)
        halted = said(station, "state")
        until_press(station, 2)
        result = station.reports[-1].result
        text = unproven(station)

    assert halted is not None
    assert halted["state"] == "halted"
    assert result.verdict is Kind.REJECTED
    assert result.score is None
    assert result.reason is not None
    assert result.reason.startswith("gel_proof: bundle PZ0/pos1")
    assert text is not None
    assert "no press on this gel yet" in text


def test_it_may_be_said_in_the_state_alone(config: Config) -> None:
    """With `off` there is no alarm."""
    with SteppedStation(config("off")) as station:
        until_press(station, 1)
        replace(station)
        text, alarm = unproven(station), said(station, "alarm/gel_proof")

    assert text is not None
    assert alarm is None


def test_the_word_of_a_person_ends_it_once_presses_are_enough(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, the request is refused with what is missing."""
    with SteppedStation(config()) as station:
        until_press(station, 1)
        replace(station)
        until_press(station, 2)
        with pytest.raises(ValueError, match="Press 21 more sound parts"):
            station.find(GelProofWatch).prove()
        monkeypatch.setattr("edge.core.gel_proof.PROVEN_RATE", 0.95)
        station.find(GelProofWatch).prove()
        after = unproven(station), said(station, "alarm/gel_proof")

    assert after == (None, None)
