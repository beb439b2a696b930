"""The gel ledger: which gel is on which sensor, and how often it was pressed. Runs inside the caller's transaction.

A sensor seen for the first time gets the gel `<serial>-1`. A replacement is recorded, and the row of the old gel stays
as history. A row is one mounting: a gel that is mounted again, by its own serial, gets a new row, whose count goes on.
"""

import sqlite3
from dataclasses import dataclass, replace
from datetime import date
from typing import Final

from edge.core.errors import StoreError
from edge.core.gel_life import DEFAULT_WARN_FRACTION, LONGEST_ID, GelLabel, GelState, is_past, state_of
from edge.core.sentence import Sentence
from edge.store import ledger_chain

__all__ = ["RESTORED", "GelRecord", "add_presses", "count_press", "find_mounted", "history", "mount"]

RESTORED: Final = "restored from the second record"
"""The note of a gel that a lost database does not know any more (`edge.store.press_counts`)."""

_COLUMNS = (
    "serial, gel_id, presses, limit_presses, installed_ns, first_use_ns, last_use_ns, removed_ns, wear_index, "
    "note, gel_serial, gel_type, use_by, presses_before"
)


@dataclass(frozen=True)
class GelRecord:
    """One gel on one sensor, as in the ledger. Times are wall-clock nanoseconds."""

    serial: str
    """The sensor's."""
    gel_id: str
    presses: int
    """Contacts so far."""
    limit_presses: int
    """Contacts that are allowed."""
    warn_fraction: float
    """The share of the allowed contacts at which the gel is due."""
    installed_ns: int
    first_use_ns: int | None = None
    """None before the first press, as for the last use."""
    last_use_ns: int | None = None
    removed_ns: int | None = None
    """None while the gel is mounted."""
    wear_index: float | None = None
    """Optical wear of the untouched gel: 0 when new, 1 when it should be replaced; None if never measured."""
    note: str = ""
    """By the person who mounted it."""
    gel_serial: str | None = None
    """The gel's own; None where nobody wrote it down, as for its type and its last day of use."""
    gel_type: str | None = None
    use_by: str | None = None
    """YYYY-MM-DD."""
    presses_before: int | None = None
    """Its presses when it was mounted again; None for a gel that the ledger did not know."""

    @property
    def can_be(self) -> bool:
        """True for a count of presses; a row that was changed by hand may hold another number."""
        return self.presses >= 0 and self.limit_presses >= 1

    @property
    def state(self) -> GelState:
        """The state of its press count, or `replace` when it is optically worn or its count cannot be."""
        if (self.wear_index or 0.0) >= 1.0 or not self.can_be:
            return GelState.REPLACE
        return state_of(self.presses, self.limit_presses, self.warn_fraction)

    @property
    def facts(self) -> dict[str, str | int]:
        """Which gel it is and its count, for the table of acts."""
        return {"gel_id": self.gel_id, "presses": self.presses, "limit_presses": self.limit_presses}

    def list_remarks(self, today: date) -> list[Sentence]:
        """List what a person who mounts it must know, a sentence each."""
        remarks = []
        if is_past(self.use_by, today):
            remarks.append(
                Sentence(f"gel {self.gel_id} is past its use-by date {self.use_by}: mount another one")
            )
        if self.presses_before is not None:
            remarks.append(
                Sentence(
                    f"gel serial '{self.gel_serial}' was mounted before: its count goes on from {self.presses_before} "
                    f"of {self.limit_presses} presses"
                )
            )
        return remarks


def find_mounted(connection: sqlite3.Connection, serial: str, warn_fraction: float) -> GelRecord | None:
    """Find the gel mounted on this sensor; None for an unknown sensor. Errors: StoreError for an impossible count."""
    row = connection.execute(
        f"SELECT {_COLUMNS} FROM gels WHERE serial = ? AND removed_ns IS NULL", (serial,)
    ).fetchone()
    return None if row is None else _refuse_impossible(_record(row, warn_fraction))


def _refuse_impossible(gel: GelRecord) -> GelRecord:
    if not gel.can_be:
        raise StoreError(
            f"gel {gel.gel_id} of sensor {gel.serial} has {gel.presses} of {gel.limit_presses} presses in the ledger, "
            "which no gelgate writes; mount a new gel with `gelgate gel replace`, or bring back a copy of the database"
        )
    return gel


def history(connection: sqlite3.Connection, serial: str | None, warn_fraction: float) -> list[GelRecord]:
    """Every gel of this sensor, or of all sensors, oldest first."""
    rows = connection.execute(
        f"SELECT {_COLUMNS} FROM gels WHERE ? IS NULL OR serial = ? ORDER BY serial, rowid", (serial, serial)
    )
    return [_record(row, warn_fraction) for row in rows]


def mount(
    connection: sqlite3.Connection,
    serial: str,
    gel_id: str | None,
    limit_presses: int | None,
    usual_limit: int,
    note: str,
    time_ns: int,
    label: GelLabel,
) -> None:
    """Replace the mounted gel by this one. `gel_id` None gives it a number.

    A gel whose own serial the ledger knows goes on from its count and wear, and what was known of it holds unless it
    is said anew. Wear is measured from a new first picture then, so it adds up.

    Errors: StoreError if this sensor has had a gel of that id: the count would then be of two gels; for an id or a note
    with control characters; for a gel that is on another sensor.
    """
    for what, text in (("gel id", gel_id or ""), ("note", note)):
        if not text.isprintable():
            raise StoreError(f"the {what} {text!r} holds control characters; use letters, digits and signs")
    if len(gel_id or "") > LONGEST_ID:
        raise StoreError(f"the gel id '{gel_id:.20}...' is too long; use at most {LONGEST_ID} characters")
    ids = {row[0] for row in connection.execute("SELECT gel_id FROM gels WHERE serial = ?", (serial,))}
    # After the highest one: of a database that was lost only the mounted gel is known, and those before it had ids too.
    numbers = (name.removeprefix(f"{serial}-") for name in ids if name.startswith(f"{serial}-"))
    newest = max((int(number) for number in numbers if number.isdecimal()), default=0)
    gel_id = gel_id or f"{serial}-{newest + 1}"
    if gel_id in ids:
        raise StoreError(
            f"gel '{gel_id}' was already used on sensor {serial}; give the new gel another id, or none"
        )
    connection.execute(
        "UPDATE gels SET removed_ns = ? WHERE serial = ? AND removed_ns IS NULL", (time_ns, serial)
    )
    known = _find_known(connection, serial, label.gel_serial)
    limit, gel_type, use_by, presses, wear = known or (usual_limit, None, None, None, None)
    connection.execute(
        "INSERT INTO gels (serial, gel_id, presses, limit_presses, installed_ns, wear_index, note, gel_serial, "
        "gel_type, use_by, presses_before, wear_before) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (
            *(serial, gel_id, presses or 0, limit_presses or limit, time_ns, wear, note, label.gel_serial),
            *(label.gel_type or gel_type, label.use_by or use_by, presses, wear),
        ),
    )
    ledger_chain.append_gels(connection, serial)


def _find_known(
    connection: sqlite3.Connection, serial: str, gel_serial: str | None
) -> tuple[int, str | None, str | None, int, float | None] | None:
    """Find limit, type, last day, presses and wear of the gel with this serial; None for one that is not known.
    Errors: StoreError for a gel that is on another sensor."""
    of = "FROM gels WHERE gel_serial = ? COLLATE NOCASE"
    there = connection.execute(
        f"SELECT serial, gel_id {of} AND removed_ns IS NULL AND serial <> ?", (gel_serial, serial)
    ).fetchone()
    if there is not None:
        raise StoreError(
            Sentence(
                f"gel serial '{gel_serial}' is on sensor {there[0]}, as its gel {there[1]}; correct the serial, or "
                f"record first which gel that sensor has now (`gelgate gel replace --serial {there[0]}`)"
            )
        )
    known: tuple[int, str | None, str | None, int, float | None] | None = connection.execute(
        f"SELECT limit_presses, gel_type, use_by, presses, wear_index {of} ORDER BY presses DESC, rowid DESC LIMIT 1",
        (gel_serial,),
    ).fetchone()
    return known


def add_presses(
    connection: sqlite3.Connection,
    serial: str,
    time_ns: int,
    presses: int,
    wear_index: float | None = None,
    warn_fraction: float = DEFAULT_WARN_FRACTION,
) -> GelRecord | None:
    """Add presses to the mounted gel, and return it; None for an unknown sensor.

    wear_index: its optical wear, None where it was not measured. The last use never becomes earlier, also when the
    clock is set back.
    """
    row = connection.execute(
        "UPDATE gels SET presses = presses + :presses, first_use_ns = coalesce(first_use_ns, :t), "
        "last_use_ns = max(coalesce(last_use_ns, :t), :t), "
        "wear_index = coalesce(:wear + coalesce(wear_before, 0), wear_index) "
        f"WHERE serial = :serial AND removed_ns IS NULL RETURNING {_COLUMNS}",
        {"t": time_ns, "serial": serial, "presses": presses, "wear": wear_index},
    ).fetchone()
    return None if row is None else _record(row, warn_fraction)


def count_press(
    connection: sqlite3.Connection, serial: str, time_ns: int, wear_index: float | None, warn_fraction: float
) -> GelRecord | None:
    """Add one press, as `add_presses` does. Errors: StoreError for an impossible count."""
    gel = add_presses(connection, serial, time_ns, 1, wear_index, warn_fraction)
    if gel is not None:
        _refuse_impossible(replace(gel, presses=gel.presses - 1))
    return gel


def _record(row: tuple[object, ...], warn_fraction: float) -> GelRecord:
    values = dict(zip(_COLUMNS.split(", "), row, strict=True))
    return GelRecord(**values, warn_fraction=warn_fraction)  # type: ignore[arg-type]  # STRICT tables keep the types
