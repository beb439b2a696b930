"""Whatever people answer, right or wrong: no damage that somebody named passes a new bundle unsaid.

Both ways to a new bundle are asked: `learn`, which writes it, and a shadow, which takes over.
"""

import sqlite3
from collections.abc import Collection, Mapping
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
from edge.core.person_verdict import settle
from edge.core.press import Press, ShadowVerdict
from edge.core.shadow import Weighing
from edge.model.bundle import Bundle
from edge.store.acts import CONFIRM, Act
from edge.store.person_verdicts import read_verdicts
from edge.store.press_archive import ArchiveFolder
from edge.store.press_store import Store
from edge.store.shadow_verdicts import read_judged_twice

PART = PartPosition("bolt", "default")
DENTED = (2, 4)
GEL, PROVEN = "TEST0001-1", "first use"
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
    bundle_id: str
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
        judged[factor] = judge_presses(bundle, presses, database, 1, lambda *_: None)
    assert [judged[1.5][inspected.ids[number]].word for number in DENTED] == ["pass", "pass"]
    return Operation(database, inspected.ids, Bundle.load(old).digest, judged)


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
    """Up to every fifth answer is wrong; persons contradict themselves and each other, an archive has gaps, and presses
    are of a gel before, or were made with another bundle. Damage on which they agree is refused."""
    most_wrong = len(given_answers) // 5
    positions = st.integers(0, len(given_answers) - 1)
    wrong = data.draw(st.sets(positions, min_size=1, max_size=most_wrong))
    gap = data.draw(st.sampled_from([None, *DENTED]))
    is_new_gel, numbers = data.draw(st.booleans()), st.sets(st.integers(0, 5))
    earlier_gel, earlier_bundle = data.draw(numbers), data.draw(numbers)
    database, ids, _, judged = operation
    named = set()
    execute(
        database,
        "DELETE FROM acts",
        f"UPDATE gel_proofs SET proven = {'NULL' if is_new_gel else repr(PROVEN)}",
        *(
            f"UPDATE presses SET gel_id = '{'earlier' if number in earlier_gel else GEL}' WHERE press_id = '{press_id}'"
            for number, press_id in enumerate(ids)
        ),
    )
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
        learnt, is_refused = _learn(operation, judged[factor])
        taken = _take_over(operation, factor, earlier_bundle, is_new_gel=is_new_gel)
    finally:
        if gap is not None:
            hidden.rename(record)

    at_risk = [ids[k] for k in DENTED if ids[k] in named and judged[factor][ids[k]].word == "pass"]
    event(f"{len(at_risk)} named damages would pass")
    assert [press_id for press_id in at_risk if press_id not in learnt] == []
    assert [press_id for press_id in at_risk if press_id not in taken] == []
    with closing(sqlite3.connect(database)) as connection:
        words = read_verdicts(connection)
    held = [key for key in at_risk if (word := settle(words[key])) is not None and word.saying == "damaged"]
    known = [key for key in held if gap is None or key != ids[gap]]
    assert is_refused or not known, "a damage that people agree on is lost, and the bundle is written"


def _learn(operation: Operation, after: Mapping[str, Press]) -> tuple[str, bool]:
    """Everything that `bundle learn` and `teach --take` say of a bundle that judges so, and whether they refuse it."""
    found = read_confirmed(operation.database, PART, operation.bundle_id)
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
        return "\n".join([*said, str(error)]), True
    return "\n".join(said), False


def _take_over(operation: Operation, factor: float, earlier: Collection[int], *, is_new_gel: bool) -> str:
    """Everything that `adopt_shadow` says of a shadow that judges so; the first two presses came before it, and the
    earlier ones it has judged beside another bundle."""
    with closing(sqlite3.connect(operation.database)) as connection:
        connection.execute("UPDATE presses SET shadow = NULL")
        for number, press_id in enumerate(operation.ids[2:], 2):
            press = operation.judged[factor][press_id]
            said = ShadowVerdict("new", "older" if number in earlier else "old", press.word, press.score, 1.0)
            connection.execute("UPDATE presses SET shadow = ? WHERE press_id = ?", (said.encode(), press_id))
        both, missing = read_judged_twice(connection, PART, "new", "old")
    weighing = Weighing(both, [one.press_id for one in missing], is_new_gel=is_new_gel)
    return "\n".join([*weighing.refusals(has_promise=True), *weighing.doubts()])
