"""The ledger chained by hash: what is changed, removed or inserted afterwards is found and named."""

import hashlib
import json
import shutil
import sqlite3
import struct
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_presses import SERIAL, T0, make_press, record
from sql import connection_of, count_steps, execute

from edge.core.press import StudyLabel
from edge.core.reference_press.charts import ReferencePress
from edge.core.reference_press.outcome import Imprint
from edge.store import acts, integrity, ledger_chain, press_store, reference_presses, study_presses
from edge.store.acts import Act
from edge.store.backup import migrate
from edge.store.database import CHAINED_SINCE, MIGRATIONS
from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import Finding, check_database
from edge.store.ledger_chain import Head
from edge.store.press_counts import Count, recover
from edge.store.press_store import Store
from edge.store.reference_presses import PieceKey, ReferenceTable
from edge.store.study_presses import StudyTable

OLD = Path(__file__).parents[1] / "compatibility" / "version_0_1_0" / "gelgate.db"


def ledger(path: Path, held: Head | None = None) -> list[str]:
    """The faults of the ledger alone."""
    return [one.text for one in check_database(path, held) if one.part == "ledger" and one.is_fault]


def shift(path: Path) -> Head:
    """A shift: presses on two gels, one request that was done and one that was refused; returns the head."""
    with Store(path) as store:
        for n in range(1, 6):
            record(store, make_press(n, serial="S-1"))
            if n == 3:
                store.replace_gel(
                    "S-1", T0, note="batch 7", act=Act(T0, "a person", "replace_gel", outcome="done")
                )
        number, _ = store.begin_act(Act(T0, "a person", "relearn", arguments={"x": 0.5}), 60)
        store.finish_act(number, "done", None, {"state": "a"}, {"state": "b"})
        store.begin_act(Act(T0, "somebody", "relearn", outcome="refused", sentence="no"))
        return store.ledger_head()


@pytest.fixture
def used(path: Path) -> Path:
    shift(path)
    return path


def test_what_the_gateway_writes_is_a_sound_chain(used: Path) -> None:
    """Presses, acts that end, and gels that are removed; also after it was closed and opened again."""
    assert ledger(used) == []
    with Store(used) as store:
        store.replace_gel("S-1", T0)
    assert ledger(used) == []


def test_links_and_acts_are_numbered_once(used: Path) -> None:
    """One link when a gel is installed and one when it is removed; the end of an act is written by its row's number."""
    with Store(used) as store:
        store.replace_gel("S-1", T0)
        for outcome in (None, "done", "refused"):
            number, _ = store.begin_act(Act(T0, "a person", "relearn", outcome=outcome))
            assert execute(used, "SELECT max(act_id) FROM acts") == [(number,)]
    links = "SELECT count(*) FROM ledger_chain WHERE kind = 'gel' GROUP BY ref ORDER BY min(link)"

    assert execute(used, links) == [(2,), (2,), (1,)]


def test_every_press_moves_the_head(store: Store) -> None:
    """And the head that a press returns is that of the database."""
    heads = [record(store, make_press(n)).head for n in (1, 2)]

    assert heads[0] != heads[1]
    assert store.ledger_head() == heads[1] == Head.parse(str(heads[1]))


def test_a_link_is_what_the_manual_says(used: Path) -> None:
    """An outsider can compute it: canonical JSON, SHA-256, and the hash before."""
    press = execute(used, "SELECT press_id, time_ns, running_ns, gel_id FROM presses WHERE number = 2")[0]
    (before,) = execute(used, "SELECT hash FROM ledger_chain WHERE link = (SELECT link - 1 FROM ledger_chain "
                           "WHERE kind = 'press' AND ref = 2)")[0]  # fmt: skip
    link, found = execute(used, "SELECT link, hash FROM ledger_chain WHERE kind = 'press' AND ref = 2")[0]
    real = {name: struct.pack(">d", value).hex() for name, value in (("score", 0.5), ("threshold", 1.0))}
    row = {
        "gel_id": press[3], "gel_presses": 2, "number": 2, "part": "bolt", "press_id": press[0],
        "running_ns": press[2], "score": real["score"], "serial": "S-1", "threshold": real["threshold"],
        "time_ns": press[1], "verdict": "pass",
    }  # fmt: skip
    content = hashlib.sha256(json.dumps(row, separators=(",", ":")).encode()).digest()

    assert hashlib.sha256(before + content + f"{link} press 2".encode()).digest() == found


TAMPERINGS = {
    "UPDATE presses SET verdict = 'fail' WHERE number = 2": "press 2 was changed",
    "UPDATE presses SET score = score + 1e-12 WHERE number = 4": "press 4 was changed",
    "UPDATE presses SET time_ns = time_ns + 1 WHERE number = 1": "press 1 was changed",
    "UPDATE presses SET position = 'left' WHERE number = 5": "press 5 was changed",
    "UPDATE presses SET gel_presses = 1 WHERE number = 3": "press 3 was changed",
    "DELETE FROM presses WHERE number = 3": "press 3 was removed",
    "UPDATE acts SET sentence = 'x' WHERE act_id = 2": "act 2 was changed",
    "UPDATE acts SET after = '{}' WHERE act_id = 2": "act 2 was changed",
    "DELETE FROM acts WHERE act_id = 1": "act 1 was removed",
    "UPDATE gels SET limit_presses = 9 WHERE gel_id = 'S-1-2'": 'gel ["S-1","S-1-2"] was changed',
    "UPDATE gels SET removed_ns = 5 WHERE gel_id = 'S-1-1'": 'gel ["S-1","S-1-1"] was changed',
    "INSERT INTO gels (serial, gel_id, limit_presses, installed_ns, removed_ns, note) VALUES ('T', 'g', 1, 1, 1, '')":
        "gel g of sensor T was inserted",
    "INSERT INTO acts (time_ns, running_ns, who, verb, arguments, outcome) VALUES (1, 1, 'x', 'y', '{}', 'done')":
        "act 4 was inserted",
    "INSERT INTO presses (press_id, time_ns, serial, gel_id, part, verdict) "
    "SELECT '01ARZ3NDEKTSV4RRFFQ69G5FAV', time_ns, serial, gel_id, part, 'pass' FROM presses WHERE number = 1":
        "press 6 was inserted",
    "INSERT INTO study_presses (press_id, time_ns, running_ns, serial, gel_id, part, position, bundle_id, study_id, "
    "step, piece, operator, repeat, verdict) VALUES ('x', 1, 1, 's', 'g', 'p', 'q', 'b', 't', 1, 'a', 'o', 1, 'pass')":
        "study press 1 was inserted",
    "DELETE FROM ledger_chain WHERE kind = 'press' AND ref = 2": "before that of press 3, were removed",
    "UPDATE ledger_chain SET content = zeroblob(32) WHERE kind = 'press' AND ref = 2": "of press 2, does not follow",
    "UPDATE ledger_chain SET hash = zeroblob(32) WHERE kind = 'press' AND ref = 4": "of press 4, does not follow",
    "DELETE FROM ledger_chain WHERE link >= (SELECT max(link) - 1 FROM ledger_chain)":
        "the newest of the chain, were removed",
    "UPDATE ledger_start SET presses_up_to = 3": "the row that says where the chain starts was changed",
    "DELETE FROM ledger_start": "the row that says where the chain starts was removed",
}  # fmt: skip


@pytest.mark.parametrize("statement", TAMPERINGS)
def test_a_change_from_outside_is_named(used: Path, statement: str) -> None:
    """Changed, removed or inserted: the first such row, in one sentence."""
    execute(used, statement)
    (found,) = ledger(used)

    assert TAMPERINGS[statement] in found
    execute(used, "DELETE FROM presses WHERE number = 5")
    assert len(ledger(used)) == 1  # the first one is named


def test_a_ledger_written_again_is_found_by_the_head_that_somebody_kept(used: Path) -> None:
    """Whoever computes every link again makes a sound chain; it has another head."""
    with Store(used) as store:
        held = store.ledger_head()
    assert ledger(used, held) == []
    execute(used, "UPDATE presses SET verdict = 'fail' WHERE number = 5")
    with closing(sqlite3.connect(used)) as connection, connection:
        forge(connection)

    assert ledger(used) == []
    assert [text for text in ledger(used, held) if "is not in the chain" in text]


def forge(connection: sqlite3.Connection) -> None:
    """Compute every link again, as somebody with the program could."""
    from edge.store.ledger_chain import canonical, hash_link, read_row

    before = bytes(32)
    last = dict(connection.execute("SELECT kind || ref, max(link) FROM ledger_chain GROUP BY kind, ref"))
    for link, kind, ref, content in connection.execute(
        "SELECT link, kind, ref, content FROM ledger_chain ORDER BY link"
    ).fetchall():
        row = read_row(connection, kind, ref)
        if row is not None and last[f"{kind}{ref}"] == link:
            content = hashlib.sha256(canonical(row)).digest()
        before = hash_link(before, link, kind, ref, content)
        connection.execute(
            "UPDATE ledger_chain SET content = ?, hash = ? WHERE link = ?", (content, before, link)
        )


def test_a_head_of_another_database_is_named_as_such(used: Path, tmp_path: Path) -> None:
    """The same presses in another file are another ledger."""
    other = shift(tmp_path / "other.db")

    (found,) = ledger(used, other)
    assert f"is of ledger {other.ledger_id}" in found
    assert "another station" in found


def test_an_old_copy_in_the_place_of_the_database_lacks_the_head(used: Path, tmp_path: Path) -> None:
    """Its chain is sound, and shorter."""
    copy = shutil.copy(used, tmp_path / "copy.db")
    with Store(used) as store:
        head = record(store, make_press(9)).head

    (found,) = ledger(Path(copy), head)
    assert "replaced by an old copy" in found


@pytest.mark.parametrize(
    "text", ["", "abc", "12345678.1", f"12345678.x.{'0' * 64}", f"1234567g.1.{'0' * 64}"]
)
def test_a_head_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no head of a ledger; expected"):
        Head.parse(text)


def test_the_first_version_with_a_chain_is_the_one_that_makes_its_table() -> None:
    """`db migrate` says that older presses are not covered, of the versions before."""
    chained = [number for number, script in enumerate(MIGRATIONS, 1) if "TABLE ledger_chain" in script]
    assert chained == [CHAINED_SINCE]


def test_a_database_that_was_migrated_says_where_its_chain_starts(tmp_path: Path) -> None:  # fmt: skip
    """Its old presses stay, outside the chain; its gels and all that follows are in it."""
    path = Path(shutil.copy(OLD, tmp_path / "gelgate.db"))
    migrate(path)
    with Store(path) as store:
        before = len(list(read_history(path, HistoryQuery())))
        record(store, make_press(1, serial="NEW"))

    notes = [one for one in check_database(path) if one.part == "ledger"]
    (newest,) = execute(path, "SELECT max(number) FROM presses")[0:1]
    assert before > 0
    assert notes == [
        Finding(
            "ledger",
            f"the chain starts after press {int(str(newest[0])) - 1}, where the database was migrated: older rows are "
            "not covered",
            is_fault=False,
        )
    ]
    execute(path, "UPDATE presses SET verdict = 'error' WHERE serial = 'NEW'")
    assert len(ledger(path)) == 1


def test_the_chain_still_verifies_when_old_presses_go(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hash of the last link that went is the anchor, and a change of what remains is found as before."""
    monkeypatch.setattr(press_store, "KEPT_PRESSES", 4)
    with Store(path) as store:
        for n in range(1, 21):
            record(store, make_press(n))
            if n % 7 == 0:
                store.replace_gel(SERIAL, T0, act=Act(T0, "x", "replace_gel", outcome="done"))
    kept = [row[0] for row in execute(path, "SELECT number FROM presses")]

    assert kept == [17, 18, 19, 20]
    assert len(execute(path, "SELECT link FROM ledger_chain")) < 20
    assert ledger(path) == []
    ledger_id, link, anchor = execute(path, "SELECT ledger_id, link, hash FROM ledger_start")[0]
    assert ledger(path, Head.parse(f"{ledger_id}.{link}.{anchor.hex()}")) == []
    assert "is not in the chain" in ledger(path, Head.parse(f"{ledger_id}.{link}.{'0' * 64}"))[0]
    older = check_database(path, Head.parse(f"{ledger_id}.{link - 1}.{'0' * 64}"))
    assert [one.is_fault for one in older if "went with its old presses" in one.text] == [False]
    execute(path, "UPDATE ledger_start SET hash = zeroblob(32)")
    assert "does not follow" in ledger(path)[0]


def test_acts_that_go_leave_a_sound_chain(used: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the newest acts are kept; one that is removed among those is found."""
    monkeypatch.setattr(acts, "KEPT_ACTS", 3)
    with Store(used) as store:
        for n in range(8):
            store.begin_act(Act(T0 + n, "x", "clock_step", outcome="done"))
    kept = [row[0] for row in execute(used, "SELECT act_id FROM acts WHERE outcome = 'done'")]

    assert len(kept) == 3
    assert ledger(used) == []
    execute(used, f"DELETE FROM acts WHERE act_id = {kept[1]}")
    assert ledger(used)[0].startswith(f"act {kept[1]} was removed")


def test_what_a_line_does_with_each_part_pushes_out_nothing_that_a_person_did(
    used: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plan of a piece selects each place: 50,000 pieces had pushed out the change of the gel."""
    monkeypatch.setattr(acts, "KEPT_ACTS", 3)
    with Store(used) as store:
        store.replace_gel(SERIAL, T0, act=Act(T0, "x", "replace_gel", outcome="done"))
        store.begin_act(Act(T0, "ann, at the page", "select_part", outcome="done"))
        for n in range(8):
            store.begin_act(Act(T0 + n, "the plan of the piece", "select_part", outcome="done"))
    kept = [row[0] for row in execute(used, "SELECT who FROM acts WHERE verb = 'select_part'")]

    assert kept == ["ann, at the page", *["the plan of the piece"] * 3]
    assert len(execute(used, "SELECT 1 FROM acts WHERE verb = 'replace_gel' AND who = 'x'")) == 1
    assert ledger(used) == []


def test_an_act_reads_nothing_of_those_before(used: Path) -> None:
    """A line that selects a part every few seconds has a hundred thousand of them."""
    rows = "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 5000) "
    acts_of = "INSERT INTO acts (time_ns, running_ns, who, verb, arguments, outcome) "
    execute(used, f"{acts_of}{rows}SELECT i, i, 'x', 'select_part', '{{}}', 'done' FROM n")
    with Store(used) as store, count_steps(connection_of(store)) as steps:
        store.begin_act(Act(T0, "x", "select_part", request="7"), 60)
    assert len(steps) < 500


def test_ten_thousand_refused_requests_are_kept(used: Path) -> None:
    """And up to a hundredth more; a flood of them removes nothing else."""
    rows = "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 12000) "
    acts_of = "INSERT INTO acts (time_ns, running_ns, who, verb, arguments, outcome) "
    execute(used, f"{acts_of}{rows}SELECT i, i, 'x', 'trigger', '{{}}', 'refused' FROM n")
    with Store(used) as store:
        for n in range(100):
            store.begin_act(Act(T0 + n, "x", "trigger", outcome="refused"))
    ((kept,),) = execute(used, "SELECT count(*) FROM acts WHERE outcome = 'refused'")
    assert 10_000 <= kept <= 10_100


def test_never_more_than_a_hundredth_too_many_acts_are_kept(
    used: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(acts, "KEPT_ACTS", 300)
    count = "SELECT count(*) FROM acts WHERE verb = 'clock_step'"

    def add(connection: sqlite3.Connection) -> list[int]:
        numbers = []
        for n in range(1000):
            acts.begin(connection, Act(T0 + n, "x", "clock_step", outcome="done"), n)
            numbers += connection.execute(count).fetchone()
        return numbers

    with Store(used) as store:
        numbers = store.write("adding acts", add)
    assert set(numbers[400:]) == {300, 301, 302}
    assert ledger(used) == []


def test_a_gel_restored_from_the_second_record_is_chained(used: Path) -> None:
    """What the recovery writes is no change from outside."""
    with closing(sqlite3.connect(used)) as connection, connection:
        said = recover(connection, used, Count("S-1-9", 700, 1000, 50), "S-1", T0)

    assert said
    assert ledger(used) == []


COLUMNS = ("press_id", "time_ns", "serial", "gel_id", "part", "verdict", "score", "threshold", "running_ns")


def labelled(path: Path) -> None:
    """Two presses of a master piece, and one of a study that was pressed again."""
    key, imprint = PieceKey(SERIAL, "bolt", "crest", "M1"), Imprint(2.0, 9.0, 7.0, None, 1.0)
    with Store(path) as store:
        for n in (30, 31):
            press = make_press(n)
            one = ReferencePress(
                press.press_id, press.time_ns, f"{SERIAL}-1", "b", "pass", "pass", 0.5, 1.0, imprint
            )
            store.record_press(press, lambda recorded: [], ReferenceTable(key, one))
        press = make_press(32)
        store.record_press(
            press, lambda recorded: [], StudyTable(StudyLabel("s1", 1, "p1", "ann", 1), "b", None)
        )
        assert store.write("void", lambda connection: study_presses.void(connection, press.press_id))


@pytest.mark.parametrize(
    ("statement", "expected"),
    [
        ("UPDATE reference_presses SET expected = 'fail' WHERE number = 2", "reference press 2 was changed"),
        ("DELETE FROM reference_presses WHERE number = 1", "reference press 1 was removed"),
        ("UPDATE study_presses SET operator = 'bob'", "study press 1 was changed"),
        ("UPDATE study_presses SET is_void = 0", "study press 1 was changed"),
    ],
)
def test_presses_of_master_pieces_and_studies_are_chained(used: Path, statement: str, expected: str) -> None:
    """What an auditor is shown can be checked as the presses of parts can."""
    labelled(used)
    assert ledger(used) == []
    execute(used, statement)

    assert ledger(used)[0].startswith(expected)


def test_a_chain_that_starts_later_has_the_presses_of_master_pieces_and_studies(used: Path) -> None:
    """As where a database is migrated: none of them is called inserted, and a change of one is named."""
    labelled(used)
    with closing(sqlite3.connect(used)) as connection, connection:
        for table in ("ledger_chain", "ledger_start", "sqlite_sequence WHERE name = 'ledger_chain'"):
            connection.execute(f"DELETE FROM {table}")
        ledger_chain.start(connection)
    assert ledger(used) == []
    execute(used, "UPDATE study_presses SET operator = 'bob'")

    assert ledger(used)[0].startswith("study press 1 was changed")


def test_old_reference_presses_go_without_a_fault(used: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (reference_presses, integrity):
        monkeypatch.setattr(module, "KEPT_REFERENCES", 1)
    labelled(used)

    assert execute(used, "SELECT number FROM reference_presses") == [(2,)]
    assert ledger(used) == []


@settings(max_examples=30, deadline=None)
@given(
    number=st.integers(1, 5),
    column=st.sampled_from(COLUMNS),
    value=st.one_of(st.integers(0, 2**62), st.floats(0, 1e9), st.text("abcXYZ0189", min_size=1, max_size=26)),
)
def test_any_other_value_in_any_column_is_found(
    tmp_path_factory: pytest.TempPathFactory, number: int, column: str, value: object
) -> None:
    """Whatever is written into a press, the check names that press, unless it is the same value."""
    path = Path(shutil.copy(sound_copy(tmp_path_factory), tmp_path_factory.mktemp("changed") / "gelgate.db"))
    with closing(sqlite3.connect(path)) as connection, connection:
        before = connection.execute(f"SELECT {column} FROM presses WHERE number = ?", (number,)).fetchone()
        try:
            connection.execute(f"UPDATE presses SET {column} = ? WHERE number = ?", (value, number))
        except sqlite3.IntegrityError:
            return  # a STRICT table takes no such value
        after = connection.execute(f"SELECT {column} FROM presses WHERE number = ?", (number,)).fetchone()

    found = ledger(path)
    assert ([] if after == before else [True]) == [
        text.startswith(f"press {number} was changed") for text in found
    ]


@settings(max_examples=30, deadline=None)
@given(removed=st.sets(st.integers(1, 12), min_size=1, max_size=4), is_renumbered=st.booleans())
def test_links_that_are_taken_out_are_missed(
    tmp_path_factory: pytest.TempPathFactory, removed: set[int], is_renumbered: bool
) -> None:
    """Also where the ones after them are numbered again to close the gap."""
    path = Path(shutil.copy(sound_copy(tmp_path_factory), tmp_path_factory.mktemp("cut") / "gelgate.db"))
    with closing(sqlite3.connect(path)) as connection, connection:
        for link in sorted(removed, reverse=True):
            connection.execute("DELETE FROM ledger_chain WHERE link = ?", (link,))
            if is_renumbered:
                for (later,) in connection.execute(
                    "SELECT link FROM ledger_chain WHERE link > ? ORDER BY link", (link,)
                ).fetchall():
                    connection.execute("UPDATE ledger_chain SET link = link - 1 WHERE link = ?", (later,))

    assert len(ledger(path)) == 1


_MADE: dict[str, Path] = {}


def sound_copy(factory: pytest.TempPathFactory) -> Path:
    """A database of five presses and 12 links, made once."""
    if "path" not in _MADE:
        path = factory.mktemp("sound") / "gelgate.db"
        shift(path)
        _MADE["path"] = path
    return _MADE["path"]


def test_a_history_that_goes_before_anything_is_chained_moves_the_start_forward_alone(store: Store) -> None:
    """Of a database that was migrated: its presses up to 7 are no longer asked for."""
    for cut_up_to in (7, 5):
        store.write("cutting", partial(ledger_chain.cut, presses_up_to=cut_up_to))
        start = store.read(
            "reading", lambda it: it.execute("SELECT presses_up_to FROM ledger_start").fetchone()
        )
        assert start == (7,)
