"""A speck on the gel beside the part, seen by a line that lifts for 0.3 s: it fails nothing, and is said. What the part
lacks, or has beside it, fails."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import gelgate
from numpy.typing import NDArray
from scarred_gel import scarred_recording
from station import Motion, small_bundle, station_config
from stepped_station import SteppedStation

from edge.core.verdict import Kind
from edge.messaging.result_payload import ResultPayload

# As faint as dust on a real gel: too little to be a contact. One cell of the tiny detector, 1 mm from the part.
SPECK, LEVELS = (256, 56, 8), 4.0
BRIEF = Motion(idle=6)
SOUND, NO_PIN, BURR, SPECK_FROM, PRESSES = 0, 1, 2, 3, 9


def with_pin(frame: NDArray[np.uint8], press: int) -> NDArray[np.uint8]:
    """The part has a pin 1.5 mm beside its rib; one press is without it, one has a burr on the other side."""
    spots = [] if press == NO_PIN else [(68, 72, 7, 80)]
    spots += [(256, 180, 3, 50)] if press == BURR else []
    for x, y, radius, levels in spots:
        spot = cv2.circle(np.zeros(frame.shape, np.uint8), (x, y), radius, (levels,) * 3, cv2.FILLED)
        frame = cv2.add(frame, spot)
    return frame


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[ResultPayload], list[str]]:
    """The station's folder, its results, and the alarm about the gel after each press, and after a change of gel."""
    folder = tmp_path_factory.mktemp("speck")
    nominal = scarred_recording(
        folder / "nominal", 12, marks={}, on_part=lambda frame, press: with_pin(frame, SOUND)
    )
    film = scarred_recording(
        folder / "film", PRESSES, marks={SPECK_FROM: [SPECK]}, motion=BRIEF, levels=LEVELS, on_part=with_pin
    )
    bundle = small_bundle(folder / "bundle", nominal, threshold=0.02)
    config, alarms = station_config(folder / "station", film, bundle), list[Any]()
    with SteppedStation(config) as station:
        for number in range(1, PRESSES + 1):
            station.play_until(lambda number=number: len(station.reports) == number)  # type: ignore[misc]
            alarms.append(gel_mark(station))
        station.ask("replace_gel", gel_id="new")
        alarms.append(gel_mark(station))
        return config.parent, [report.result for report in station.reports], alarms


def gel_mark(station: SteppedStation) -> str | None:
    """The text of the alarm, None where it is not raised."""
    said = {message.topic: message.payload for message in station.parts.publisher.retained_state.all()}
    payload = said.get("alarm/gel_mark")
    return json.loads(payload)["text"] if payload else None


Played = tuple[Path, list[ResultPayload], list[str]]


def test_a_speck_beside_the_part_fails_nothing(played: Played) -> None:
    """The free gel is never seen long enough to know the speck; the result still has the score with it."""
    with_speck = played[1][SPECK_FROM:]

    assert [one.verdict for one in with_speck] == [Kind.PASS] * 6
    for one in with_speck:
        assert one.score is not None
        assert one.threshold is not None
        assert one.unmasked_score is not None
        assert one.score < one.threshold < one.unmasked_score
        assert one.blind_share == 0


def test_a_sound_press_on_a_clean_gel_has_nothing_left_out(played: Played) -> None:
    assert (played[1][SOUND].verdict, played[1][SOUND].unmasked_score) == (Kind.PASS, None)


@pytest.mark.parametrize("press", [NO_PIN, BURR])
def test_a_missing_pin_and_a_burr_beside_the_part_fail(played: Played, press: int) -> None:
    """The pin lies apart from what this press touches, and nominal presses touch there; the burr touches by itself."""
    assert played[1][press].verdict is Kind.FAIL


def test_a_mark_in_five_presses_in_a_row_is_an_alarm_that_says_where(played: Played) -> None:
    """It rises with the fifth and stays. The speck's middle is (212, 52) in the region's pixels of 0.063 mm."""
    alarms, fifth = played[2], SPECK_FROM + 4

    assert alarms[:fifth] == [None] * fifth
    assert "(13.4, 3.2) mm" in alarms[fifth]
    assert "where the part does not reach" in alarms[fifth]


def test_a_new_gel_ends_the_alarm(played: Played) -> None:
    assert played[2][-2] is not None
    assert played[2][-1] is None


def test_verdicts_without_a_speck_are_made_again(played: Played) -> None:
    """What was left out is archived with the press: all verdicts are equal bit for bit."""
    done = gelgate("station", "replay", "--all", "-c", str(played[0] / "gelgate.toml"))

    assert done.code == 0, done.err
    assert f"{PRESSES} presses: {PRESSES} equal, 0 differ" in done.out
