"""A study on a station: each press is the next step of the plan; interruption, repetition, skipping, another gel."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import gelgate
from station import Motion, press_recording, small_bundle, station_config
from stepped_station import SteppedStation

from calibration.experiments.gauge.live import StudyLabels, prepare_labels
from calibration.experiments.gauge.plan import Piece, StudyPlan, make_plan
from edge.core.errors import ConfigError
from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import check_database
from edge.store.outbox import Outbox
from edge.store.press_store import Store
from edge.store.study_presses import StudyPress, read_study

T0 = 1_780_000_000 * 10**9


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration whose sensor is a recording of five presses, the third dented."""
    folder = tmp_path_factory.mktemp("study")
    bundle = small_bundle(folder / "pz0", press_recording(folder / "nominal", 8, seed=1))
    recording = press_recording(folder / "presses", 5, dented=[2], seed=2)
    return station_config(folder / "station", recording, bundle)


@pytest.fixture
def config(station: Path) -> Iterator[Path]:
    """With a new database."""
    yield station
    for file in station.parent.glob("gelgate.db*"):
        if file.is_file():
            file.unlink()


@pytest.fixture
def small() -> StudyPlan:
    """Two pieces, two operators, two repeats: eight presses."""
    pieces = [Piece(name="P1", known="pass"), Piece(name="P2", known="fail")]
    return make_plan(pieces, ["A", "B"], 2, seed=1, time_ns=T0)


@contextmanager
def running(
    config: Path, plan: StudyPlan, said: list[str]
) -> Iterator[tuple[SteppedStation, StudyLabels, list[bool]]]:
    """A station with the plan's labels; the list is filled when the run would end."""
    stopped: list[bool] = []
    with Store(config.parent / "gelgate.db") as store:
        labels = prepare_labels(plan, store, said.append, lambda: stopped.append(True))
        with SteppedStation(config, stages={"reference_press": labels}) as station:
            yield station, labels, stopped


def rows(config: Path, plan: StudyPlan) -> list[StudyPress]:
    found = read_study(config.parent / "gelgate.db", plan.study_id)
    assert found is not None
    return found[1]


def until(station: SteppedStation, number: int) -> None:
    station.play_until(lambda: len(station.reports) == number and not station.loop.session.has_contact)


def test_each_press_is_the_next_step_and_no_result(config: Path, small: StudyPlan) -> None:
    """It counts on the gel; nothing is published of it but the gel, so that who presses does not see a verdict."""
    said: list[str] = []
    with running(config, small, said) as (station, labels, stopped):
        until(station, 3)
        left = labels.left
    found = rows(config, small)
    with Outbox(config.parent / "gelgate.db") as outbox:
        outbox.register(["test"])
        topics = {row.message.topic.split("/")[0] for row in outbox.pending("test", 100)}

    assert [(one.operator, one.piece, one.repeat) for one in found] == [
        (step.operator, step.piece, step.repeat) for step in small.order[:3]
    ]
    assert [one.verdict for one in found] == ["pass", "pass", "fail"]
    assert (left, stopped) == (5, [])
    assert said[0].startswith("press 1 of 8: operator ")
    assert len([line for line in said if line.startswith("press ")]) == 4
    assert list(read_history(config.parent / "gelgate.db", HistoryQuery())) == []
    assert topics == {"gel"}
    assert check_database(config.parent / "gelgate.db") == []


def test_an_interrupted_study_goes_on(config: Path, small: StudyPlan) -> None:
    """The second run asks for what is left, and stops at the end of the plan: no later press is a part's."""
    with running(config, small, []) as (station, _, _):
        until(station, 5)
    said: list[str] = []
    with running(config, small, said) as (station, labels, stopped):
        until(station, 3)
        left = labels.left

    assert said[0].startswith("press 6 of 8: ")
    assert (left, bool(stopped)) == (0, True)
    assert sorted(one.step for one in rows(config, small)) == list(range(8))


def test_a_press_is_repeated_and_one_is_skipped(config: Path, small: StudyPlan) -> None:
    """The first row stays and does not count; what was skipped is asked for at the next run."""
    said: list[str] = []
    with running(config, small, said) as (station, labels, _):
        labels.keys.put("r")
        station.play_until(lambda: station.loop.session is not None)
        station.loop.step(None)
        nothing_yet = "there is no press of this run to repeat" in said
        until(station, 1)
        labels.keys.put("r")
        until(station, 2)
        labels.keys.put("s")
        labels.keys.put("x")
        until(station, 3)
        left = labels.left
    found = rows(config, small)
    again = list[str]()
    with running(config, small, again) as (station, _, _):
        station.play_until(lambda: station.loop.session is not None)

    assert nothing_yet
    assert [(one.step, one.is_void) for one in found] == [(0, True), (0, False), (2, False)]
    assert left == 6
    assert any("'x' is no key" in line for line in said)
    assert again[0].startswith("press 2 of 8: ")
    assert check_database(config.parent / "gelgate.db") == []


def test_a_press_without_a_score_is_asked_for_again(config: Path, small: StudyPlan) -> None:
    """It stays as a row, counts on the gel, and the plan does not go on."""
    said: list[str] = []
    with running(config, small, said) as (station, labels, _):
        station.play_until(lambda: station.loop.session is not None)
        station.parts.selection.inspector.fault = "the golden frames score otherwise"
        until(station, 1)
        station.parts.selection.inspector.fault = None
        until(station, 2)
        left = labels.left
    found = rows(config, small)

    assert [(one.step, one.verdict) for one in found] == [(0, "error"), (0, "pass")]
    assert found[0].reason == "the golden frames score otherwise"
    assert left == 7
    assert f"no score: the golden frames score otherwise; press {small.order[0].piece} again" in said


def test_another_gel_in_the_middle_ends_the_run(config: Path, small: StudyPlan) -> None:
    """With what it was and is; no press is made with it."""
    with running(config, small, []) as (station, _, _):
        until(station, 2)
    with Store(config.parent / "gelgate.db") as store:
        store.replace_gel("TEST0001", T0, "second")
    with running(config, small, []) as (station, labels, stopped):
        station.play_until(lambda: station.loop.session is not None)
        station.loop.step(None)

    assert stopped
    assert labels.fault is not None
    assert "another gel TEST0001-1 before and second now" in labels.fault
    assert len(rows(config, small)) == 2


def test_a_plan_that_was_changed_since_its_beginning_is_refused(config: Path, small: StudyPlan) -> None:
    """The same study with another order."""
    other = make_plan(small.pieces, small.operators, 2, seed=2, time_ns=T0).model_copy(
        update={"study_id": small.study_id}
    )
    with Store(config.parent / "gelgate.db") as store:
        prepare_labels(small, store, print, print)
        with pytest.raises(ConfigError, match=r"was changed since it was begun; use the file as it was"):
            prepare_labels(other, store, print, print)


def test_the_command_line_from_plan_to_report(config: Path, tmp_path: Path) -> None:
    """Planned, run twice on a recording of five presses until the eight are there, and reported in every form."""
    study, words = tmp_path / "study.json", ("--pieces", 2, "--operators", 2, "--repeats", 2, "--seed", 1)
    for code, said, arguments in (
        (0, "8 presses in ", ("plan", "-o", study, *words, "--bad", "P2")),
        (3, "name another file", ("plan", "-o", study, *words)),
        (3, "does not exist", ("report", "-c", config)),
        (0, "3 presses are left", ("run", study, "-c", config)),
        (3, "`gelgate lab msa run` goes on", ("report", study, "-c", config)),
        (0, "the study is complete", ("run", study, "-c", config)),
        (0, "Gauge R&R of the score", ("report", "-c", config)),
        (3, "has no study 'other'", ("report", "other", "-c", config)),
        (0, "", ("report", study, "-c", config, "-o", tmp_path / "a.md")),
        (0, "", ("report", study, "-c", config, "-o", tmp_path / "a.csv")),
        (3, "known are .md, .csv", ("report", study, "-c", config, "-o", tmp_path / "a.pdf")),
    ):
        done = gelgate("lab", "msa", *arguments)
        assert done.code == code, arguments
        assert said in (done.err if code else done.out)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("plan", "--pieces", "1"), "at least 2 pieces, found 1"),
        (("plan", "--operators", "1"), "at least 2 operators, found 1"),
        (("plan", "--repeats", "1"), "at least 2 repeats, found 1"),
        (("plan", "--bad", "P11"), "no piece is named 'P11'"),
        (("run", "none.json"), "plan none.json cannot be read"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(
    words: tuple[str, ...], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = gelgate("lab", "msa", *words)

    assert (done.code, sentence in done.sentence()) == (3, True)


def test_a_press_that_was_lifted_before_it_rested_is_said(tmp_path: Path, small: StudyPlan) -> None:
    """It counts as it would in operation, and the person may repeat it."""
    bundle = small_bundle(tmp_path / "pz0", press_recording(tmp_path / "nominal", 8, seed=1))
    said: list[str] = []
    film = press_recording(tmp_path / "film", 1, motion=Motion(hold=3, idle=10), seed=4)
    with running(station_config(tmp_path, film, bundle), small, said) as (station, labels, _):
        station.play_presses(1)
    assert labels.left == 7
    assert any("lifted before it rested" in line and "repeats it" in line for line in said)
