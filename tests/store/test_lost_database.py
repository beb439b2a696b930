"""A database that was removed, emptied, cut or replaced by an old copy never starts a gel again at 0."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from recorded_presses import count, make_press
from sql import execute

from edge.core.errors import StoreError
from edge.core.gel_life import LONGEST_ID, GelLabel
from edge.core.ports import Message
from edge.core.reference_press.charts import ReferencePress
from edge.core.reference_press.outcome import Imprint
from edge.store.integrity import check_database
from edge.store.outbox import Outbox
from edge.store.press_counts import COPY_BYTES, Count, PressCounts
from edge.store.press_store import Store
from edge.store.reference_presses import PieceKey, ReferenceTable

SERIAL = "2BNN4ZE7"


def record(path: Path, *numbers: int) -> Store:
    with Store(path) as store:
        for n in numbers:
            count(store, make_press(n))
    return store


def remove(path: Path) -> None:
    for name in (path, path.with_name(path.name + "-wal"), path.with_name(path.name + "-shm")):
        name.unlink(missing_ok=True)


@pytest.mark.parametrize("loss", ["removed", "emptied", "an older copy"])
def test_a_gel_goes_on_counting_and_the_loss_is_reported(path: Path, tmp_path: Path, loss: str) -> None:
    """The count, the gel's id and the numbers of presses go on; one sentence says what is missing. What is left is
    sound."""
    record(path, 1)
    shutil.copy(path, tmp_path / "old.db")
    record(path, 2, 3)
    if loss == "emptied":
        path.write_bytes(b"")
    else:
        remove(path)
    if loss == "an older copy":
        shutil.copy(tmp_path / "old.db", path)

    with Store(path) as store:
        gel = store.gel(SERIAL, 0)
        recorded = count(store, make_press(9))
        (finding,) = store.findings()

    assert (gel.gel_id, gel.presses) == (f"{SERIAL}-1", 3)
    assert (recorded.gel.presses, recorded.sequence) == (4, 4)
    first = 2 if loss == "an older copy" else 1
    assert f"presses {first} to 3 are missing" in finding
    assert "goes on from 3 presses" in finding
    assert [one.text for one in check_database(path) if one.is_fault] == []


def count_master_piece(store: Store, number: int) -> None:
    """Record a press of a master piece, and its count."""
    press = make_press(number)
    scores = (press.verdict, press.score, press.threshold)
    made = ReferencePress(press.press_id, press.time_ns, "g", "b1", "pass", *scores, Imprint())
    table = ReferenceTable(PieceKey(SERIAL, "bolt", "crest", "M1"), made)
    store.keep_count(store.record_press(press, lambda recorded: [], table).gel)


@pytest.mark.parametrize("parts", [0, 1])
def test_presses_of_master_pieces_alone_are_missed_too(path: Path, tmp_path: Path, parts: int) -> None:
    """They have no number among those of parts, and wear the gel."""
    record(path, *range(1, parts + 1))
    if parts:
        shutil.copy(path, tmp_path / "old.db")
    with Store(path) as store:
        store.gel(SERIAL, 0)
        count_master_piece(store, 7)
        count_master_piece(store, 8)
    remove(path)
    if parts:
        shutil.copy(tmp_path / "old.db", path)

    with Store(path) as store:
        assert store.gel(SERIAL, 0).presses == parts + 2
        (finding,) = store.findings()
    assert f"goes on from {parts + 2} presses" in finding
    assert [one.text for one in check_database(path) if one.is_fault] == []


def test_no_gel_gets_the_id_of_one_before_the_loss(path: Path) -> None:
    """Of the lost database only the mounted gel, the third, is known: the next one is the fourth."""
    with record(path, 1) as store:
        pass
    with Store(path) as store:
        for _ in range(2):
            store.replace_gel(SERIAL, 0)
    remove(path)

    with Store(path) as store:
        assert store.gel(SERIAL, 0).gel_id == f"{SERIAL}-3"
        assert store.replace_gel(SERIAL, 0).gel_id == f"{SERIAL}-4"


def test_a_lost_journal_is_found_at_the_next_start(path: Path) -> None:
    """Presses that were only in the write-ahead log when the machine stopped and somebody removed the log."""
    program = f"""
import os, sys
sys.path[:0] = {sys.path!r}
from pathlib import Path
from edge.store.press_store import PressRecord, Store
from edge.store.ulid import new_ulid
store = Store(Path({str(path)!r}))
for n in range(5):
    press = PressRecord(new_ulid(10**18 + n), 10**18 + n, {SERIAL!r}, "bolt", "pass")
    store.keep_count(store.record_press(press, lambda r: []).gel)
os._exit(0)
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    path.with_name(path.name + "-wal").unlink()

    with Store(path) as store:
        assert store.gel(SERIAL, 0).presses == 5
        assert len(store.findings()) == 1


def test_a_gel_that_was_replaced_stays_replaced(path: Path) -> None:
    """The second record knows the new gel, with its limit, serial and date; the worn one does not come back."""
    record(path, 1, 2)
    with Store(path) as store:
        store.replace_gel(SERIAL, 5, "new", 700, label=GelLabel("G7", use_by="2027-01-31"))
        count(store, make_press(3))
    remove(path)

    with Store(path) as store:
        gel = store.gel(SERIAL, 0)

    assert (gel.gel_id, gel.presses, gel.limit_presses) == ("new", 1, 700)
    assert (gel.gel_serial, gel.use_by) == ("G7", "2027-01-31")


def test_a_sound_database_is_believed(path: Path) -> None:
    """No finding at an ordinary restart, nor when the second record is older, damaged or not there."""
    record(path, 1)
    counts = PressCounts(path)
    for content in (None, b"", b"x" * 2 * COPY_BYTES, counts.path.read_bytes()):
        if content is None:
            counts.path.unlink()
        else:
            counts.path.write_bytes(content)
        with Store(path) as store:
            assert store.gel(SERIAL, 0).presses == 1
            assert store.findings() == []
        assert counts.read()[SERIAL].presses == 1  # it is written again


def test_a_power_cut_while_the_second_record_is_written_leaves_the_one_before(path: Path) -> None:
    """Cut at any byte of a copy, the other copy is read: at most one press older."""
    record(path, 1, 2)
    counts = PressCounts(path)
    whole = counts.path.read_bytes()
    for start in (0, COPY_BYTES):
        for cut in range(0, 200, 7):
            counts.path.write_bytes(whole[: start + cut] + b"\xff" * 300 + whole[start + cut + 300 :])
            assert counts.read()[SERIAL].presses in (1, 2)


def test_the_second_record_is_written_in_place(path: Path) -> None:
    """Its blocks are allocated once, so a full disk does not stop it."""
    record(path, 1)
    counts = PressCounts(path)
    before = os.stat(counts.path)
    record(path, *range(2, 20))
    after = os.stat(counts.path)

    assert (after.st_size, after.st_ino) == (before.st_size, before.st_ino) == (2 * COPY_BYTES, before.st_ino)
    assert counts.read()[SERIAL].presses == 19


def test_a_second_record_that_cannot_be_written_is_said_once(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Presses are recorded without it. Once it can be written it has them all, and a further failure is said again."""
    counts = PressCounts(path)
    with Store(path) as store:
        for number in (1, 5):
            counts.path.unlink(missing_ok=True)
            counts.path.mkdir()
            for press in range(number, number + 3):
                count(store, make_press(press))
            counts.path.rmdir()
            count(store, make_press(number + 3))
            assert counts.read()[SERIAL].presses == number + 3
    assert caplog.text.count("are not kept: Is a directory") == 2


def test_presses_that_a_database_refused_are_counted_at_the_next_start(path: Path) -> None:
    """Made while the disk was full, and then the gateway ended: the gel has felt them."""
    with Store(path) as store:
        count(store, make_press(1))
        store.note_uncounted(SERIAL, 20)

    with Store(path) as store:
        assert store.gel(SERIAL, 7).presses == 21
        assert "20 presses of sensor 2BNN4ZE7 were made while it refused writes" in store.findings()[0]
    with Store(path) as store:
        assert store.gel(SERIAL, 7).presses == 21
        assert len(store.findings()) == 1, "said until a person acknowledges it"


def test_a_press_recorded_just_before_the_process_died_is_not_counted_again(path: Path) -> None:
    """It was one of three that waited, and the second record still says so."""
    with Store(path) as store:
        count(store, make_press(1))
        store.note_uncounted(SERIAL, 3)
        store.record_press(make_press(2), lambda recorded: [])

    with Store(path) as store:
        assert store.gel(SERIAL, 7).presses == 1 + 3
        assert "2 presses of sensor 2BNN4ZE7 were made while it refused writes" in store.findings()[0]


def test_an_earlier_count_that_waits_does_not_replace_one_that_was_corrected(path: Path) -> None:
    """The gel is said anew at the start; what an earlier life left in the outbox would be retained over it."""
    old = Message("gel", b'{"presses": 1}', retain=True)
    with Store(path) as store:
        sent = [old, Message("result", b"{}")]
        store.keep_count(store.record_press(make_press(1), lambda recorded: sent).gel)
        store.note_uncounted(SERIAL, 20)
    with Store(path) as store, Outbox(path) as outbox:
        outbox.register(["mqtt"])
        assert store.gel(SERIAL, 7).presses == 21
        assert [row.message.topic for row in outbox.pending("mqtt", 9)] == ["result"]


def test_uncounted_presses_stop_no_new_gel_from_taking_the_place_of_an_impossible_one(path: Path) -> None:
    """It is what the refusal of such a gel tells to do."""
    with Store(path) as store:
        count(store, make_press(1))
        store.note_uncounted(SERIAL, 20)
    execute(path, "UPDATE gels SET presses = -30, limit_presses = 0")

    with Store(path) as store:
        with pytest.raises(StoreError, match="gelgate gel replace"):
            store.gel(SERIAL, 7)
        gel = store.replace_gel(SERIAL, 8)

    assert (gel.gel_id, gel.presses) == (f"{SERIAL}-2", 0)


def test_the_sensors_used_last_are_remembered(path: Path) -> None:
    """With ids of the greatest length all of them fit; the file does not grow."""
    counts, most = PressCounts(path), 10_000_000
    for n in range(20):
        label = {"gel_serial": '"' * LONGEST_ID, "use_by": "2027-01-31"}
        counts.write(
            f"S{n}" + "\u3042" * 60, Count("\u3042" * LONGEST_ID, n, most, most, most, most, **label)
        )

    assert [count.presses for count in counts.read().values()] == list(range(12, 20))


@pytest.mark.parametrize("is_replaced", [False, True])
def test_a_file_that_is_removed_while_the_station_runs_takes_no_press(path: Path, is_replaced: bool) -> None:
    """SQLite would go on into a file that nobody finds again; what is put back as it was goes on."""
    with Store(path) as store:
        count(store, make_press(1))
        away = path.rename(path.with_name("away.db"))
        if is_replaced:
            shutil.copy(away, path)
        with pytest.raises(StoreError, match="its file was removed or replaced"):
            count(store, make_press(2))
        away.replace(path)
        count(store, make_press(2))
        assert execute(path, "SELECT count(*) FROM presses") == [(2,)]
