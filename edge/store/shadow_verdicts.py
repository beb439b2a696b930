"""What shadows said of presses: the column `shadow` of the history, and what people said of the same presses.

Functions that take a connection run inside the caller's transaction.
"""

import sqlite3
from collections.abc import Collection, Iterable, Sequence
from pathlib import PurePath
from typing import NamedTuple

from edge.core.part_position import PartPosition
from edge.core.person_verdict import PersonVerdict, settle
from edge.core.shadow import JudgedTwice
from edge.store.gel_proofs import GelBundle, unproven_since
from edge.store.person_verdicts import read_verdicts

__all__ = ["Unjudged", "read_judged_twice", "read_learnt"]


class Unjudged(NamedTuple):
    """A press that somebody called damaged, or a good one of the mounted gel, that the shadow has not judged. saying:
    what holds of it now."""

    press_id: str
    verdict: str
    evidence: bytes | None
    saying: str | None
    was_damaged: bool = True


def read_judged_twice(
    connection: sqlite3.Connection,
    part: PartPosition,
    bundle_id: str,
    beside: str,
    learnt: Collection[str] = (),
) -> tuple[list[JudgedTwice], list[Unjudged]]:
    """Read the presses that a shadow has judged beside a bundle, oldest first, and those of the same part that it has
    not, of damage and of these that it has learnt."""
    said = read_verdicts(connection)
    damaged = {key for key, words in said.items() if any(word.saying == "damaged" for word in words)}

    def settled(press_id: str) -> str | None:
        return _settle(said.get(press_id, ()))

    rows = connection.execute(
        "SELECT press_id, verdict, json_extract(shadow, '$.verdict') FROM presses WHERE part = ? AND position IS ? "
        "AND shadow IS NOT NULL AND json_extract(shadow, '$.bundle_id') = ? AND json_extract(shadow, '$.beside') = ? "
        "ORDER BY number",
        (*part, bundle_id, beside),
    )
    both = [JudgedTwice(key, here, there, settled(key), key in damaged) for key, here, there in rows]
    missing, query = (
        list[Unjudged](),
        "SELECT part, position, verdict, evidence FROM presses WHERE press_id = ?",
    )
    for press_id in sorted((damaged | set(learnt)) - {one.press_id for one in both}):
        row = connection.execute(query, (press_id,)).fetchone()
        if row is None:  # older than the history, so its part is not known either
            missing.append(Unjudged(press_id, "", None, settled(press_id), press_id in damaged))
        elif row[:2] == tuple(part):
            missing.append(Unjudged(press_id, row[2], row[3], settled(press_id), press_id in damaged))
    return both, missing


def read_learnt(connection: sqlite3.Connection, key: GelBundle, names: Iterable[str]) -> set[str]:
    """Read which presses of a gel, that people call good, a bundle has learnt; nothing where the bundle in use is
    proven on this gel. key: of the bundle in use. names: of the presses of the other one's fit."""
    if unproven_since(connection, key) is None:
        return set()
    said, known = read_verdicts(connection), {PurePath(name).stem for name in names}
    good = {press_id for press_id in known & said.keys() if _settle(said[press_id]) == "good"}
    query = "SELECT press_id FROM presses WHERE serial = ? AND gel_id = ?"
    return {row[0] for row in connection.execute(query, key[:2])} & good


def _settle(words: Sequence[PersonVerdict]) -> str | None:
    verdict = settle(words)
    return verdict.saying if verdict else None
