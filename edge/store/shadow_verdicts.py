"""What shadows said of presses: the column `shadow` of the history, and what people said of the same presses.

Functions that take a connection run inside the caller's transaction.
"""

import sqlite3
from typing import NamedTuple

from edge.core.part_position import PartPosition
from edge.core.person_verdict import settle
from edge.core.shadow import JudgedTwice
from edge.store.person_verdicts import read_verdicts

__all__ = ["UnjudgedDamage", "read_judged_twice"]


class UnjudgedDamage(NamedTuple):
    """A press that somebody called damaged and that the shadow has not judged. saying: what holds of it now."""

    press_id: str
    verdict: str
    evidence: bytes | None
    saying: str | None


def read_judged_twice(
    connection: sqlite3.Connection, part: PartPosition, bundle_id: str, beside: str
) -> tuple[list[JudgedTwice], list[UnjudgedDamage]]:
    """Read the presses that a shadow has judged beside a bundle, oldest first, and the damage of the same part that it
    has not."""
    said = read_verdicts(connection)
    damaged = {key for key, words in said.items() if any(word.saying == "damaged" for word in words)}

    def settled(press_id: str) -> str | None:
        verdict = settle(said.get(press_id, ()))
        return verdict.saying if verdict else None

    rows = connection.execute(
        "SELECT press_id, verdict, json_extract(shadow, '$.verdict') FROM presses WHERE part = ? AND position IS ? "
        "AND shadow IS NOT NULL AND json_extract(shadow, '$.bundle_id') = ? AND json_extract(shadow, '$.beside') = ? "
        "ORDER BY number",
        (*part, bundle_id, beside),
    )
    both = [JudgedTwice(key, here, there, settled(key), key in damaged) for key, here, there in rows]
    missing, query = (
        list[UnjudgedDamage](),
        "SELECT part, position, verdict, evidence FROM presses WHERE press_id = ?",
    )
    for press_id in sorted(damaged - {one.press_id for one in both}):
        row = connection.execute(query, (press_id,)).fetchone()
        if row is None:  # older than the history, so its part is not known either
            missing.append(UnjudgedDamage(press_id, "", None, settled(press_id)))
        elif row[:2] == tuple(part):
            missing.append(UnjudgedDamage(press_id, row[2], row[3], settled(press_id)))
    return both, missing
