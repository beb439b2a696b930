-- Presses of master pieces and of gauge studies. They count on the gel, and are not in the history of parts.
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
