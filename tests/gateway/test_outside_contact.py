"""A speck on the gel beside the part, seen by a line that lifts for 0.3 s: it fails nothing, and is said. What the part
lacks, or has beside it, fails."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scarred_gel import scarred_recording
from station import Motion, small_bundle, station_config, variant
from stepped_station import SteppedStation

from edge.core.verdict import Kind

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
def pinned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle fitted on six sound presses of the part."""
    folder = tmp_path_factory.mktemp("pinned")
    nominal = scarred_recording(
        folder / "nominal", 6, marks={}, motion=BRIEF, on_part=lambda frame, press: with_pin(frame, SOUND)
    )
    return small_bundle(folder / "bundle", nominal, threshold=0.02)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory, pinned: Path) -> tuple[SteppedStation, list[str | None]]:
    """The station, and its alarm about the gel after each press, and after a change of gel."""
    folder = tmp_path_factory.mktemp("speck")
    film = scarred_recording(
        folder / "film", PRESSES, marks={SPECK_FROM: [SPECK]}, motion=BRIEF, levels=LEVELS, on_part=with_pin
    )
    alarms = []
    with SteppedStation(station_config(folder / "station", film, pinned)) as station:
        for number in range(1, PRESSES + 1):
            station.play_until(lambda number=number: len(station.reports) == number)  # type: ignore[misc]
            alarms.append(station.alarm("gel_mark"))
        station.ask("replace_gel", gel_id="new")
        return station, [*alarms, station.alarm("gel_mark")]


Played = tuple[SteppedStation, list[str | None]]


def test_a_speck_beside_the_part_fails_nothing(played: Played) -> None:
    """The free gel is never seen long enough to know the speck; the result still has the score with it. A sound press
    on a clean gel has nothing left out."""
    results = played[0].results
    for result in results[SPECK_FROM:]:
        assert result.verdict is Kind.PASS
        assert (result.score or 9) < (result.threshold or 0) < (result.unmasked_score or 0)
        assert result.blind_share == 0
    assert (results[SOUND].verdict, results[SOUND].unmasked_score) == (Kind.PASS, None)


def test_a_missing_pin_and_a_burr_beside_the_part_fail(played: Played) -> None:
    """The pin lies apart from what this press touches, and nominal presses touch there; the burr touches by itself."""
    assert [played[0].verdicts[press] for press in (NO_PIN, BURR)] == [Kind.FAIL] * 2


def test_a_mark_in_five_presses_in_a_row_is_an_alarm_that_says_where(played: Played) -> None:
    """It rises with the fifth and stays, until the gel is another. The speck's middle is (212, 52) in the region's
    pixels of 0.063 mm."""
    alarms, fifth = played[1], SPECK_FROM + 4

    assert alarms[:fifth] == [None] * fifth
    assert all("13.4 mm from the left and 3.2 mm from the top" in str(alarm) for alarm in alarms[fifth:-1])
    assert "where the part does not reach" in str(alarms[fifth])
    assert alarms[-1] is None


@pytest.mark.parametrize("threshold", [0.3, 0.1])
def test_a_strong_speck_is_said_in_five_presses_and_ends_where_it_is_wiped_off(
    tmp_path: Path, pinned: Path, threshold: float
) -> None:
    """Whether presses exceed the limit by it or not: it shows as much as something that touches, and no press is
    failed by it, for it was there just before. The picture shows the place at half its light. A missing pin fails
    meanwhile."""
    wiped, no_pin = SPECK_FROM + 6, SPECK_FROM + 5
    film = scarred_recording(
        tmp_path / "film",
        wiped + 2,
        marks={SPECK_FROM: [SPECK]},
        wiped=wiped,
        motion=BRIEF,
        levels=30,
        on_part=lambda frame, press: with_pin(frame, NO_PIN if press == no_pin else SOUND),
    )
    bundle, alarms = variant(pinned, tmp_path / "bundle", threshold={"value": threshold}), []
    with SteppedStation(station_config(tmp_path / "station", film, bundle)) as station:
        for number in range(1, wiped + 3):
            station.play_until(lambda number=number: len(station.reports) == number)  # type: ignore[misc]
            alarms.append(station.alarm("gel_mark"))

    fifth = SPECK_FROM + 4
    assert alarms[:fifth] + alarms[wiped:] == [None] * (fifth + 2)
    where = re.compile(r"same mark 13\.4 mm from the left and 3\.[23] mm from the top")
    assert all(where.search(str(alarm)) for alarm in alarms[fifth:wiped])
    assert station.verdicts == [Kind.PASS] * no_pin + [Kind.FAIL] + [Kind.PASS] * 2
    shown = [result.unmasked_score is not None for result in station.results]
    assert shown == [SPECK_FROM + 4 * (threshold > 0.2) <= number < wiped for number in range(wiped + 2)]
