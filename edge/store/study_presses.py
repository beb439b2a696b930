"""The tables of gauge studies: the plan of each, and its presses. They count on the gel, as all do.

Functions that take a connection run inside the caller's transaction.
"""

import sqlite3
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Final

from edge.core.press import StudyLabel
from edge.store import ledger_chain
from edge.store.database import insert, open_read_only
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import PressRecord

__all__ = ["StudyPress", "StudyTable", "begin_study", "of_study", "read_study", "studies", "void"]

_COLUMNS: Final = (
    "press_id, time_ns, serial, gel_id, part, position, bundle_id, step, piece, operator, repeat, verdict, reason, "
    "score, threshold, is_void"
)


@dataclass(frozen=True)
class StudyPress:
    """One press of a study."""

    press_id: str
    time_ns: int
    serial: str
    gel_id: str
    part: str
    position: str
    bundle_id: str
    step: int
    """Its place in the plan."""
    piece: str
    operator: str
    repeat: int
    verdict: str
    """Pass, fail, unsure, rejected or error."""
    reason: str | None = None
    """Why it is one of the last two."""
    score: float | None = None
    threshold: float | None = None
    is_void: bool = False
    """It was pressed again, and does not count."""


@dataclass(frozen=True)
class StudyTable:
    """A press of this step of this study, as `PressTable`."""

    label: StudyLabel
    bundle_id: str
    reason: str | None
    name: ClassVar = "study_presses"
    has_picture: ClassVar = False

    def insert(
        self, connection: sqlite3.Connection, press: PressRecord, gel: GelRecord, running_ns: int
    ) -> int:
        row = {"gel_id": gel.gel_id, "running_ns": running_ns, "position": press.position or ""}
        row |= {**vars(self.label), "bundle_id": self.bundle_id, "reason": self.reason}
        names = ("press_id", "time_ns", "serial", "part", "verdict", "score", "threshold")
        return insert(connection, "study_presses", {**row, **{name: getattr(press, name) for name in names}})

    def publish(self, *_: object) -> tuple[tuple[()], tuple[()]]:
        """Publish nothing: who presses must not see it."""
        return (), ()


def begin_study(connection: sqlite3.Connection, study_id: str, plan: str, time_ns: int) -> str:
    """Keep the plan of a new study; returns the plan that is kept, which for a known study is its first one."""
    connection.execute("INSERT OR IGNORE INTO studies VALUES (?, ?, ?)", (study_id, plan, time_ns))
    kept = plan_of(connection, study_id)
    return plan if kept is None else kept


def plan_of(connection: sqlite3.Connection, study_id: str) -> str | None:
    """Read the plan of a study; None for one that is not in this database."""
    row = connection.execute("SELECT plan FROM studies WHERE study_id = ?", (study_id,)).fetchone()
    return None if row is None else str(row[0])


def of_study(connection: sqlite3.Connection, study_id: str) -> list[StudyPress]:
    """Every press, void ones too, in the order in which they were made."""
    rows = connection.execute(
        f"SELECT {_COLUMNS} FROM study_presses WHERE study_id = ? ORDER BY number", (study_id,)
    )
    return [replace(StudyPress(*row), is_void=bool(row[-1])) for row in rows]


def void(connection: sqlite3.Connection, press_id: str) -> bool:
    """This press does not count; returns whether there is one that counted."""
    row = connection.execute(
        "UPDATE study_presses SET is_void = 1 WHERE press_id = ? AND is_void = 0 RETURNING number",
        (press_id,),
    ).fetchone()
    if row is None:
        return False
    ledger_chain.append(connection, "study", row[0])
    return True


def studies(path: Path) -> list[tuple[str, int, int]]:
    """Each study with when it began and the number of its presses that count, oldest first. Errors: StoreError."""
    with open_read_only(path, "reading the studies") as connection:
        rows = connection.execute(
            "SELECT study_id, started_ns, (SELECT count(*) FROM study_presses AS p WHERE p.study_id = s.study_id AND "
            "NOT is_void) FROM studies AS s ORDER BY started_ns"
        )
        return [(str(study), int(ns), int(number)) for study, ns, number in rows]


def read_study(path: Path, study_id: str) -> tuple[str, list[StudyPress]] | None:
    """The plan and the presses; None for a study that is not there. Errors: StoreError."""
    with open_read_only(path, "reading the studies") as connection:
        plan = plan_of(connection, study_id)
        return None if plan is None else (plan, of_study(connection, study_id))
