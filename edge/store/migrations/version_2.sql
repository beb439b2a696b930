-- `running_ns` counts the time that a gateway has run on this database (edge.store.database). Rows of version 1 have
-- no such time, and their age starts with the migration. New columns of `outbox` come after the payload; the queries
-- that need them use an index, so they read no page of a heatmap either.
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
