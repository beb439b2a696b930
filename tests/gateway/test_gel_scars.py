"""A scar of the gel at a station: named, masked, more than is accepted, and gone with the gel; across a restart."""

from itertools import chain, repeat
from pathlib import Path

import numpy as np
import pytest
from command_line import gelgate
from scarred_gel import MARK, scarred_recording
from station import FPS, HEADER, Motion, gel, jpeg, station_config
from stepped_station import SteppedStation

from edge.core.contact.events import ReferenceCorrected
from edge.core.imaging.quality import Reason, Rejection
from edge.core.press import Press, PressLabel, StudyLabel
from edge.core.verdict import Cause, Kind
from edge.features.scars import ScarWatch
from edge.press_stage import PressStage
from edge.recording.format import RecordingWriter
from edge.store.history import HistoryQuery, read_history

# Of the other marks together, more than a twentieth of the contact once they are masked with their surroundings.
MORE = [(left, top, 8) for left in (112, 160, 200) for top in (72, 144)] + [(184, 112, 8)]


@pytest.fixture(scope="module")
def scarred(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven presses of sound parts, but for the fifth; one mark before the third, seven more before the sixth."""
    folder = tmp_path_factory.mktemp("scarred")
    return scarred_recording(folder / "presses", 7, marks={2: [MARK], 5: MORE}, dented=[4])


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory, scarred: Path, bundle: Path) -> SteppedStation:
    """The station at the end of the recording."""
    with SteppedStation(station_config(tmp_path_factory.mktemp("played"), scarred, bundle)) as station:
        station.play()
    return station


def test_a_part_that_fails_because_of_a_scar_has_the_cause_gel(played: SteppedStation) -> None:
    """The free gel before the press shows the mark; the presses before it pass, and a pass has no cause."""
    causes = [result.cause for result in played.results]

    assert played.verdicts[:3] == [Kind.PASS, Kind.PASS, Kind.FAIL]
    assert causes[:3] == [None, None, Cause.GEL]
    assert "wipe the gel" in (played.results[2].cause_text or "")
    rows = read_history(played.parts.store.path, HistoryQuery())
    assert [row.cause for row in rows] == [cause and cause.value for cause in causes]


BRIEF = {18.75: Motion(idle=6), 10.0: Motion(idle=3, hold=6)}
"""A line that lifts for 0.3 s, by frames a second."""


@pytest.mark.parametrize("fps", BRIEF)
def test_a_new_scar_is_known_where_the_gel_is_free_for_three_tenths_of_a_second(
    tmp_path: Path, bundle: Path, fps: float
) -> None:
    """One frame of the lift shows it; the press after it is judged without it, and damage elsewhere fails."""
    recording = scarred_recording(
        tmp_path / "presses", 5, marks={2: [MARK]}, dented=[4], motion=BRIEF[fps], fps=fps
    )
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        station.play()

    assert station.verdicts == [Kind.PASS, Kind.PASS, Kind.FAIL, Kind.PASS, Kind.FAIL]
    assert [result.cause for result in station.results[2:4]] == [Cause.GEL, None]
    assert station.results[4].cause is not Cause.GEL


@pytest.mark.parametrize(
    ("fps", "rest", "of_damage"), [(18.75, 0.25, 0.25), (10.0, 0.12, 0.12), (18.75, 0.2, 0.35)]
)
def test_what_damaged_parts_leave_on_the_gel_in_such_a_lift_is_no_mark(
    tmp_path: Path, bundle: Path, fps: float, rest: float, of_damage: float
) -> None:
    """Five parts of a broken tool, damaged at one place little above the limit; a share of each imprint is there still
    as the next one comes, and of a deep damage a larger one."""
    motion, time_ns, rng = BRIEF[fps], 0, np.random.default_rng(3)
    left, top, side = MARK
    added = gel(np.random.default_rng(0), 1.0).astype(np.float32) - gel(np.random.default_rng(0))
    added[top : top + side, left : left + side] -= 20
    share = np.full(added.shape, rest, np.float32)
    share[top : top + side, left : left + side] = of_damage
    with RecordingWriter(tmp_path / "presses", HEADER) as writer:
        for press in range(6):
            depths = [0.5, *[1.0] * motion.hold, 0.3] if press else []
            for depth in (*depths, *[0.0] * (motion.idle if press else motion.free)):
                frame = gel(rng).astype(np.float32) + np.maximum(depth, share if press else 0) * added
                writer.add(jpeg(np.clip(frame, 0, 255).astype(np.uint8)), time_ns, {})
                time_ns += round(1e9 / fps)
    with SteppedStation(station_config(tmp_path, tmp_path / "presses", bundle)) as station:
        station.play()

    assert station.verdicts == [Kind.FAIL] * 5
    assert Cause.GEL not in [result.cause for result in station.results]


def test_a_known_scar_is_not_judged_and_the_result_says_how_much_is_not(played: SteppedStation) -> None:
    """The next sound part passes; with the scar it would fail, and the result has that score too. What is masked is the
    scar and its surroundings: the dent next to it is found, and is not named gel."""
    result, dented = played.results[3:5]

    assert (result.verdict, result.cause) == (Kind.PASS, None)
    assert (result.score or 9) < (result.threshold or 0) < (result.unmasked_score or 0)
    assert 0.25 < (result.blind_area_mm2 or 0) < 2
    assert 0 < (result.blind_share or 0) < 0.05
    assert dented.verdict is Kind.FAIL
    assert dented.cause is not Cause.GEL


def test_with_too_much_under_scars_no_press_passes(played: SteppedStation) -> None:
    """Seven more scars are named once; then they are masked, and the sound part is unsure because of the gel."""
    named, masked = played.results[5:7]

    assert (named.verdict, named.cause) == (Kind.FAIL, Cause.GEL)
    assert (masked.verdict, masked.cause) == (Kind.UNSURE, Cause.GEL)
    assert (masked.blind_share or 0) > 0.05
    assert "at most 5% are accepted" in str(played.alarm("gel_scar"))


def test_a_gel_that_was_wiped_is_judged_whole_in_the_next_press(tmp_path: Path, bundle: Path) -> None:
    """A place that stays below the limit hides nothing, and the alarm is gone."""
    recording = scarred_recording(tmp_path / "presses", 4, marks={1: MORE}, wiped=3)
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        station.play_until(lambda: len(station.reports) == 3)
        assert (station.verdicts[1:], station.results[2].cause) == ([Kind.FAIL, Kind.UNSURE], Cause.GEL)
        station.play_until(lambda: len(station.reports) == 4)
        assert (station.verdicts[3], station.results[3].blind_share) == (Kind.PASS, 0)
        assert station.alarm("gel_scar") is None


def test_a_verdict_with_masked_scars_is_made_again(played: SteppedStation) -> None:
    """The places that were not judged are archived with the press: all seven verdicts are equal bit for bit."""
    done = gelgate("station", "replay", "--all", "-c", played.parts.store.path.with_name("gelgate.toml"))

    assert done.code == 0, done.err
    assert "7 presses: 7 equal, 0 differ" in done.out


def test_scars_outlive_a_restart_and_not_the_gel(tmp_path: Path, scarred: Path, bundle: Path) -> None:
    """A station that ends after the scar was named masks it in its next press; a new gel has no scar and no alarm. What
    was found with a picture of the gel that proves wrong is found anew, also after one more restart."""
    config = station_config(tmp_path, scarred, bundle)
    with SteppedStation(config) as station:
        station.play_until(lambda: len(station.reports) == 3)
    with SteppedStation(config) as station:
        station.play_until(lambda: len(station.reports) == 3)
        assert station.verdicts == [Kind.PASS] * 3
        assert (station.results[2].blind_share or 0) > 0
        station.find(ScarWatch).see(ReferenceCorrected(0))
        assert list(tmp_path.rglob("*.scars.npy")) == []
        assert not station.find(ScarWatch)._scars.record.planes.any()
        station.ask("replace_gel", gel_id="new")
        station.play_until(lambda: len(station.reports) == 4)
        fresh = station.results[3]

    assert (fresh.gel_id, fresh.blind_share, fresh.unmasked_score) == ("new", 0, None)


class Study(PressStage):
    """Every press is of one piece."""

    def begin(self, label: PressLabel | None) -> PressLabel:
        return StudyLabel("gauge", 1, "7", "A", 1)


@pytest.mark.parametrize(
    ("tables", "stages", "cause"), [('[gel]\nscars = "named"', {}, Cause.GEL), ("", {"study": Study()}, None)]
)
def test_scars_that_are_not_masked_are_judged(
    tmp_path: Path,
    scarred: Path,
    bundle: Path,
    tables: str,
    stages: dict[str, PressStage],
    cause: Cause | None,
) -> None:
    """For parts of which every place must be judged: each press fails, and the cause says why. And in a gauge study
    one piece is pressed again and again: nothing of it is masked, and no press has a cause."""
    with SteppedStation(station_config(tmp_path, scarred, bundle, tables=tables), stages=stages) as station:
        station.play_until(lambda: len(station.reports) == 4)

    assert stages or station.verdicts[2:] == [Kind.FAIL, Kind.FAIL]
    assert [result.cause for result in station.results] == [None, None, cause, cause]
    assert [result.unmasked_score for result in station.results] == [None] * 4


def test_a_part_that_lies_there_after_an_interruption_is_no_free_gel(tmp_path: Path, bundle: Path) -> None:
    """No picture comes as a damaged part is put on the gel, and it lies there as they come back. Its damage is no mark
    of the gel, so that it is not masked, and the next part with the same damage fails too."""
    before = [*repeat(0.0, 28), 0.5]
    back = [*repeat(1.0, 16), *repeat(0.0, 12)]
    next_part = [0.5, *repeat(1.0, 10), 0.3, *repeat(0.0, 6)]
    rng, time_ns = np.random.default_rng(3), 0
    left, top, side = MARK
    with RecordingWriter(tmp_path / "presses", HEADER) as writer:
        for number, depth in enumerate(chain(before, back, next_part)):
            time_ns += round((2 if number == len(before) else 1 / FPS) * 1e9)
            frame = gel(rng, depth)
            frame[top : top + side, left : left + side] -= np.uint8(70 * depth)
            writer.add(jpeg(frame), time_ns, {})
    with SteppedStation(station_config(tmp_path, tmp_path / "presses", bundle)) as station:
        station.play()

    assert station.verdicts == [Kind.FAIL, Kind.FAIL]
    assert Cause.GEL not in [result.cause for result in station.results]


class Refusing(PressStage):
    """Refuses the first press, as where no piece was begun."""

    def __init__(self) -> None:
        self._is_begun = False

    def admit(self, press: Press) -> Press:
        is_begun, self._is_begun = self._is_begun, True
        return press if is_begun else press.reject(Rejection(Reason.NO_PLACE, "begin a piece"))


def test_what_a_damaged_part_that_was_refused_leaves_on_the_gel_is_no_mark(
    tmp_path: Path, bundle: Path
) -> None:
    """A quarter of its imprint, which no judged press has shown, is there still as it is pressed again and again; it is
    damaged little above the limit, so that the limit is kept without that quarter."""
    rng, time_ns, rest = np.random.default_rng(3), 0, np.float32(0)
    left, top, side = MARK
    flat, pressed = (gel(np.random.default_rng(0), depth).astype(np.float32) for depth in (0.0, 1.0))
    pressed[top : top + side, left : left + side] -= 20
    with RecordingWriter(tmp_path / "presses", HEADER) as writer:
        for _ in range(4):
            for depth in (*repeat(0.0, 28), 0.5, *repeat(1.0, 12), 0.3):
                frame = gel(rng, depth).astype(np.float32) + (0 if depth else rest)
                frame[top : top + side, left : left + side] -= 20 * depth
                writer.add(jpeg(np.clip(frame, 0, 255).astype(np.uint8)), time_ns, {})
                time_ns += round(1e9 / FPS)
            rest = np.float32(0.25) * (pressed - flat)
    config = station_config(tmp_path, tmp_path / "presses", bundle)
    with SteppedStation(config, stages={"refusing": Refusing()}) as station:
        station.play()

    assert station.verdicts == [Kind.REJECTED, *[Kind.FAIL] * 3]
    assert Cause.GEL not in [result.cause for result in station.results]
