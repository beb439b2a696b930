"""The tables of the database, as the scripts that make each version from the one before.

A new file runs all of them, so it has the same tables as one that was migrated. A migration adds; it removes no row.
A new column of a table that is chained (edge.store.ledger_chain) is NULL in the rows that are there.
"""

from typing import Final

__all__ = ["CHAINED_SINCE", "MIGRATIONS", "SCHEMA_VERSION"]

_VERSION_1: Final = """
CREATE TABLE gels (
    serial        TEXT NOT NULL,
    gel_id        TEXT NOT NULL,
    presses       INTEGER NOT NULL DEFAULT 0,
    limit_presses INTEGER NOT NULL,
    installed_ns  INTEGER NOT NULL,
    removed_ns    INTEGER,
    first_use_ns  INTEGER,
    last_use_ns   INTEGER,
    wear_index    REAL,
    note          TEXT NOT NULL,
    PRIMARY KEY (serial, gel_id)
) STRICT;
CREATE UNIQUE INDEX one_mounted_gel ON gels (serial) WHERE removed_ns IS NULL;

CREATE TABLE presses (
    number    INTEGER PRIMARY KEY AUTOINCREMENT,
    press_id  TEXT NOT NULL UNIQUE,
    time_ns   INTEGER NOT NULL,
    serial    TEXT NOT NULL,
    gel_id    TEXT NOT NULL,
    part      TEXT NOT NULL,
    position  TEXT,
    verdict   TEXT NOT NULL,
    score     REAL,
    threshold REAL
) STRICT;

-- The payload is the last column: reading the other columns then reads no page of a heatmap.
CREATE TABLE outbox (
    row_id       INTEGER PRIMARY KEY AUTOINCREMENT,
    worth        INTEGER NOT NULL,
    created_ns   INTEGER NOT NULL,
    bytes        INTEGER NOT NULL,
    topic        TEXT NOT NULL,
    qos          INTEGER NOT NULL,
    retain       INTEGER NOT NULL,
    content_type TEXT NOT NULL,
    expiry_s     INTEGER,
    payload      BLOB NOT NULL
) STRICT;
CREATE INDEX outbox_by_worth ON outbox (worth, row_id);
CREATE INDEX outbox_by_age ON outbox (created_ns);
CREATE INDEX outbox_retained ON outbox (topic) WHERE retain = 1;

-- One line per row and sink that acknowledged it (`refusal` is NULL) or refused it.
CREATE TABLE settled (
    row_id  INTEGER NOT NULL,
    sink    TEXT NOT NULL,
    refusal TEXT,
    PRIMARY KEY (row_id, sink)
) STRICT, WITHOUT ROWID;
CREATE TABLE sinks (name TEXT PRIMARY KEY) STRICT, WITHOUT ROWID;
CREATE TABLE dropped (worth INTEGER PRIMARY KEY, rows INTEGER NOT NULL, bytes INTEGER NOT NULL) STRICT;

CREATE TABLE outbox_size (
    one INTEGER PRIMARY KEY CHECK (one = 1), rows INTEGER NOT NULL, bytes INTEGER NOT NULL
) STRICT;
INSERT INTO outbox_size VALUES (1, 0, 0);
CREATE TRIGGER outbox_grows AFTER INSERT ON outbox BEGIN
    UPDATE outbox_size SET rows = rows + 1, bytes = bytes + NEW.bytes;
END;
CREATE TRIGGER outbox_shrinks AFTER DELETE ON outbox BEGIN
    UPDATE outbox_size SET rows = rows - 1, bytes = bytes - OLD.bytes;
    DELETE FROM settled WHERE row_id = OLD.row_id;
END;
"""

# `running_ns` counts the time that a gateway has run on this database (edge.store.running_time). Rows of version 1 have
# no such time, and their age starts with the migration. New columns of `outbox` come after the payload; the queries
# that need them use an index, so they read no page of a heatmap either.
_VERSION_2: Final = """
CREATE TABLE running (
    one INTEGER PRIMARY KEY CHECK (one = 1), running_ns INTEGER NOT NULL
) STRICT;
INSERT INTO running VALUES (1, 0);
ALTER TABLE outbox ADD COLUMN running_ns INTEGER NOT NULL DEFAULT 0;
DROP INDEX outbox_by_age;
CREATE INDEX outbox_by_age ON outbox (running_ns, worth);
ALTER TABLE presses ADD COLUMN running_ns INTEGER;
CREATE TABLE dropped_by_age (worth INTEGER PRIMARY KEY, rows INTEGER NOT NULL, bytes INTEGER NOT NULL) STRICT;

-- Every request and its outcome. `outcome` is NULL while it is being done: after a power cut such a row remains.
CREATE TABLE acts (
    act_id      INTEGER PRIMARY KEY AUTOINCREMENT,
    time_ns     INTEGER NOT NULL,
    running_ns  INTEGER NOT NULL,
    who         TEXT NOT NULL,
    verb        TEXT NOT NULL,
    request     TEXT,
    arguments   TEXT NOT NULL,
    signature   TEXT,
    outcome     TEXT,
    sentence    TEXT,
    before      TEXT,
    after       TEXT
) STRICT;
CREATE INDEX acts_by_request ON acts (verb, request, running_ns);
CREATE INDEX acts_refused ON acts (act_id) WHERE outcome = 'refused';
CREATE UNIQUE INDEX acts_by_signature ON acts (signature) WHERE signature IS NOT NULL;
"""

# The newest bundle in use for each position of each part, and the position that is selected.
_VERSION_3: Final = """
CREATE TABLE bundles_in_use (
    part      TEXT NOT NULL,
    position  TEXT NOT NULL,
    revision  INTEGER,
    bundle_id TEXT NOT NULL,
    time_ns   INTEGER NOT NULL,
    PRIMARY KEY (part, position)
) STRICT, WITHOUT ROWID;
CREATE TABLE selected (
    one INTEGER PRIMARY KEY CHECK (one = 1), part TEXT NOT NULL, position TEXT NOT NULL
) STRICT;
"""

# Presses of master pieces and of gauge studies. They count on the gel, and are not in the history of parts.
_VERSION_4: Final = """
CREATE TABLE reference_presses (
    number          INTEGER PRIMARY KEY AUTOINCREMENT,
    press_id        TEXT NOT NULL UNIQUE,
    time_ns         INTEGER NOT NULL,
    running_ns      INTEGER NOT NULL,
    serial          TEXT NOT NULL,
    gel_id          TEXT NOT NULL,
    part            TEXT NOT NULL,
    position        TEXT NOT NULL,
    bundle_id       TEXT NOT NULL,
    piece           TEXT NOT NULL,
    expected        TEXT NOT NULL,
    verdict         TEXT NOT NULL,
    reason          TEXT,
    score           REAL,
    threshold       REAL,
    strength_levels REAL,
    x_mm            REAL,
    y_mm            REAL,
    turn_deg        REAL,
    noise_levels    REAL,
    is_start        INTEGER NOT NULL
) STRICT;
CREATE INDEX reference_presses_by_piece ON reference_presses (serial, part, position, piece, number);
-- A reference press that the command line asks for, until the gateway has taken it.
CREATE TABLE reference_request (
    one      INTEGER PRIMARY KEY CHECK (one = 1),
    request  TEXT NOT NULL,
    who      TEXT NOT NULL,
    piece    TEXT,
    is_start INTEGER NOT NULL,
    time_ns  INTEGER NOT NULL
) STRICT;

CREATE TABLE studies (
    study_id   TEXT PRIMARY KEY,
    plan       TEXT NOT NULL,
    started_ns INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
-- `is_void`: pressed again. Such a row stays, as the press did.
CREATE TABLE study_presses (
    number     INTEGER PRIMARY KEY AUTOINCREMENT,
    press_id   TEXT NOT NULL UNIQUE,
    time_ns    INTEGER NOT NULL,
    running_ns INTEGER NOT NULL,
    serial     TEXT NOT NULL,
    gel_id     TEXT NOT NULL,
    part       TEXT NOT NULL,
    position   TEXT NOT NULL,
    bundle_id  TEXT NOT NULL,
    study_id   TEXT NOT NULL,
    step       INTEGER NOT NULL,
    piece      TEXT NOT NULL,
    operator   TEXT NOT NULL,
    repeat     INTEGER NOT NULL,
    verdict    TEXT NOT NULL,
    reason     TEXT,
    score      REAL,
    threshold  REAL,
    is_void    INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE INDEX study_presses_by_study ON study_presses (study_id, number);
"""

# Why a press is not passed: part, gel or unsure. Presses of earlier versions have no cause.
_VERSION_5: Final = """
ALTER TABLE presses ADD COLUMN cause TEXT;
"""

# The ledger chained by hash (edge.store.ledger_chain): a link for every row written, and where the chain starts.
# `gel_presses` is the count of the gel with this press, `evidence` the SHA-256 of its record in the archive.
_VERSION_6: Final = """
CREATE TABLE ledger_chain (
    link    INTEGER PRIMARY KEY AUTOINCREMENT,
    kind    TEXT NOT NULL,
    ref     ANY NOT NULL,
    content BLOB NOT NULL,
    hash    BLOB NOT NULL
) STRICT;
CREATE INDEX ledger_of_gels ON ledger_chain (ref) WHERE kind = 'gel';
CREATE TABLE ledger_start (
    one                INTEGER PRIMARY KEY CHECK (one = 1),
    ledger_id          TEXT NOT NULL,
    presses_up_to      INTEGER NOT NULL,
    acts_up_to         INTEGER NOT NULL,
    acts_removed_up_to INTEGER NOT NULL,
    link               INTEGER NOT NULL,
    hash               BLOB NOT NULL
) STRICT;
ALTER TABLE presses ADD COLUMN gel_presses INTEGER;
ALTER TABLE presses ADD COLUMN evidence BLOB;
"""

# `second_of`: the first press of the same piece, where this one was asked for.
_VERSION_7: Final = """
ALTER TABLE presses ADD COLUMN second_of TEXT;
"""

# On which gel each bundle is proven, and the presses of sound parts on gels where it is not (edge.store.gel_proofs).
_VERSION_8: Final = """
CREATE TABLE gel_proofs (
    serial     TEXT NOT NULL,
    gel_id     TEXT NOT NULL,
    bundle_id  TEXT NOT NULL,
    part       TEXT NOT NULL,
    position   TEXT NOT NULL,
    proven     TEXT,
    known_from TEXT NOT NULL,
    presses    INTEGER NOT NULL DEFAULT 0,
    alarms     INTEGER NOT NULL DEFAULT 0,
    time_ns    INTEGER NOT NULL,
    PRIMARY KEY (serial, gel_id, bundle_id)
) STRICT, WITHOUT ROWID;
"""

MIGRATIONS: Final = (
    _VERSION_1,
    _VERSION_2,
    _VERSION_3,
    _VERSION_4,
    _VERSION_5,
    _VERSION_6,
    _VERSION_7,
    _VERSION_8,
)
SCHEMA_VERSION: Final = len(MIGRATIONS)

CHAINED_SINCE: Final = 6
"""The first version whose ledger is chained by hash."""
