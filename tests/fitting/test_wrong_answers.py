"""Whatever people answer, right or wrong: no damage that somebody named passes a new bundle unsaid.

Both ways to a new bundle are asked: `learn`, which writes it, and a shadow, which takes over.
"""

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
from confirmed_station import Judged, copy_station
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from sql import execute
from station import variant

from calibration.fitting.learn import Comparison, ConfirmedPresses, judge_presses, read_confirmed
from edge.core.errors import FitError
from edge.core.part_position import PartPosition
from edge.core.press import Press, ShadowVerdict
from edge.core.shadow import Weighing
from edge.model.bundle import Bundle
from edge.store.acts import CONFIRM, Act
from edge.store.press_archive import ArchiveFolder
from edge.store.press_store import Store
from edge.store.shadow_verdicts import read_judged_twice

PART = PartPosition("bolt", "default")
DENTED = (2, 4)
FACTORS = (0.7, 1.0, 1.5)
"""Of the old limit: one fails sound presses, one is the same, one passes the dents."""


class Answer(NamedTuple):
    press: int
    person: str
    is_sure: bool


class Operation(NamedTuple):
    """A station's database, and how bundles judge its presses, by the factor of their limit."""

    database: Path
    ids: list[str]
    judged: Mapping[float, Mapping[str, Press]]


@pytest.fixture(scope="module")
def operation(inspected: Judged, tmp_path_factory: pytest.TempPathFactory) -> Operation:
    station = copy_station(inspected, tmp_path_factory.mktemp("said"))
    database, old = station.database, station.old
    archive = ArchiveFolder(database.with_suffix(".archive"))
    rows = execute(database, "SELECT press_id, evidence FROM presses")
    presses = ConfirmedPresses(others=[archive.press(*row) for row in rows])
    limit = Bundle.load(old).manifest.threshold
    judged = {}
    for factor in FACTORS:
        changed = {"value": factor * limit.value}
        bundle = Bundle.load(variant(old, station.folder / f"limit {factor}", threshold=changed))
        judged[factor] = judge_presses(bundle, presses, database, 1)
    assert [judged[1.5][inspected.ids[number]].word for number in DENTED] == ["pass", "pass"]
    return Operation(database, inspected.ids, judged)


# Most are of the dents, and sure: so that several persons speak of one of them.
answers = st.lists(
    st.builds(
        Answer,
        st.sampled_from((0, 1, *DENTED, *DENTED, *DENTED)),
        st.sampled_from("abc"),
        st.sampled_from((True, True, False)),
    ),
    min_size=5,
    max_size=20,
)


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(answers, st.sampled_from((*FACTORS, 1.5, 1.5)), st.data())
def test_no_named_damage_passes_without_a_message_that_names_it(
    operation: Operation, given_answers: list[Answer], factor: float, data: st.DataObject
) -> None:
    """Up to every fifth answer is wrong; persons contradict themselves and each other, and an archive has gaps."""
    most_wrong = len(given_answers) // 5
    positions = st.integers(0, len(given_answers) - 1)
    wrong = data.draw(st.sets(positions, min_size=1, max_size=most_wrong))
    gap = data.draw(st.sampled_from([None, *DENTED]))
    database, ids, judged = operation
    named = set()
    execute(database, "DELETE FROM acts")
    with Store(database) as store:
        for number, answer in enumerate(given_answers):
            is_damaged = (answer.press in DENTED) != (number in wrong)
            word = ("damaged" if is_damaged else "good") if answer.is_sure else "cannot_tell"
            arguments = {"press_id": ids[answer.press], "verdict": word}
            store.begin_act(
                Act(1, f"{answer.person}, at the page", CONFIRM, None, arguments, outcome="done"), 0
            )
            if word == "damaged":
                named.add(ids[answer.press])
    record = database.with_suffix(".archive") / "presses" / f"{ids[gap or 0]}.json"
    hidden = record.with_suffix(".gone")
    if gap is not None:
        record.rename(hidden)
    try:
        learnt = _learn(operation, judged[factor])
        taken = _take_over(operation, factor, is_new_gel=data.draw(st.booleans()))
    finally:
        if gap is not None:
            hidden.rename(record)

    at_risk = [ids[k] for k in DENTED if ids[k] in named and judged[factor][ids[k]].word == "pass"]
    event(f"{len(at_risk)} named damages would pass")
    assert [press_id for press_id in at_risk if press_id not in learnt] == []
    assert [press_id for press_id in at_risk if press_id not in taken] == []


def _learn(operation: Operation, after: Mapping[str, Press]) -> str:
    """Everything that `bundle learn` says of a bundle that judges so."""
    found = read_confirmed(operation.database, PART, "")
    before = operation.judged[1.0]
    known = {one.press.press_id for one in (*found.good, *found.damaged)} | {
        one.press_id for one in found.others
    }
    comparison = Comparison(
        found,
        {key: press for key, press in before.items() if key in known},
        {key: press for key, press in after.items() if key in known},
    )
    said = [*found.left_out, comparison.changes()]
    try:
        comparison.check()
    except FitError as error:
        said.append(str(error))
    return "\n".join(said)


def _take_over(operation: Operation, factor: float, *, is_new_gel: bool) -> str:
    """Everything that `adopt_shadow` says of a shadow that judges so; the first two presses came before it."""
    with closing(sqlite3.connect(operation.database)) as connection:
        connection.execute("UPDATE presses SET shadow = NULL")
        for press_id in operation.ids[2:]:
            press = operation.judged[factor][press_id]
            said = ShadowVerdict("new", "old", press.word, press.score, 1.0)
            connection.execute("UPDATE presses SET shadow = ? WHERE press_id = ?", (said.encode(), press_id))
        both, missing = read_judged_twice(connection, PART, "new", "old")
    weighing = Weighing(both, [one.press_id for one in missing], is_new_gel=is_new_gel)
    return "\n".join([*weighing.refusals(has_promise=True), *weighing.doubts()])
