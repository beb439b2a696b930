"""A press is one transaction, recorded once, whatever happens in between."""

import os
import sqlite3
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from full_disk import room_for
from recorded_presses import make_press, messages_of, record
from sql import add_presses, connection_of, count_steps, execute

from edge.core.errors import StoreError
from edge.core.gel_life import GelState
from edge.store.database import SCHEMA_VERSION, Database
from edge.store.history import HistoryQuery, read_history
from edge.store.outbox import Outbox
from edge.store.press_store import MakeMessages, PressRecord, Store


def contents(path: Path) -> tuple[int, int, int]:
    """(presses recorded, presses counted on gels, results waiting) as another program reads the file."""
    with sqlite3.connect(path) as connection:
        recorded = connection.execute("SELECT count(*) FROM presses").fetchone()[0]
        counted = connection.execute("SELECT coalesce(sum(presses), 0) FROM gels").fetchone()[0]
        waiting = connection.execute("SELECT count(*) FROM outbox WHERE topic = 'result'").fetchone()[0]
    connection.close()
    return recorded, counted, waiting


def test_a_press_is_counted_and_its_messages_wait(store: Store, path: Path) -> None:
    """One row, one count, and its messages in order, which carry the count of their own press."""
    gel = record(store, make_press(1)).gel
    record(store, make_press(2), make_press(3))

    assert (gel.presses, gel.gel_id, gel.state) == (1, "2BNN4ZE7-1", GelState.GOOD)
    with Outbox(path) as outbox:
        messages = [row.message for row in outbox.pending("mqtt")]
    assert [message.topic for message in messages if message.retain] == RETAINED
    results = [message for message in messages if message.topic == "result"]
    assert [b'"gel_presses":%d,' % n in message.payload for n, message in enumerate(results, 1)] == [True] * 3
    assert messages[1].topic == f"heatmap/{make_press(1).press_id}"


def test_a_press_reads_nothing_of_a_long_history(store: Store, path: Path) -> None:
    """It holds up the loop, and so the frames that come meanwhile."""
    record(store, make_press(0))
    add_presses(path, 5000)
    with count_steps(connection_of(store)) as steps:
        record(store, make_press(1))
    assert len(steps) < 500


RETAINED = ["last", "last/press", "gel"]
"""After the results, in this order."""


def test_recording_a_press_again_changes_nothing(store: Store, path: Path) -> None:
    """A caller who saw an error may repeat: same id, same press, no second count and no second message."""
    press = make_press(1)
    first = record(store, press)

    again = record(store, press)

    assert again == first
    assert contents(path) == (1, 1, 1)


def test_an_id_is_never_given_to_another_press(store: Store, path: Path) -> None:
    """The same id with another score is a fault in the caller, not a repetition."""
    record(store, make_press(1))

    with pytest.raises(StoreError, match="already given to another press"):
        store.record_press(make_press(1, score=0.75), messages_of(make_press(1)))
    assert contents(path) == (1, 1, 1)


def test_nothing_is_recorded_when_the_messages_cannot_be_made(store: Store, path: Path) -> None:
    """Both or neither, also for a fault in gelgate."""

    def broken(gel: object) -> Any:
        raise RuntimeError("no messages")

    with pytest.raises(RuntimeError, match="no messages"):
        store.record_press(make_press(1), broken)
    assert contents(path) == (0, 0, 0)
    assert store.gels() == []
    assert record(store, make_press(2)).sequence == 1  # no number is used up


def killed_at(path: Path, press: PressRecord, messages: MakeMessages, statement: int) -> bool:
    """Record in a process that dies as its n-th statement begins; gives whether it lived to the end."""
    child = os.fork()
    if child == 0:
        seen = 0

        def count(sql: str) -> None:
            nonlocal seen
            seen += 1
            if seen == statement:
                os._exit(1)

        try:
            store = Store(path)
            store._database._connection.set_trace_callback(count)
            store.record_press(press, messages)
            os._exit(0)
        finally:
            traceback.print_exc()
            os._exit(2)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 1), "recording failed in the other process, as printed"
    return code == 0


# Later versions of Python warn of a fork beside threads; here the child uses SQLite alone, and ends.
@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_dying_between_any_two_statements_leaves_all_or_nothing(path: Path) -> None:
    """Killed at every single statement of a press, then recorded again after the restart: one press, one count.
    Checked by taking BEGIN IMMEDIATE out of `Database.writing`: the count then differs from the presses."""
    Store(path).close()
    press = make_press(1)
    statement, deaths = 1, 0
    while not killed_at(path, press, messages_of(press, 50_000), statement):
        assert contents(path) == (0, 0, 0)
        statement, deaths = statement + 1, deaths + 1

    assert deaths >= 12, "the press has fewer statements than were ever seen: is it traced?"
    assert contents(path) == (1, 1, 1)
    with Store(path) as store:
        record(store, press)
    assert contents(path) == (1, 1, 1)


def test_a_full_database_refuses_the_press_and_keeps_what_it_has(store: Store, path: Path) -> None:
    """No room: a sentence that says so, nothing half recorded, and recording goes on when there is room again."""
    record(store, make_press(1))
    connection = store._database._connection
    pages = connection.execute("PRAGMA page_count").fetchone()[0]
    connection.execute(f"PRAGMA max_page_count = {pages + 2}")

    with pytest.raises(StoreError, match="free space on its disk"):
        store.record_press(make_press(2), messages_of(make_press(2), 100_000))
    assert contents(path) == (1, 1, 1)

    connection.execute("PRAGMA max_page_count = 1000000")
    assert store.record_press(make_press(2), messages_of(make_press(2), 100_000)).gel.presses == 2
    assert contents(path) == (2, 2, 2)


def test_a_disk_that_refuses_the_write_is_a_store_error(path: Path) -> None:
    """With a file size limit set by the system, the press is refused and the earlier ones can still be read."""
    with Store(path) as store:
        record(store, make_press(1))
        with room_for(200_000), pytest.raises(StoreError, match="recording press"):
            store.record_press(make_press(2), messages_of(make_press(2), 1_000_000))

    assert contents(path) == (1, 1, 1)
    with Store(path) as store:
        assert record(store, make_press(2)).gel.presses == 2


def test_a_database_held_by_another_program_is_a_store_error(store: Store, path: Path) -> None:
    """A writer that never ends is waited for, then named; afterwards the press is recorded."""
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    store._database._connection.execute("PRAGMA busy_timeout = 20")

    with pytest.raises(StoreError, match=rf"^database {path}: .*another program has locked it"):
        record(store, make_press(1))

    other.execute("ROLLBACK")
    other.close()
    assert record(store, make_press(1)).gel.presses == 1


def test_two_threads_share_a_store(store: Store, path: Path) -> None:
    """The gateway's and the commands' threads take turns; no count is lost."""

    def shift(first: int) -> None:
        for n in range(first, first + 20):
            record(store, make_press(n))

    threads = [threading.Thread(target=shift, args=(first,)) for first in (0, 100)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert contents(path) == (40, 40, 40)


def test_a_writer_and_a_publisher_work_at_the_same_time(store: Store, path: Path) -> None:
    """Rows are read and acknowledged while presses are recorded: each row is seen once, in order, none is lost."""
    seen: list[int] = []
    done = threading.Event()

    def publish() -> None:
        with Outbox(path) as outbox:
            outbox.register(["mqtt"])
            while not done.is_set():
                for row in outbox.pending("mqtt"):
                    seen.append(row.row_id)
                    outbox.acknowledge([row.row_id], "mqtt")

    publisher = threading.Thread(target=publish)
    publisher.start()
    for n in range(50):
        press = make_press(n)
        store.record_press(press, lambda gel, p=press: [m for m in messages_of(p)(gel) if not m.retain])
    done.set()
    publisher.join()
    with Outbox(path) as outbox:
        rest = [row.row_id for row in outbox.pending("mqtt", 1000)]

    assert seen + rest == list(range(1, 101))


def write_bytes(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def write_tables(statement: str) -> Callable[[Path], object]:
    return lambda path: execute(path, statement)


@pytest.mark.parametrize(
    ("write", "says"),
    [
        (write_bytes(b"not a database, but long enough to have a header" * 9), "gelgate.db.*not a database"),
        (write_bytes(b"SQLite format 3\0" + b"\xff" * 4080), "gelgate.db"),
        (write_tables("CREATE TABLE recipes (name TEXT)"), "belongs to another program"),
    ],
    ids=["text", "garbage", "another program's"],
)
def test_a_file_of_no_database_is_refused(path: Path, write: Callable[[Path], object], says: str) -> None:
    """A sentence names the file; the file is left as it is."""
    write(path)
    before = path.read_bytes()

    with pytest.raises(StoreError, match=says):
        Store(path)
    assert path.read_bytes() == before


def test_a_database_of_no_known_version_or_a_missing_folder_is_refused(path: Path, tmp_path: Path) -> None:
    """By its version, and with the advice to create the folder."""
    Store(path).close()
    for version, says in (
        (99, f"99, this program knows up to {SCHEMA_VERSION}"),
        (0, "0, which no gelgate wrote"),
        (-1, "-1, which no gelgate wrote"),
    ):
        write_tables(f"PRAGMA user_version = {version}")(path)
        with pytest.raises(StoreError, match=f"schema version {says}"):
            Store(path)
    with pytest.raises(StoreError, match=r"nowhere.*create its folder"):
        Store(tmp_path / "nowhere" / "gelgate.db")


def test_a_damaged_page_is_found_and_named(path: Path) -> None:
    """Garbage inside the file is an error, not a guess."""
    with Store(path) as store:
        for n in range(40):
            store.record_press(make_press(n), messages_of(make_press(n), 5000))
    damaged = bytearray(path.read_bytes())
    damaged[4096 : 4096 * 30] = os.urandom(4096 * 29)
    path.write_bytes(damaged)

    with pytest.raises(StoreError, match=r"damaged|malformed"), Store(path):
        list(read_history(path, HistoryQuery()))


def test_commits_survive_a_power_cut_and_acknowledgements_need_not(path: Path) -> None:
    """WAL with synchronous FULL (2) for presses, NORMAL (1) for the publisher."""
    durable, quick = Database(path), Database(path, is_durable=False)

    modes = [
        (c.execute("PRAGMA journal_mode").fetchone()[0], c.execute("PRAGMA synchronous").fetchone()[0])
        for c in (durable._connection, quick._connection)
    ]
    durable.close()
    quick.close()

    assert modes == [("wal", 2), ("wal", 1)]


@pytest.mark.parametrize(("acknowledges", "most_mib"), [(False, 18), (True, 6)])
def test_the_journal_stays_small(store: Store, path: Path, acknowledges: bool, most_mib: int) -> None:
    """Without a publisher, or with one whose receiver is away, the gateway itself makes the checkpoints."""
    journal, most = path.with_name(path.name + "-wal"), 0
    with Outbox(path) as outbox:
        outbox.register(["mqtt"])
        for n in range(40):
            store.record_press(make_press(n), messages_of(make_press(n), 1_000_000))
            for row in outbox.pending("mqtt") if acknowledges else ():
                outbox.acknowledge([row.row_id], "mqtt")
            most = max(most, journal.stat().st_size)
    assert most < most_mib << 20


@pytest.mark.parametrize(
    "field",
    [{"press_id": "7"}, {"verdict": "perhaps"}, {"serial": ""}, {"part": ""}],
    ids=lambda f: next(iter(f)),
)
def test_a_press_refuses_nonsense(field: dict[str, str]) -> None:
    good = vars(make_press(1))

    with pytest.raises(ValueError, match=r"found"):
        PressRecord(**{**good, **field})
