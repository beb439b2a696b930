"""The table of pieces: each with its plan from its begin on, and with its verdict once it is over.

What was pressed of a piece are the rows of `presses` with its id. At most one piece is in progress. Functions that take
a connection run inside the caller's transaction.
"""

import json
import sqlite3
from typing import Final, NamedTuple, cast

from edge.core.part_position import PartPosition
from edge.core.piece import End, Order, Piece, PieceVerdict
from edge.core.ports import Message
from edge.store import ledger_chain, outbox
from edge.store.database import insert

__all__ = [
    "KEPT_PIECES",
    "LastPiece",
    "begin",
    "count_ended",
    "end",
    "is_recorded",
    "is_selected_since",
    "read_asked",
    "read_last",
    "read_verdict",
]

# Rows kept, some 250 bytes each: as many as presses.
KEPT_PIECES: Final = 1_000_000


class LastPiece(NamedTuple):
    """The piece that was begun last. ended_by, verdict: None while it is in progress."""

    piece: Piece
    ended_by: End | None
    verdict: PieceVerdict | None


def begin(connection: sqlite3.Connection, piece: Piece) -> None:
    """Add it. None may be in progress."""
    places = json.dumps(piece.places)
    row = {"piece_id": piece.piece_id, "began_ns": piece.began_ns, "places": places}
    number = insert(connection, "pieces", {**row, "place_order": piece.order})
    ledger_chain.append(connection, "piece", number)
    connection.execute("DELETE FROM pieces WHERE number <= ?", (number - KEPT_PIECES,))


def end(connection: sqlite3.Connection, piece: Piece, why: End, ended_ns: int, message: Message) -> None:
    """Write its verdict, and queue the message that says so: both once."""
    (number,) = connection.execute(
        "UPDATE pieces SET ended_ns = ?, ended_by = ?, verdict = ? WHERE piece_id = ? AND ended_ns IS NULL "
        "RETURNING number",
        (ended_ns, why, piece.verdict, piece.piece_id),
    ).fetchone()
    ledger_chain.append(connection, "piece", number)
    (running_ns,) = connection.execute("SELECT running_ns FROM running").fetchone()
    outbox.put(connection, [message], piece.verdict, ended_ns, running_ns)


def read_last(connection: sqlite3.Connection) -> LastPiece | None:
    """Read the piece that was begun last, with what was pressed of it; None before the first."""
    row = connection.execute(
        "SELECT piece_id, began_ns, places, place_order, ended_by, verdict FROM pieces ORDER BY number DESC LIMIT 1"
    ).fetchone()
    if row is None:
        return None
    piece_id, began_ns, places, order, ended_by, verdict = row
    planned = tuple(PartPosition(*place) for place in json.loads(places))
    piece = Piece(piece_id, began_ns, planned, cast(Order, order))
    presses = connection.execute(
        "SELECT part, position, press_id, verdict FROM presses WHERE piece_id = ? ORDER BY number",
        (piece_id,),
    )
    for part, position, press_id, word in presses:
        piece = piece.take(PartPosition(part, position), press_id, word)
    return LastPiece(piece, ended_by, verdict)


def count_ended(connection: sqlite3.Connection, after: int) -> tuple[dict[str, int], int]:
    """Count the pieces that are over by their verdict, of those after a number; return the number of the last too."""
    query = "SELECT verdict, COUNT(*), MAX(number) FROM pieces WHERE number > ? AND ended_ns NOTNULL GROUP BY verdict"
    rows = connection.execute(query, (after,)).fetchall()
    return {verdict: count for verdict, count, _ in rows}, max((last for *_, last in rows), default=after)


def is_recorded(connection: sqlite3.Connection, press_id: str) -> bool:
    """Tell whether the history of parts has a press."""
    row = connection.execute("SELECT 1 FROM presses WHERE press_id = ?", (press_id,)).fetchone()
    return row is not None


def read_verdict(connection: sqlite3.Connection, piece_id: str) -> tuple[str | None] | None:
    """Read the verdict of a piece, with None inside while it is in progress; None for an id that is new."""
    query = "SELECT verdict FROM pieces WHERE piece_id = ?"
    row: tuple[str | None] | None = connection.execute(query, (piece_id,)).fetchone()
    return row


def is_selected_since(connection: sqlite3.Connection) -> bool:
    """Tell whether what is selected was selected after the newest press."""
    row = connection.execute(
        "SELECT 1 FROM selected JOIN bundles_in_use USING (part, position) "
        "WHERE time_ns > (SELECT time_ns FROM presses ORDER BY number DESC LIMIT 1)"
    ).fetchone()
    return row is not None


def read_asked(connection: sqlite3.Connection) -> str | None:
    """Return the id of the press for which the newest one of the history has asked for a second; None for none."""
    row = connection.execute(
        "SELECT press_id, second_of, verdict = 'unsure' AND score > threshold, score IS NULL FROM presses "
        "ORDER BY number DESC LIMIT 1"
    ).fetchone()
    press_id, second_of, is_above, has_no_score = row or ("", None, False, False)
    if second_of is not None:
        return str(second_of) if has_no_score else None
    return str(press_id) if is_above else None
