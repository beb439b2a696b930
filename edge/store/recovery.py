"""What is done when the database knows less of a gel than the second record of its counts.

The higher count is used: a gel that is replaced too early costs less than one that is worn out and trusted.
"""

import sqlite3

from edge.store import gel_ledger, ledger_chain
from edge.store.press_counts import Count

__all__ = ["recover"]


def recover(connection: sqlite3.Connection, known: Count | None, serial: str, time_ns: int) -> list[str]:
    """Correct the ledger inside the caller's transaction; one sentence for each correction.

    known: the second record of this sensor. A database with a newer press than the record is right about its gel; one
    with older presses only was removed, emptied, cut or replaced by an old copy.
    """
    if known is None:
        return []
    sentences = []
    (newest,) = connection.execute(
        "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'presses'"
    ).fetchone()
    if newest < known.sequence:
        _continue_numbers(connection, known.sequence)
        _restore_gel(connection, known, serial, time_ns)
        sentences.append(
            f"presses {newest + 1} to {known.sequence} are missing, so it was removed, damaged or replaced by an old "
            f"copy; gel {known.gel_id} of sensor {serial} goes on from {known.presses} presses. Look for the lost "
            "file; unsent results in it are lost"
        )
    if known.uncounted:
        gel_ledger.count_press(connection, serial, time_ns, known.uncounted)
        sentences.append(
            f"{known.uncounted} presses of sensor {serial} were made while it refused writes; they are counted on the "
            "gel now, and their results are lost"
        )
    return sentences


def _continue_numbers(connection: sqlite3.Connection, sequence: int) -> None:
    """No number is used twice, so that subscribers see the gap."""
    updated = connection.execute("UPDATE sqlite_sequence SET seq = ? WHERE name = 'presses'", (sequence,))
    if updated.rowcount == 0:
        connection.execute("INSERT INTO sqlite_sequence (name, seq) VALUES ('presses', ?)", (sequence,))


def _restore_gel(connection: sqlite3.Connection, known: Count, serial: str, time_ns: int) -> None:
    connection.execute(
        "UPDATE gels SET removed_ns = ? WHERE serial = ? AND removed_ns IS NULL AND gel_id <> ?",
        (time_ns, serial, known.gel_id),
    )
    connection.execute(
        "INSERT INTO gels (serial, gel_id, presses, limit_presses, installed_ns, note) VALUES (?, ?, ?, ?, ?, ?) "
        "ON CONFLICT (serial, gel_id) DO UPDATE SET presses = max(presses, excluded.presses), removed_ns = NULL",
        (
            serial,
            known.gel_id,
            known.presses,
            known.limit_presses,
            time_ns,
            "restored from the second record",
        ),
    )
    ledger_chain.append_gels(connection, serial)
