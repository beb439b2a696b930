"""What shadows said of presses: the column `shadow` of the history, and what people said of the same presses.

Functions that take a connection run inside the caller's transaction.
"""

import json
import sqlite3
from collections.abc import Collection, Iterable, Sequence
from pathlib import PurePath
from typing import NamedTuple

from edge.core.part_position import PartPosition
from edge.core.person_verdict import PersonVerdict, settle
from edge.core.shadow import JudgedTwice
from edge.store.person_verdicts import read_verdicts

__all__ = ["Unjudged", "read_good_passes", "read_judged_twice", "read_learnt"]


class Unjudged(NamedTuple):
    """A press that somebody called damaged, or that people call good, and that the shadow has not judged. saying: what
    holds of it now."""

    press_id: str
    verdict: str
    evidence: bytes | None
    saying: str | None
    was_damaged: bool = True


def read_good_passes(
    connection: sqlite3.Connection, part: PartPosition, gel: tuple[str, str], most: int
) -> list[str]:
    """Read the newest presses of a part on a gel that passed and that people call good, or the gel. gel: serial and
    id."""
    good = [key for key, words in read_verdicts(connection).items() if _settle(words) in ("good", "gel")]
    query = (
        "SELECT press_id FROM presses WHERE part = ? AND position IS ? AND serial = ? AND gel_id = ? AND "
        "verdict = 'pass' AND press_id IN (SELECT value FROM json_each(?)) ORDER BY number DESC LIMIT ?"
    )
    return [key for (key,) in connection.execute(query, (*part, *gel, json.dumps(good), most))]


def read_judged_twice(
    connection: sqlite3.Connection,
    part: PartPosition,
    bundle_id: str,
    beside: str,
    good: Collection[str] = (),
) -> tuple[list[JudgedTwice], list[Unjudged]]:
    """Read the presses that a shadow has judged beside a bundle, oldest first, and those of the same part that it has
    not, of damage and of these good ones."""
    verdicts = read_verdicts(connection)
    damaged = {key for key, words in verdicts.items() if any(word.saying == "damaged" for word in words)}

    def settled(press_id: str) -> str | None:
        return _settle(verdicts.get(press_id, ()))

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
    for press_id in sorted((damaged | set(good)) - {one.press_id for one in both}):
        row = connection.execute(query, (press_id,)).fetchone()
        if row is None:  # older than the history, so its part is not known either
            missing.append(Unjudged(press_id, "", None, settled(press_id), press_id in damaged))
        elif row[:2] == tuple(part):
            missing.append(Unjudged(press_id, row[2], row[3], settled(press_id), press_id in damaged))
    return both, missing


def read_learnt(connection: sqlite3.Connection, names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Read which presses that people call good a bundle has learnt, with sensor and gel of each. names: of the presses
    of its fit."""
    verdicts, known = read_verdicts(connection), {PurePath(name).stem for name in names}
    good = [press_id for press_id in known & verdicts.keys() if _settle(verdicts[press_id]) == "good"]
    query = "SELECT serial, gel_id FROM presses WHERE press_id = ?"
    rows = {press_id: connection.execute(query, (press_id,)).fetchone() for press_id in good}
    return {press_id: row for press_id, row in rows.items() if row is not None}


def _settle(words: Sequence[PersonVerdict]) -> str | None:
    verdict = settle(words)
    return verdict.saying if verdict else None
