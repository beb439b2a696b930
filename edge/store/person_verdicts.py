"""What people said of presses: acts of the verb `confirm_press`, which the ledger chains like every act.

Functions that take a connection run inside the caller's transaction.
"""

import json
import sqlite3
from collections import defaultdict
from collections.abc import Iterable
from typing import Final, NamedTuple

from edge.core.part_position import PartPosition
from edge.core.person_verdict import Asked, PersonVerdict, settle
from edge.store.acts import ASK_AGAIN, CONFIRM, Act
from edge.store.press_store import Store

__all__ = [
    "AskedAgain",
    "Found",
    "ask_again",
    "count_good",
    "find_table",
    "newest_acts",
    "read_as_shadow",
    "read_askable",
    "read_passed",
    "read_spoken_of",
    "read_verdicts",
]

# An act of so long of running ends no search, however old it seems: the clock may have been behind, as after a start.
_BEHIND_NS: Final = 86_400 * 10**9

# What `Commands` adds to a name, which itself may have commas; first what a page of another machine adds, too.
_WAYS: Final = (
    ", at a page, over MQTT, signed",
    ", over MQTT, signed",
    ", over MQTT, unsigned",
    ", at the page",
)


def read_verdicts(
    connection: sqlite3.Connection, since_ns: int | None = None, press_id: str = ""
) -> dict[str, list[PersonVerdict]]:
    """Read what was said of each press by its id, oldest first. since_ns: wall clock; only what was said since then, in
    a time that does not grow with what was said a day of running before. press_id: only of this press."""
    verdicts: dict[str, list[PersonVerdict]] = defaultdict(list)
    before = (
        "SELECT act_id FROM acts WHERE time_ns < :since AND running_ns < "
        "(SELECT running_ns FROM acts ORDER BY act_id DESC LIMIT 1) - :behind ORDER BY act_id DESC LIMIT 1"
    )
    rows = connection.execute(
        f"SELECT time_ns, who, arguments FROM acts NOT INDEXED WHERE act_id > coalesce(({before}), 0) "
        "AND verb = :verb AND outcome = 'done' AND instr(arguments, :press) "
        "AND (:since IS NULL OR time_ns >= :since) ORDER BY act_id",
        {"since": since_ns, "behind": _BEHIND_NS, "verb": CONFIRM, "press": press_id},
    )
    for time_ns, who, arguments in rows:
        given = json.loads(arguments)
        verdict = PersonVerdict(given["press_id"], time_ns, _name(who), given["verdict"], given.get("kind"))
        verdicts[verdict.press_id].append(verdict)
    return dict(verdicts)


def read_spoken_of(connection: sqlite3.Connection, after: int) -> tuple[int, set[str]]:
    """Read of which presses people spoke after an act, and the number of the newest act. A request that is not done
    yet, or was never completed, may have anything for arguments: what is no text names no press."""
    (newest,) = connection.execute("SELECT coalesce(max(act_id), 0) FROM acts").fetchone()
    query = (
        "SELECT CASE WHEN json_valid(arguments) THEN json_extract(arguments, '$.press_id') END FROM acts NOT INDEXED "
        "WHERE act_id > ? AND verb = ? AND outcome IS NOT 'refused'"
    )
    rows = connection.execute(query, (after, CONFIRM))
    return int(newest), {one for (one,) in rows if isinstance(one, str)}


def _name(who: str) -> str:
    for way in _WAYS:
        if who.endswith(way):
            return who.removesuffix(way)
    return who


class Found(NamedTuple):
    """A press that was looked for: its table, the machine's verdict, and the SHA-256 of its record in the archive."""

    name: str
    verdict: str
    evidence: bytes | None


def find_table(connection: sqlite3.Connection, press_id: str) -> Found | None:
    """Find a press by its id; None for one that this database does not have."""
    for table, evidence in (
        ("presses", "evidence"),
        ("reference_presses", "NULL"),
        ("study_presses", "NULL"),
    ):
        query = f"SELECT verdict, {evidence} FROM {table} WHERE press_id = ?"
        if (row := connection.execute(query, (press_id,)).fetchone()) is not None:
            return Found(table, *row)
    return None


def read_passed(connection: sqlite3.Connection, press_ids: Iterable[str]) -> list[str]:
    """Read which of these presses of parts passed, oldest first."""
    query = (
        "SELECT press_id FROM presses WHERE verdict = 'pass' AND press_id IN (SELECT value FROM json_each(?)) "
        "ORDER BY number"
    )
    return [press_id for (press_id,) in connection.execute(query, (json.dumps(list(press_ids)),))]


def read_as_shadow(
    connection: sqlite3.Connection, press_ids: Iterable[str], bundle_id: str
) -> dict[str, str]:
    """Read what this bundle said, as the shadow, of those of these presses that did not pass, oldest first."""
    query = (
        "SELECT press_id, json_extract(shadow, '$.verdict') FROM presses WHERE verdict <> 'pass' AND "
        "press_id IN (SELECT value FROM json_each(?)) AND json_extract(shadow, '$.bundle_id') = ? ORDER BY number"
    )
    return dict(connection.execute(query, (json.dumps(list(press_ids)), bundle_id)))


def count_good(
    connection: sqlite3.Connection, part: PartPosition, gel: tuple[str, str], since_ns: int, press_id: str
) -> tuple[int, int]:
    """Count the presses of a part on a gel since then that people call good, and those of them that did not pass. gel:
    serial and id. press_id: one that somebody calls good now."""
    settled = {key: settle(words) for key, words in read_verdicts(connection, since_ns).items()}
    good = {press_id} | {key for key, word in settled.items() if word is not None and word.saying == "good"}
    query = (
        "SELECT count(*), coalesce(sum(verdict <> 'pass'), 0) FROM presses WHERE part = ? AND position IS ? "
        "AND serial = ? AND gel_id = ? AND time_ns >= ? AND press_id IN (SELECT value FROM json_each(?))"
    )
    row = connection.execute(query, (*part, *gel, since_ns, json.dumps(sorted(good)))).fetchone()
    return int(row[0]), int(row[1])


def read_askable(connection: sqlite3.Connection, after: int, most: int) -> list[tuple[int, Asked]]:
    """Read those of the newest `most` presses after this number that are archived, and scored or rejected, with their
    numbers."""
    rows = connection.execute(
        f"SELECT {_ASKED} FROM presses "
        "WHERE number > max(?, (SELECT coalesce(max(number), 0) FROM presses) - ?) AND evidence IS NOT NULL "
        "AND (score > 0 AND threshold > 0 AND verdict IN ('pass', 'fail', 'unsure') OR verdict = 'rejected') "
        "ORDER BY number",
        (after, most),
    )
    return [(number, Asked(*row)) for number, *row in rows]


_IS_ASKED_AGAIN = f"verb = '{ASK_AGAIN}' AND outcome = 'done'"  # a refused request may have any verb
_ASKED = "number, press_id, presses.time_ns, presses.verdict, score / threshold, part, position"


def ask_again(store: Store, press_ids: Iterable[str], who: str, time_ns: int) -> str:
    """Have the station ask about presses once more, each once ever: a word of it stands against a new bundle. Return a
    sentence that names them, empty for none. who: for the table of acts. Errors: StoreError."""
    query = f"SELECT json_extract(arguments, '$.press_id') FROM acts WHERE {_IS_ASKED_AGAIN}"
    known = {
        row[0] for row in store.read("reading what is asked again", lambda it: it.execute(query).fetchall())
    }
    asked = [press_id for press_id in press_ids if press_id not in known]
    for press_id in asked:
        act = Act(time_ns, who, ASK_AGAIN, arguments={"press_id": press_id}, outcome="done")
        store.begin_act(act)
    return (
        f"the station asks once more what {', '.join(asked)} {'is' if len(asked) == 1 else 'are'}"
        if asked
        else ""
    )


class AskedAgain:
    """The presses that are asked about once more, until somebody speaks of them. Each word is looked at a few times and
    then never again, so a look takes a time that does not grow with what was said before."""

    def __init__(self) -> None:
        self._answered: set[str] = set()
        self._after = 0

    def read(self, connection: sqlite3.Connection) -> list[Asked]:
        """Read those that nobody has spoken of since they were asked, oldest first."""
        rows = connection.execute(
            f"SELECT act_id, {_ASKED} FROM acts JOIN presses ON press_id = json_extract(arguments, '$.press_id') "
            f"WHERE {_IS_ASKED_AGAIN} ORDER BY presses.number",
        ).fetchall()
        asked = {row[0]: (act_id, Asked(*row)) for act_id, _, *row in rows}
        if asked:
            first = min(act_id for act_id, _ in asked.values())
            newest, _ = newest_acts(connection)
            words = connection.execute(
                "SELECT act_id, json_extract(arguments, '$.press_id') FROM acts NOT INDEXED "
                "WHERE act_id > ? AND verb = ? AND outcome = 'done'",
                # One of the newest hundred may not have been done at the last look.
                (max(first, self._after - 100), CONFIRM),
            )
            self._answered |= {one for act_id, one in words if one in asked and act_id > asked[one][0]}
            self._after = newest
        return [press for _, press in asked.values() if press.press_id not in self._answered]


def newest_acts(connection: sqlite3.Connection) -> tuple[int, int]:
    """Find the number of the newest act, and how many of the newest hundred have no outcome yet.

    The pair is another one after each act that is written, and after each that is completed.
    """
    newest = "SELECT act_id, outcome FROM acts ORDER BY act_id DESC LIMIT 100"
    query = f"SELECT coalesce(max(act_id), 0), coalesce(sum(outcome IS NULL), 0) FROM ({newest})"
    number, open_acts = connection.execute(query).fetchone()
    return int(number), int(open_acts)
