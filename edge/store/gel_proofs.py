"""The table of bundles on gels: on which gel each bundle is proven, and what its presses there gave.

Functions that take a connection run inside the caller's transaction.
"""

import sqlite3
from contextlib import suppress
from datetime import datetime
from typing import Final, NamedTuple

from edge.core.errors import ArchiveError
from edge.core.gel_proof import GelProof, MadeOn, Proven, first_proof
from edge.core.part_position import PartPosition
from edge.core.person_verdict import settle
from edge.store.gel_ledger import RESTORED
from edge.store.person_verdicts import read_verdicts
from edge.store.press_archive import ArchiveFolder
from edge.store.ulid import new_ulid

__all__ = [
    "GelBundle",
    "count",
    "find",
    "inherit",
    "of_mounted",
    "prove",
    "prove_by_words",
    "see",
    "unproven_gel",
    "unproven_since",
    "used_since",
]


class GelBundle(NamedTuple):
    """One bundle, by its identity, on one gel of one sensor."""

    serial: str
    gel_id: str
    bundle_id: str

    def describe(self, part: PartPosition) -> str:
        """Name the bundle and its part in messages."""
        return f"{part} ({self.bundle_id[:8]})"


# The newest presses before a gel was mounted, among which one that a bundle has judged as the shadow is looked for.
_LOOKED_AT: Final = 10_000

_OF = "serial = ? AND gel_id = ? AND bundle_id = ?"


def find(connection: sqlite3.Connection, key: GelBundle) -> GelProof | None:
    """Find the proof; None for a bundle that was not used on this gel."""
    row = connection.execute(
        f"SELECT proven, known_from, presses, alarms FROM gel_proofs WHERE {_OF}", key
    ).fetchone()
    return None if row is None else _proof(row)


def see(
    connection: sqlite3.Connection, key: GelBundle, part: PartPosition, made: MadeOn, time_ns: int
) -> GelProof:
    """The bundle is in use on this gel: what is known of it there, written down at the first time."""
    known = find(connection, key)
    if known is not None:
        return known
    proof = first_proof(made, key.gel_id, *_used_before(connection, key))
    connection.execute(
        "INSERT INTO gel_proofs (serial, gel_id, bundle_id, part, position, proven, known_from, time_ns) "
        "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        (*key, *part, None if proof.proven is None else proof.proven.value, proof.known_from, time_ns),
    )
    return proof


def inherit(
    connection: sqlite3.Connection, old_id: str, new_id: str, time_ns: int, *, with_presses: bool
) -> None:
    """Take what is known of a bundle on each gel over to a revision of it. with_presses: what its presses there gave,
    too, for one that alarms no more often than it."""
    connection.execute(
        "INSERT OR IGNORE INTO gel_proofs "
        "(serial, gel_id, bundle_id, part, position, proven, known_from, presses, alarms, time_ns) "
        "SELECT serial, gel_id, :new, part, position, CASE WHEN :with OR proven <> :pressed THEN proven END, "
        "known_from, :with * presses, :with * alarms, :time FROM gel_proofs WHERE bundle_id = :old",
        {
            "old": old_id,
            "new": new_id,
            "time": time_ns,
            "with": with_presses,
            "pressed": Proven.PRESSES.value,
        },
    )


def used_since(connection: sqlite3.Connection, key: GelBundle) -> int | None:
    """Find the moment at which the bundle was first used on this gel; None where it was not."""
    row = connection.execute(f"SELECT time_ns FROM gel_proofs WHERE {_OF}", key).fetchone()
    return None if row is None else int(row[0])


def unproven_since(connection: sqlite3.Connection, key: GelBundle) -> int | None:
    """Find the moment at which the bundle was first used on this gel; None where it is proven, or was not used."""
    row = connection.execute(f"SELECT time_ns FROM gel_proofs WHERE {_OF} AND proven IS NULL", key).fetchone()
    return None if row is None else int(row[0])


def unproven_gel(connection: sqlite3.Connection, bundle_id: str) -> GelBundle | None:
    """Find the mounted gel on which a bundle was used last and is not proven; None where there is none."""
    row = connection.execute(
        "SELECT serial, gel_id, bundle_id FROM gel_proofs JOIN gels USING (serial, gel_id) WHERE bundle_id = ? "
        "AND proven IS NULL AND removed_ns IS NULL ORDER BY time_ns DESC LIMIT 1",
        (bundle_id,),
    ).fetchone()
    return None if row is None else GelBundle(*row)


def count(connection: sqlite3.Connection, key: GelBundle, *, is_alarm: bool) -> None:
    """Count one more press of a sound part; nothing once it is proven."""
    connection.execute(
        f"UPDATE gel_proofs SET presses = presses + 1, alarms = alarms + ? WHERE {_OF} AND proven IS NULL",
        (int(is_alarm), *key),
    )


def prove(connection: sqlite3.Connection, key: GelBundle, part: PartPosition) -> GelProof:
    """Take a person's word that all presses on this gel were of sound parts, and prove the bundle if they are enough.

    Errors: ValueError with what is missing.
    """
    proof = find(connection, key)
    if proof is None:
        raise ValueError(
            f"bundle {key.describe(part)} was not used on gel {key.gel_id} yet; press sound parts first"
        )
    if proof.proven is not None:
        raise ValueError(
            f"bundle {key.describe(part)} is proven on gel {key.gel_id} already: {proof.proven.value}"
        )
    if proof.still_needed:
        raise ValueError(str(proof.unproven(key.describe(part), key.gel_id)))
    connection.execute(f"UPDATE gel_proofs SET proven = ? WHERE {_OF}", (Proven.PRESSES.value, *key))
    return GelProof(Proven.PRESSES, proof.known_from, proof.presses, proof.alarms)


def prove_by_words(connection: sqlite3.Connection, key: GelBundle, archive: ArchiveFolder) -> GelProof | None:
    """Prove the bundle by the presses of this gel that people called good, if these are enough; None where not.

    Only the archive tells which bundle judged a press, so what is gone from there does not count.
    """
    row = connection.execute(
        f"SELECT time_ns, known_from FROM gel_proofs WHERE {_OF} AND proven IS NULL", key
    ).fetchone()
    if row is None:
        return None
    presses = alarms = 0
    for press_id, verdicts in read_verdicts(connection, since_ns=row[0]).items():
        settled = settle(verdicts)
        press = connection.execute(
            "SELECT verdict, evidence FROM presses WHERE press_id = ? AND serial = ? AND gel_id = ?",
            (press_id, key.serial, key.gel_id),
        ).fetchone()
        if press is None or settled is None or settled.saying not in ("good", "gel"):
            continue
        with suppress(ArchiveError):
            if archive.press(press_id, press[1]).bundle_id == key.bundle_id:
                presses, alarms = presses + 1, alarms + (press[0] != "pass")
    proof = GelProof(Proven.PRESSES, row[1], presses, alarms)
    if proof.still_needed:
        return None
    change = f"UPDATE gel_proofs SET proven = ?, presses = ?, alarms = ? WHERE {_OF}"
    connection.execute(change, (Proven.PRESSES.value, presses, alarms, *key))
    return proof


def of_mounted(connection: sqlite3.Connection) -> list[tuple[GelBundle, PartPosition, GelProof]]:
    """List every bundle that was used on a gel that is mounted now, less those that another one has replaced."""
    rows = connection.execute(
        "SELECT serial, gel_id, gel_proofs.bundle_id, part, position, proven, known_from, gel_proofs.presses, alarms "
        "FROM gel_proofs JOIN gels USING (serial, gel_id) LEFT JOIN bundles_in_use AS used USING (part, position) "
        "WHERE removed_ns IS NULL AND coalesce(used.bundle_id, gel_proofs.bundle_id) = gel_proofs.bundle_id "
        "ORDER BY serial, part, position"
    )
    return [(GelBundle(*row[:3]), PartPosition(*row[3:5]), _proof(row[5:])) for row in rows]


def _used_before(connection: sqlite3.Connection, key: GelBundle) -> tuple[str | None, str | None, bool, bool]:
    """Read `mounted`, `used_on`, `was_in_use` and `is_restored` of `first_proof`."""
    installed_ns, note, is_first = connection.execute(
        "SELECT installed_ns, note, NOT EXISTS (SELECT 1 FROM gels AS old WHERE old.serial = gels.serial AND "
        "old.removed_ns IS NOT NULL) FROM gels WHERE serial = ? AND gel_id = ?",
        (key.serial, key.gel_id),
    ).fetchone()
    used_on = connection.execute(
        "SELECT gel_id FROM gel_proofs LEFT JOIN gels USING (serial, gel_id) WHERE serial = ? AND bundle_id = ? "
        "ORDER BY gels.rowid DESC LIMIT 1",
        (key.serial, key.bundle_id),
    ).fetchone()
    was_in_use = connection.execute(
        "SELECT 1 FROM bundles_in_use WHERE bundle_id = ? AND time_ns < ? UNION ALL SELECT 1 FROM ("
        "SELECT shadow FROM presses WHERE press_id < ? ORDER BY press_id DESC LIMIT ?) "
        "WHERE json_extract(shadow, '$.bundle_id') = ? LIMIT 1",
        (key.bundle_id, installed_ns, new_ulid(installed_ns, bytes), _LOOKED_AT, key.bundle_id),
    ).fetchone()
    mounted = None if is_first else f"{datetime.fromtimestamp(installed_ns / 1e9):%Y-%m-%d}"
    is_used = was_in_use is not None and not is_first
    return mounted, None if used_on is None else str(used_on[0]), is_used, note == RESTORED


def _proof(row: tuple[str | None, str, int, int]) -> GelProof:
    proven, known_from, presses, alarms = row
    return GelProof(None if proven is None else Proven(proven), known_from, presses, alarms)
