"""A person says what a press was: the ledger keeps it beside the verdict, and the station asks for doubtful ones."""

import json
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from command_line import gelgate
from page_messages import ask, asked
from ports import free_port
from shadow_station import FIVE
from sql import connection_of, count_steps, execute
from station import Configure, Motion, press_recording, station_config, variant
from stepped_station import SteppedStation

from edge.config.feature_tables import ConfirmTable
from edge.core.press import ReferenceLabel
from edge.features.outputs.stage import Outputs
from edge.features.person_verdicts import PersonVerdicts
from edge.gateway.commands import Change, CommandPolicy, Commands
from edge.messaging.status_payloads import Question, QuestionsPayload
from edge.page.shown import readable
from edge.store.acts import CONFIRM, Act
from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import check_database
from edge.store.person_verdicts import ask_again, read_spoken_of, read_verdicts
from edge.store.ulid import new_ulid

UNKNOWN = new_ulid(1, lambda k: bytes(k))
NOBODY_ASKED = "[confirm]\nquestions_per_day = 0"
"""People may speak all the same: at a pedal, or over MQTT."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four presses, the third one dented."""
    folder = tmp_path_factory.mktemp("said") / "presses"
    return press_recording(folder, 4, dented=[2], motion=Motion(hold=8, idle=28), seed=5)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, recording: Path, bundle: Path) -> SteppedStation:
    """A station that has ended; all four are recorded."""
    with SteppedStation(station_config(tmp_path_factory.mktemp("recorded"), recording, bundle)) as station:
        station.play_presses(4)
    return station


@pytest.fixture
def played(tmp_path: Path, recorded: SteppedStation) -> Iterator[SteppedStation]:
    """A copy of it that was started again: it has its gel, and has asked."""
    shutil.copytree(recorded.parts.store.path.parent, tmp_path, dirs_exist_ok=True)
    with SteppedStation(tmp_path / "gelgate.toml") as station:
        station.clock.sleep(recorded.clock.monotonic_ns() / 1e9)
        station.reports = recorded.reports
        station.play(3)
        settle(station)
        yield station


def settle(station: SteppedStation) -> None:
    station.clock.sleep(1.5)
    station.turn()


def say(station: SteppedStation, by: str = "kim") -> Callable[..., dict[str, object]]:
    """Ask as a person at the page does; returns the response."""
    root = station.parts.config.station.place.root
    policy = CommandPolicy(root, frozenset(), page=frozenset({"confirm_press"}))
    handlers = {"confirm_press": lambda given: Change(station.ask("confirm_press", **given))}
    commands = Commands(handlers, policy, station.parts.store, station.clock)
    number = iter(range(100))

    def do(**arguments: object) -> dict[str, object]:
        request = {"transaction": f"{by}{next(number)}", "by": by, "arguments": arguments}
        response: dict[str, object] = json.loads(
            commands.from_page("confirm_press", json.dumps(request).encode())
        )
        return response

    return do


@pytest.mark.parametrize("removed", ["", "objects/*"])
def test_a_press_whose_archive_is_gone_is_not_archived(played: SteppedStation, removed: str) -> None:
    """The row alone still names its record, or the record its frame."""
    press_id = played.results[0].press_id
    archive = played.parts.store.path.with_suffix(".archive")
    for path in archive.glob(removed) if removed else [archive]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    response: Any = say(played)(press_id=press_id, verdict="good")

    assert response["data"]["is_archived"] is False


def test_a_good_word_says_what_must_come_until_such_a_press_passes(played: SteppedStation) -> None:
    """On the gel of the bundle: good presses that it fails, for a takeover, or time. On another gel: good presses of
    it, for learning, of whatever verdict. Of a pass nothing has to come."""
    dented, passed = (played.results[k].press_id for k in (2, 0))
    confirm = say(played)

    def remark(press_id: str) -> list[str]:
        response: Any = confirm(press_id=press_id, verdict="good")
        settle(played)
        return list(response["data"]["remarks"])

    first, again = remark(dented), remark(dented)
    assert remark(passed) == []
    assert "`gelgate bundle learn`" in first[0]
    assert "until it may take over: 4, or it waits until both have judged 100" in first[0]
    assert again == first
    execute(played.parts.store.path, "UPDATE gel_proofs SET proven = NULL")
    assert [remark(press_id)[0][-3:] for press_id in (dented, passed)] == [": 2", ": 2"]
    assert "is not proven on this gel" in remark(passed)[0]


@pytest.fixture(scope="module")
def say_wrong(
    tmp_path_factory: pytest.TempPathFactory, recording: Path, bundle: Path
) -> Iterator[Callable[..., dict[str, object]]]:
    """Ask one station for all that it refuses."""
    with SteppedStation(station_config(tmp_path_factory.mktemp("wrong"), recording, bundle)) as station:
        yield say(station)


def test_a_word_is_kept_beside_the_verdict_and_the_press_is_not_asked_for_again(
    played: SteppedStation, tmp_path: Path
) -> None:
    """The verdict stays; the ledger is sound; the history has both; a restart knows what was said."""
    dented = played.results[2]
    before = played.said("questions")

    response = say(played)(press_id=dented.press_id, verdict="damaged", kind="dent")
    settle(played)
    after = played.said("questions")
    again = say(played, "lee")(press_id=dented.press_id, verdict="damaged")
    settle(played)

    assert played.said("questions") == after  # also when it was made: what is not new is not said again
    assert dented.press_id in [one["press_id"] for one in before["presses"]]
    assert response["data"] == {
        "press_id": dented.press_id,
        "verdict": "fail",
        "is_archived": True,
        "earlier": [],
        "remarks": [],
    }
    assert again["data"]["earlier"] == ["kim: damaged"]  # type: ignore[index]
    assert dented.press_id not in [one["press_id"] for one in after["presses"]]
    assert (before["answered_today"], after["answered_today"]) == (0, 1)
    path = played.parts.store.path
    assert [one for one in check_database(path) if one.is_fault] == []
    rows = list(read_history(path, HistoryQuery()))
    assert [(row.verdict, row.person_verdict, row.person) for row in rows] == [
        ("pass", None, None),
        ("pass", None, None),
        ("fail", "damaged", "lee"),
        ("pass", None, None),
    ]
    assert gelgate("history", "--by", "part", "-c", tmp_path / "gelgate.toml").out == (
        "PZ0/pos1: 4 presses, yield 75.0%; false alarms: 0 of 1 judged fail (0% to 90%); escapes: not known, "
        "nobody judged a pass\n"
    )
    played.__exit__(None, None, None)
    with SteppedStation(tmp_path / "gelgate.toml") as restarted:
        settle(restarted)
        assert restarted.said("questions")["answered_today"] == 1


def test_after_a_restart_the_page_shows_its_presses_and_what_it_asks_about(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """The pictures are drawn again from the archive: the same ones. They can be answered before a gel is seen."""
    port = free_port()
    sinks = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port} }}\n'
    pictures, listed = list[list[tuple[int, bytes]]](), list[list[dict[str, Any]]]()
    for attempt in range(2):
        with SteppedStation(station_config(tmp_path, recording, bundle, sinks=sinks)) as station:
            if attempt == 0:
                station.play_presses(4)
            settle(station)
            for _ in range(50):
                station.publish()
            ids = [one["press_id"] for one in station.said("questions")["presses"]]
            assert sorted(asked(port, "/station.json")["pictures"]) == ids
            listed.append(asked(port, "/presses.json"))
            pictures.append([ask(port, f"/pictures/{one}") for one in ids])
            if attempt == 1:
                answer: Any = say(station)(press_id=ids[0], verdict="good")

    assert answer["data"]["remarks"] == []
    assert len(pictures[0]) == 4
    assert pictures[0] == pictures[1]
    assert {status for status, _ in pictures[0]} == {200}
    new, old = listed
    assert [one.pop("is_earlier", False) for one in old] == [True] * 4
    assert [one["press_id"] for one in old] == [one["press_id"] for one in new]
    assert all(one.items() <= known.items() for one, known in zip(old, new, strict=True))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"press_id": UNKNOWN, "verdict": "good"}, "is not in the history of this station"),
        ({"press_id": "last", "verdict": "good"}, "press_id: it has another form than expected"),
        ({"verdict": "good"}, "press_id: Field required"),
        (
            {"press_id": "", "verdict": "bad"},
            "verdict: Input should be 'good', 'damaged', 'gel' or 'cannot_tell'",
        ),
        ({"press_id": None, "verdict": "good", "kind": "burr"}, "press_id"),
        (
            {"press_id": UNKNOWN, "verdict": "good", "kind": "burr"},
            "kind is of a damage, and the verdict is good",
        ),
    ],
)
def test_what_cannot_be_kept_is_refused_with_a_sentence(
    say_wrong: Callable[..., dict[str, object]], arguments: dict[str, object], sentence: str
) -> None:
    response = say_wrong(**arguments)

    assert response["status"] == "error"
    assert sentence in str(response["error"])


@pytest.mark.parametrize(("one", "other"), [("kim", "lee"), ("Meier, Kim", "Meier, Lee")])
def test_people_who_contradict_each_other_cannot_tell(played: SteppedStation, one: str, other: str) -> None:
    """The history has both names; those with a comma are two people."""
    press_id = played.results[0].press_id
    say(played, one)(press_id=press_id, verdict="good")
    say(played, other)(press_id=press_id, verdict="damaged")

    (row, *_) = read_history(played.parts.store.path, HistoryQuery())

    assert (row.person_verdict, row.person, row.verdict) == ("cannot_tell", f"{one}, {other}", "pass")


def test_a_person_is_one_at_every_page(played: SteppedStation) -> None:
    """Also at that of another machine, whose requests come over MQTT: one voice, of which the newest word counts."""
    store, press_id = played.parts.store, played.results[0].press_id
    for who, word in (("kim, at the page", "damaged"), ("kim, at a page, over MQTT, signed", "good")):
        given = {"press_id": press_id, "verdict": word}
        store.begin_act(Act(1, who, CONFIRM, None, given, outcome="done"), 0)
    words = store.read("reading", partial(read_verdicts, press_id=press_id))[press_id]

    assert [one.person for one in words] == ["kim", "kim"]


def test_the_most_questions_that_can_be_configured_fit_on_the_page() -> None:
    """With long names of parts; a page refuses a payload that is too long."""
    (most,) = (
        one.le for one in ConfirmTable.model_fields["questions_per_day"].metadata if hasattr(one, "le")
    )
    name, time_ns = "\N{GREEK SMALL LETTER PI}" * 64, 1_790_000_000_000_000_000
    questions = tuple(
        Question(
            press_id=new_ulid(time_ns + number),
            time_ns=time_ns,
            time_ms=time_ns // 1_000_000,
            verdict="unsure",
            score_ratio=0.9876543210987654,
            part=name,
            position=name,
        )
        for number in range(most)
    )
    payload = QuestionsPayload(time_ns=time_ns, per_day=most, presses=questions)

    assert len(readable("questions", payload.message().payload)["presses"]) == most


def test_what_was_said_long_ago_takes_the_loop_no_time(played: SteppedStation) -> None:
    """The steps of SQLite for what was said on the last day, by 30 words of long ago and by 300: at most ten more."""
    store, press_id, steps = played.parts.store, played.results[0].press_id, []
    for words in (30, 270):
        given = {"press_id": press_id, "verdict": "good"}
        for time_ns in range(words):
            store.begin_act(Act(time_ns, "pedal", CONFIRM, None, given, outcome="done"))
        since_ns = time.time_ns()
        execute(store.path, "UPDATE acts SET running_ns = running_ns - 172800000000000")
        store.begin_act(Act(since_ns, "pedal", "begin_piece", outcome="done"))
        with count_steps(connection_of(store)) as counted:
            assert store.read("counting", partial(read_verdicts, since_ns=since_ns)) == {}
        steps.append(len(counted))
        after, _ = store.read("counting", partial(read_spoken_of, after=0))
        with count_steps(connection_of(store)) as counted:
            assert store.read("counting", partial(read_spoken_of, after=after)) == (after, set())
        steps.append(len(counted))

    assert steps[2] <= steps[0] + 1
    assert steps[3] <= steps[1] + 1


def test_an_act_under_a_clock_that_is_behind_ends_no_word(played: SteppedStation) -> None:
    """As after a start without a battery of the clock: what was said an hour ago was said on the last day."""
    store, press_id, now_ns = played.parts.store, played.results[0].press_id, time.time_ns()
    given = {"press_id": press_id, "verdict": "damaged"}
    store.begin_act(Act(now_ns - 3600 * 10**9, "pedal", CONFIRM, None, given, outcome="done"))
    store.begin_act(Act(now_ns - 30 * 86_400 * 10**9, "pedal", "begin_piece", outcome="done"))
    since_ns = now_ns - 86_400 * 10**9
    assert list(store.read("reading", partial(read_verdicts, since_ns=since_ns))) == [press_id]
    assert store.read("reading", partial(read_verdicts, since_ns=now_ns)) == {}


def test_at_most_the_configured_number_is_asked_on_a_day(configure: Configure) -> None:
    """Two a day: in the evening after two answers none is asked, and on the next morning the others are."""
    config = configure(tables="[confirm]\nquestions_per_day = 2")
    with SteppedStation(config) as station:
        station.clock.sleep(20 * 3600)
        station.play_presses(4)
        settle(station)
        asked = station.said("questions")["presses"]
        answer = say(station)
        for one in asked:
            answer(press_id=one["press_id"], verdict="good")
        settle(station)
        then = station.said("questions")["presses"]
        station.clock.sleep(13 * 3600)
        station.turn()
        later = station.said("questions")["presses"]
        station.clock.sleep(13 * 3600)
        station.turn()

        assert (len(asked), then) == (2, [])
        assert len({one["press_id"] for one in [*asked, *later]}) == 4
        assert station.said("questions")["presses"] == []  # of yesterday


@pytest.mark.parametrize(
    ("colours", "is_new"), [({}, True), ({"limit": 1e-9}, True), ({"limit": 1e-9}, False)]
)
def test_on_a_new_gel_its_presses_alone_are_asked_about(
    tmp_path: Path, recording: Path, bundle: Path, colours: dict[str, float], is_new: bool
) -> None:
    """Until the bundle is proven there: what is learnt of this gel is learnt from them, also where they were refused
    for their colours and have no score. On a known gel these are another sensor's."""
    judging = variant(bundle, tmp_path / "judging", colours=colours)
    with SteppedStation(station_config(tmp_path, recording, judging)) as station:
        station.play_presses(1)
        station.clock.sleep(1)
        if is_new:
            station.ask("replace_gel")
        station.play_presses(4)
        settle(station)
        asked = station.said("questions")["presses"]
        ids = [one.press_id for one in station.results]

    assert sorted(one["press_id"] for one in asked) == (sorted(ids[1:]) if is_new else [])
    if colours:
        assert station.verdicts == ["rejected"] * 4
        assert {one["score_ratio"] for one in asked} <= {None}


def test_where_nobody_is_asked_nothing_is_remembered(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """A station that refuses every press for its colours may do so for months."""
    strict = variant(bundle, tmp_path / "strict", colours={"limit": 1e-9})
    config = station_config(tmp_path, recording, strict, tables=NOBODY_ASKED)
    with SteppedStation(config) as station:
        station.play_presses(4)
        (stage,) = (one for one in station.parts.stages if isinstance(one, PersonVerdicts))
        assert station.verdicts == ["rejected"] * 4
        assert not stage._of_other_colours


def test_more_false_alarms_than_promised_are_an_alarm_until_another_bundle_inspects(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """A fifth is promised, and three of four fails are good. It is said again at a start, when the gel is known. On
    a new gel the alarm of the proof says it."""
    strict = variant(bundle, tmp_path / "strict", threshold=FIVE | {"value": 1e-9})
    other = variant(bundle, tmp_path / "other", threshold=FIVE)

    def open_with(inspecting: Path) -> SteppedStation:
        lines = f'bundle = "{inspecting}"'
        return SteppedStation(station_config(tmp_path, recording, lines, tables=NOBODY_ASKED))

    def look(station: SteppedStation) -> str | None:
        settle(station)
        return station.alarm("false_alarms")

    with open_with(strict) as station:
        station.play_presses(4)
        answer, texts = say(station), []
        for number in (0, 1, 3):
            answer(press_id=station.results[number].press_id, verdict="good")
            texts.append(look(station))
    with open_with(strict) as station:
        station.clock.sleep(60)  # it begins anew with each process here
        station.turn()
        station.play_until(lambda: station.loop.session is not None)
        at_start = look(station)
    with open_with(other) as station:
        station.play_presses(1)
        of_other = look(station)
    with open_with(strict) as station:
        station.play_presses(1)
        again = look(station)
        station.ask("replace_gel")
        station.play_presses(2)
        on_new_gel = look(station)

    assert texts[0] is texts[1] is of_other is on_new_gel is None
    assert texts[2] is not None
    assert "people call 3 of 3 presses of the last day good that did not pass" in texts[2]
    assert at_start == again == texts[2]


def test_damage_that_passed_is_an_alarm_until_the_word_is_taken_back_or_a_day_old(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """Its piece is with the good ones. Of the dented press, which failed, nothing is said; a restart says it again."""
    config = station_config(tmp_path, recording, bundle, tables=NOBODY_ASKED)
    texts: list[str | None] = []

    def look(station: SteppedStation) -> None:
        settle(station)
        texts.append(station.alarm("escape"))

    with SteppedStation(config) as station:
        station.play_presses(4)
        ids, answer = [one.press_id for one in station.results], say(station)
        for number, word in ((2, "damaged"), (3, "damaged"), (0, "damaged"), (3, "good")):
            answer(press_id=ids[number], verdict=word)
            look(station)
    with SteppedStation(config) as station:
        look(station)
        station.clock.sleep(90_000)
        look(station)

    said = "presses that passed and that people called damaged in the last day: {}, the newest {}"
    first = said.format(1, ids[0])
    both = said.format(2, f"{ids[3]}, {ids[0]}")
    assert texts == [None, said.format(1, ids[3]), both, first, first, None]


@pytest.mark.parametrize(
    ("others", "is_called"),
    [
        (["good"], True),
        (["gel"], True),
        (["cannot_tell"], True),
        (["good", "good"], False),
        (["good", "gel"], True),
    ],
)
def test_a_damage_that_passed_is_said_until_twice_as_many_deny_it(
    played: SteppedStation, others: list[str], is_called: bool
) -> None:
    """Also where the other word came first: nobody can tell, and the piece is out."""
    press_id = played.results[0].press_id
    for number, word in enumerate(others):
        say(played, f"lee {number}")(press_id=press_id, verdict=word)
    settle(played)
    assert played.alarm("escape") is None
    say(played)(press_id=press_id, verdict="damaged")
    settle(played)

    assert (press_id in (played.alarm("escape") or "")) == is_called


def test_a_word_that_stands_in_the_way_is_asked_for_once_more(played: SteppedStation) -> None:
    """First of all, until somebody speaks; and never a third time."""
    store, ids = played.parts.store, [one.press_id for one in played.results]
    questions = lambda: [one["press_id"] for one in played.said("questions")["presses"]]  # noqa: E731
    answer = say(played)
    answer(press_id=ids[3], verdict="damaged")
    settle(played)
    before = questions()

    sentence = ask_again(store, [ids[3]], "gelgate bundle learn", 1)
    settle(played)
    then = questions()
    answer(press_id=ids[3], verdict="good")
    settle(played)

    assert ids[3] not in before
    assert (then[0], sorted(then)) == (ids[3], sorted([*before, ids[3]]))
    assert questions() == before
    assert sentence == f"the station asks once more what {ids[3]} is"
    assert ask_again(store, [ids[3]], "gelgate bundle learn", 1) == ""
    assert [one for one in check_database(store.path) if one.is_fault] == []


def test_a_refused_request_does_not_ask_once_more_and_does_not_keep_from_asking(
    played: SteppedStation,
) -> None:
    """Anybody may ask a broker for any verb, and each refusal is an act."""
    store, ids = played.parts.store, [one.press_id for one in played.results]
    say(played)(press_id=ids[3], verdict="damaged")
    settle(played)
    before = played.said("questions")["presses"]

    refused = Act(1, "kim, over MQTT, unsigned", "ask_again", "7", {"press_id": ids[3]}, outcome="refused")
    store.begin_act(refused, 0)
    settle(played)

    assert played.said("questions")["presses"] == before
    assert ask_again(store, [ids[3]], "gelgate bundle learn", 1) != ""


def test_what_is_asked_once_more_is_found_without_reading_all_that_was_said(played: SteppedStation) -> None:
    """Each word is read once."""
    store, ids = played.parts.store, [one["press_id"] for one in played.said("questions")["presses"]]
    ask_again(store, ids[:1], "gelgate bundle learn", 1)
    execute(
        store.path,
        "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 5000) "
        "INSERT INTO acts (time_ns, running_ns, who, verb, arguments, outcome) "
        "SELECT i - 1000000000000000, i - 172800000000000, 'kim', "
        "'confirm_press', json_object('press_id', printf('01J%023d', i), 'verdict', 'good'), 'done' FROM n",
    )
    settle(played)

    say(played)(press_id=ids[1], verdict="good")
    with count_steps(connection_of(store)) as steps:
        settle(played)
    assert played.said("questions")["presses"][0]["press_id"] == ids[0]
    assert len(steps) < 2000


@pytest.mark.parametrize(
    "tables",
    ["[archive]\npresses = 0", '[commands]\npage = ["select_part"]', NOBODY_ASKED],
)
def test_nothing_is_asked_that_nobody_could_answer(configure: Configure, tables: str) -> None:
    """A retained question of an earlier configuration is replaced."""
    with SteppedStation(configure(tables=tables)) as station:
        station.play_presses(1)
        settle(station)

        assert (station.said("questions")["per_day"], station.said("questions")["presses"]) == (0, [])


def test_a_pedal_says_what_the_last_press_was(config: Path) -> None:
    """Nothing is kept of no press, of a master piece, nor while the press that a light shows already waits for the
    database: the one before it is another part."""
    with SteppedStation(config) as station:
        outputs, store = Outputs(lambda alarm, text: None, station.clock), station.parts.store
        outputs.confirm_last("good", store)
        station.play_presses(2)
        (one, other), inspector = station.reports, station.parts.selection.inspector
        outputs.judge(one.press, None, inspector)
        outputs.record(one.press, one.gel)
        outputs.confirm_last("damaged", store)
        outputs.judge(other.press, None, inspector)
        outputs.confirm_last("good", store)
        master = replace(other.press, label=ReferenceLabel("m1", "fail", 10))
        outputs.record(master, other.gel)
        outputs.confirm_last("good", store)

        rows = list(read_history(store.path, HistoryQuery()))

    assert [(row.person_verdict, row.person) for row in rows] == [("damaged", "pedal"), (None, None)]


def test_a_press_of_which_a_pedal_spoke_is_not_asked_about(played: SteppedStation) -> None:
    """No press comes after it, and no request."""
    asked = played.said("questions")["presses"][0]["press_id"]
    given = {"press_id": asked, "verdict": "good"}
    played.clock.sleep(60)
    played.turn()

    played.parts.store.begin_act(
        Act(played.clock.time_ns(), "pedal", CONFIRM, None, given, outcome="done"), 0
    )
    settle(played)

    assert asked not in [one["press_id"] for one in played.said("questions")["presses"]]


def test_a_word_counts_when_its_act_is_complete(played: SteppedStation) -> None:
    """However long that takes, and though a later act is complete before it."""
    store, now_ns = played.parts.store, played.clock.time_ns()
    asked = played.said("questions")["presses"][0]["press_id"]
    slow, _ = store.begin_act(Act(now_ns, "kim", CONFIRM, "1", {"press_id": asked, "verdict": "good"}), 0)
    store.begin_act(Act(now_ns, "lee", "trigger", "2", {}, outcome="done"))
    played.clock.sleep(60)
    settle(played)
    assert asked in [one["press_id"] for one in played.said("questions")["presses"]]

    store.finish_act(slow, "done")
    settle(played)
    assert asked not in [one["press_id"] for one in played.said("questions")["presses"]]


def test_presses_have_shifts_only_where_they_are_configured(played: SteppedStation, tmp_path: Path) -> None:
    config = tmp_path / "gelgate.toml"

    without = gelgate("history", "--by", "shift", "-c", config).sentence()
    config.write_text(config.read_text() + '\n[reference]\nshifts = ["06:00", "14:00"]\n')
    found = gelgate("history", "--by", "shift", "-c", config).out

    assert "has no shifts" in without
    assert found.count("presses, yield") == 1
    assert "presses have no 'moon'" in gelgate("history", "--by", "moon", "-c", config).sentence()
    both = gelgate("history", "--by", "day", "--json", "-c", config).sentence()
    assert "--by prints lines for people" in both
