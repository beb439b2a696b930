"""The table of acts: every request to the station and its outcome. Runs inside the caller's transaction.

An act is written before it is done, and completed afterwards. One without an outcome was interrupted.
"""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from edge.core.part_position import PartPosition
from edge.store import ledger_chain
from edge.store.database import insert

__all__ = [
    "ASK_AGAIN",
    "CONFIRM",
    "TAKE_OVER",
    "Act",
    "Outcome",
    "begin",
    "earlier",
    "find_unseen_takeover",
    "finish",
    "newest",
    "select_part",
    "was_adopted",
]

# What people said of presses (edge.store.person_verdicts).
CONFIRM: Final = "confirm_press"
# Another bundle takes the place of the one in use (edge.features.shadow).
TAKE_OVER: Final = "take_over"
# That the station asks about a press once more.
ASK_AGAIN: Final = "ask_again"

# Counted apart: refused requests, what people said, what a line asks for with each part, and all others. So no flood of
# refusals, and no line that selects a part every few seconds, pushes out what a person did. At a page is a person.
KEPT_ACTS: Final = 100_000
KEPT_REFUSALS: Final = 10_000

Outcome = Literal["done", "failed", "refused"]

_EACH_PART: Final = "verb IN ('select_part', 'begin_piece', 'trigger') AND who NOT LIKE '%page'"
_KINDS: Final = (
    f"verb = '{CONFIRM}'",
    _EACH_PART,
    f"verb <> '{CONFIRM}' AND NOT ({_EACH_PART})",
)

_COLUMNS = "time_ns, who, verb, request, arguments, signature, outcome, sentence, before, after, act_id"


@dataclass(frozen=True)
class Act:
    """One request."""

    time_ns: int
    """Wall clock."""
    who: str
    """Through which receiver, signed or not, and the name that was claimed."""
    verb: str
    request: str | None = None
    """Its transaction id."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    signature: str | None = None
    outcome: Outcome | None = None
    """None while it is being done."""
    sentence: str | None = None
    """Why it failed or was refused."""
    before: Mapping[str, Any] | None = None
    """What the act changes, as far as it is known."""
    after: Mapping[str, Any] | None = None
    act_id: int = 0


def select_part(
    time_ns: int, who: str, arguments: Mapping[str, Any], before: PartPosition, after: PartPosition
) -> Act:
    """Make the act of a station that selects a part by itself, done with the selection."""
    then, now = before._asdict(), after._asdict()
    return Act(time_ns, who, "select_part", None, arguments, outcome="done", before=then, after=now)


def begin(connection: sqlite3.Connection, act: Act, running_ns: int) -> int:
    """Add it, and return its number."""
    row = {**vars(act), "running_ns": running_ns}
    row |= {name: _json(row[name]) for name in ("arguments", "before", "after")}
    del row["act_id"]
    number = insert(connection, "acts", row)
    if act.outcome != "refused":
        ledger_chain.append(connection, "act", number)
    _remove_old(connection, number, "outcome = 'refused'", KEPT_REFUSALS)
    done = "outcome IS NOT 'refused' AND"
    # Each reads all acts, so each has its turn.
    removed = [
        _remove_old(connection, number + turn, f"{done} {kind}", KEPT_ACTS)
        for turn, kind in enumerate(_KINDS)
    ]
    if any(removed):
        ledger_chain.note_removed_acts(connection, max(removed))
    return number


def _remove_old(connection: sqlite3.Connection, number: int, condition: str, kept: int) -> int:
    """Keep the newest that fit, and up to a hundredth more: all are counted at one act in so many, for it takes long.
    number: counts acts. Return the newest id that was removed, or 0."""
    if number % max(1, kept // 100):
        return 0
    oldest = f"SELECT act_id FROM acts WHERE {condition} ORDER BY act_id DESC LIMIT 1 OFFSET ?"
    row = connection.execute(oldest, (kept,)).fetchone()
    if row is None:
        return 0
    connection.execute(f"DELETE FROM acts WHERE {condition} AND act_id <= ?", row)
    return int(row[0])


def finish(
    connection: sqlite3.Connection,
    act_id: int,
    outcome: Outcome,
    sentence: str | None,
    before: Mapping[str, Any] | None,
    after: Mapping[str, Any] | None,
) -> None:
    """Complete it."""
    updated = connection.execute(
        "UPDATE acts SET outcome = ?, sentence = ?, before = ?, after = ? WHERE act_id = ?",
        (outcome, sentence, _json(before), _json(after), act_id),
    )
    if updated.rowcount:
        ledger_chain.append(connection, "act", act_id)


def earlier(
    connection: sqlite3.Connection, verb: str, request: str, signature: str | None, after_ns: int
) -> Act | None:
    """Find the same request: by signature at any time; by transaction id since this running time, if it was done."""
    row = connection.execute(
        f"SELECT {_COLUMNS} FROM acts WHERE outcome IS NOT 'refused' AND "
        "((? IS NOT NULL AND signature = ?) OR (verb = ? AND request = ? AND running_ns >= ? "
        "AND outcome IS NOT 'failed')) ORDER BY act_id DESC LIMIT 1",
        (signature, signature, verb, request, after_ns),
    ).fetchone()
    return None if row is None else _act(row)


def was_adopted(connection: sqlite3.Connection, bundle_id: str) -> bool:
    """Tell whether this bundle has ever taken another one's place."""
    query = "SELECT 1 FROM acts WHERE verb = ? AND json_extract(after, '$.bundle_id') = ? LIMIT 1"
    return connection.execute(query, (TAKE_OVER, bundle_id)).fetchone() is not None


def find_unseen_takeover(connection: sqlite3.Connection) -> Act | None:
    """Find the newest takeover; None where there is none, or somebody has acknowledged its alarm since. A refused
    request may have any verb."""
    row = connection.execute(
        f"SELECT {_COLUMNS} FROM acts WHERE verb = ? AND outcome = 'done' AND act_id > coalesce((SELECT max(act_id) "
        "FROM acts WHERE verb = 'acknowledge_alarm' AND outcome = 'done' AND "
        "json_extract(arguments, '$.alarm') = 'takeover'), 0) ORDER BY act_id DESC LIMIT 1",
        (TAKE_OVER,),
    ).fetchone()
    return None if row is None else _act(row)


def newest(connection: sqlite3.Connection, limit: int) -> list[Act]:
    """The newest acts, newest first."""
    rows = connection.execute(f"SELECT {_COLUMNS} FROM acts ORDER BY act_id DESC LIMIT ?", (limit,))
    return [_act(row) for row in rows]


def _act(row: tuple[Any, ...]) -> Act:
    values = dict(zip(_COLUMNS.split(", "), row, strict=True))
    for name in ("arguments", "before", "after"):
        values[name] = None if values[name] is None else json.loads(values[name])
    return Act(**values)


def _json(content: Mapping[str, Any] | None) -> str | None:
    return None if content is None else json.dumps(dict(content))
