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
