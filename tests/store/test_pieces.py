"""The table of pieces: chained like everything of the ledger, also where old rows go."""

import sqlite3
from pathlib import Path

import pytest
from recorded_presses import T0, make_press

from edge.core.errors import StoreError
from edge.core.part_position import PartPosition
from edge.core.piece import Piece
from edge.core.ports import Message
from edge.store import pieces, press_store
from edge.store.integrity import check_database
from edge.store.press_store import Store

PLACE = PartPosition("bolt", "left")


def piece(number: int) -> Piece:
    return Piece(f"P{number}", T0 + number, (PLACE,), "free")


def press_pieces(store: Store, numbers: range) -> None:
    """A press for each of these pieces, which begins and ends it."""

    def write(connection: sqlite3.Connection, number: int) -> None:
        pieces.begin(connection, piece(number))
        last = pieces.read_last(connection)
        assert last is not None
        pieces.end(connection, last.piece, "complete", T0, Message("piece_result", b"{}"))

    for number in numbers:
        press = make_press(number, position="left", piece_id=f"P{number}")
        store.record_press(press, lambda recorded: [], None, lambda it, number=number: write(it, number))


def test_the_ledger_agrees_after_old_rows_have_gone(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept of either is chained."""
    monkeypatch.setattr(press_store, "KEPT_PRESSES", 4)
    monkeypatch.setattr(pieces, "KEPT_PIECES", 6)
    monkeypatch.setattr("edge.store.integrity.KEPT_PIECES", 6)
    with Store(path) as store:
        press_pieces(store, range(20))
        kept = store.read("reading", lambda it: it.execute("SELECT piece_id FROM pieces").fetchall())
        last = store.read("reading", pieces.read_last)

    assert [piece_id for (piece_id,) in kept] == [f"P{number}" for number in range(14, 20)]
    assert last is not None
    assert (last.piece.piece_id, last.verdict, last.ended_by) == ("P19", "pass", "complete")
    assert [one for one in check_database(path) if one.is_fault] == []


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("UPDATE pieces SET verdict = 'fail' WHERE number = 2", "piece 2 was changed after it was written"),
        ("DELETE FROM pieces WHERE number = 2", "piece 2 was removed"),
        (
            "INSERT INTO pieces (piece_id, began_ns, places, place_order, ended_ns) VALUES ('X', 0, '[]', 'free', 1)",
            "piece 4 was inserted: it has no link",
        ),
    ],
)
def test_a_changed_piece_is_found(path: Path, change: str, sentence: str) -> None:
    with Store(path) as store:
        press_pieces(store, range(3))
        store.write("changing", lambda it: it.execute(change))

    assert sentence in check_database(path)[0].text


def test_two_pieces_are_never_in_progress(path: Path) -> None:
    """The database refuses the second one, and an id that it has."""
    with Store(path) as store:
        store.write("beginning", lambda it: pieces.begin(it, piece(1)))
        with pytest.raises(StoreError, match="UNIQUE constraint failed"):
            store.write("beginning", lambda it: pieces.begin(it, piece(2)))
        last = store.read("reading", pieces.read_last)

    assert last is not None
    assert last.piece == piece(1)


def test_the_press_that_waits_for_a_second_one_is_known_after_a_restart(path: Path) -> None:
    """A press that asked, or the first one of a second that had no score and asks once more."""
    first = make_press(0, "unsure", score=2.0).press_id
    with Store(path) as store:
        waits = [
            (store.record_press(press, lambda recorded: []), store.read("reading", pieces.read_asked))[1]
            for press in (
                make_press(0, "unsure", score=2.0),
                make_press(1, "error", second_of=first),
                make_press(2, "fail", score=2.0, second_of=first),
                make_press(3, "unsure", score=0.5),
            )
        ]
    assert waits == [first, first, None, None]
