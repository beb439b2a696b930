"""A scar of the gel at a station: named, masked, more than is accepted, and gone with the gel; across a restart."""

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import gelgate
from scarred_gel import MARK, scarred_recording
from station import station_config
from stepped_station import SteppedStation

from edge.core.gel_scars.causes import Cause
from edge.core.press_label import PressLabel, StudyLabel
from edge.core.verdict import Kind
from edge.features.press_stage import PressStage
from edge.messaging.result_payload import ResultPayload
from edge.store.history import HistoryQuery, read_history

# Of the other marks together, more than a twentieth of the contact once they are masked with their surroundings.
MORE = [(left, top, 8) for left in (112, 160, 200) for top in (72, 144)] + [(184, 112, 8)]


@pytest.fixture(scope="module")
def scarred(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven presses of sound parts, but for the fifth; one mark before the third, seven more before the sixth."""
    folder = tmp_path_factory.mktemp("scarred")
    return scarred_recording(folder / "presses", 7, marks={2: [MARK], 5: MORE}, dented=[4])


@pytest.fixture(scope="module")
def played(
    tmp_path_factory: pytest.TempPathFactory, scarred: Path, bundle: Path
) -> tuple[Path, list[ResultPayload], dict[str, Any]]:
    """The station's folder, its results, and what was retained at the end."""
    config = station_config(tmp_path_factory.mktemp("played"), scarred, bundle)
    with SteppedStation(config) as station:
        station.play()
        return config.parent, [report.result for report in station.reports], retained(station)


def retained(station: SteppedStation) -> dict[str, Any]:
    said = {message.topic: message.payload for message in station.parts.publisher.retained_state.all()}
    return {topic: json.loads(payload) if payload[:1] == b"{" else None for topic, payload in said.items()}


Played = tuple[Path, list[ResultPayload], dict[str, Any]]


def test_a_part_that_fails_because_of_a_scar_has_the_cause_gel(played: Played) -> None:
    """The free gel before the press shows the mark; the presses before it pass, and a pass has no cause."""
    _, results, _ = played

    assert [one.verdict for one in results[:3]] == [Kind.PASS, Kind.PASS, Kind.FAIL]
    assert [one.cause for one in results[:3]] == [None, None, Cause.GEL]
    assert "wipe the gel" in (results[2].cause_text or "")


def test_a_known_scar_is_not_judged_and_the_result_says_how_much_is_not(played: Played) -> None:
    """The next sound part passes; with the scar it would fail, and the result has that score too."""
    result = played[1][3]
    assert result.unmasked_score is not None
    assert result.score is not None
    assert result.threshold is not None

    assert (result.verdict, result.cause) == (Kind.PASS, None)
    assert result.score < result.threshold < result.unmasked_score
    assert result.blind_area_mm2 is not None
    assert 0.25 < result.blind_area_mm2 < 2
    assert result.blind_share is not None
    assert 0 < result.blind_share < 0.05


def test_damage_next_to_a_masked_scar_fails(played: Played) -> None:
    """What is masked is the scar and its surroundings; the dent next to it is found, and is not named gel."""
    result = played[1][4]

    assert result.verdict is Kind.FAIL
    assert result.cause is not Cause.GEL


def test_with_too_much_under_scars_no_press_passes(played: Played) -> None:
    """Seven more scars are named once; then they are masked, and the sound part is unsure because of the gel."""
    _, results, last = played

    assert (results[5].verdict, results[5].cause) == (Kind.FAIL, Cause.GEL)
    assert (results[6].verdict, results[6].cause) == (Kind.UNSURE, Cause.GEL)
    assert (results[6].blind_share or 0) > 0.05
    assert "at most 5% are accepted" in last["alarm/gel_scar"]["text"]


def test_the_history_has_the_causes(played: Played) -> None:
    """As the results had them."""
    folder, results, _ = played
    rows = list(read_history(folder / "gelgate.db", HistoryQuery()))

    assert [row.cause for row in rows] == [one.cause and one.cause.value for one in results]


def test_scars_are_known_after_a_restart_and_forgotten_with_the_gel(
    tmp_path: Path, scarred: Path, bundle: Path
) -> None:
    """A station that ends after the scar was named masks it in its next press; a new gel has no scar and no alarm."""
    config = station_config(tmp_path, scarred, bundle)
    with SteppedStation(config) as station:
        station.play_until(lambda: len(station.reports) == 3)
    with SteppedStation(config) as station:
        station.play_until(lambda: len(station.reports) == 3)
        again = [report.result for report in station.reports]
        station.ask("replace_gel", gel_id="new")
        station.play_until(lambda: len(station.reports) == 4)
        fresh = station.reports[3].result

    assert [one.verdict for one in again] == [Kind.PASS, Kind.PASS, Kind.PASS]
    assert (again[2].blind_share or 0) > 0
    assert fresh.gel_id == "new"
    assert (fresh.blind_share, fresh.unmasked_score) == (0, None)


def test_scars_that_are_only_named_are_judged(tmp_path: Path, scarred: Path, bundle: Path) -> None:
    """For parts of which every place must be judged: each press fails, and the cause says why."""
    config = station_config(tmp_path, scarred, bundle)
    config.write_text(config.read_text().replace("[store]", '[gel]\nscars = "named"\n[store]'))
    with SteppedStation(config) as station:
        station.play_until(lambda: len(station.reports) == 4)
        results = [report.result for report in station.reports]

    assert [one.verdict for one in results[2:]] == [Kind.FAIL, Kind.FAIL]
    assert [one.cause for one in results[2:]] == [Cause.GEL, Cause.GEL]
    assert [one.blind_area_mm2 for one in results[2:]] == [0, 0]


def test_a_verdict_with_masked_scars_is_made_again(played: Played) -> None:
    """The places that were not judged are archived with the press: all seven verdicts are equal bit for bit."""
    done = gelgate("station", "replay", "--all", "-c", str(played[0] / "gelgate.toml"))

    assert done.code == 0, done.err
    assert "7 presses: 7 equal, 0 differ" in done.out


def test_a_press_that_is_no_parts_teaches_no_scar(tmp_path: Path, scarred: Path, bundle: Path) -> None:
    """A gauge study presses one piece again and again: nothing of it is masked, and none of its presses has a cause."""

    class Study(PressStage):
        """Every press is of one piece."""

        def begin(self, label: PressLabel | None) -> PressLabel:
            return StudyLabel("gauge", 1, "7", "A", 1)

    config = station_config(tmp_path, scarred, bundle)
    with SteppedStation(config, labels=Study()) as station:
        station.play_until(lambda: len(station.reports) == 4)
        results = [report.result for report in station.reports]

    assert [(one.cause, one.unmasked_score) for one in results] == [(None, None)] * 4
