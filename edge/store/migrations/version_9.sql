-- Recorded presses whose picture is not yet in the outbox: it is drawn after the result has left (edge.gateway.pictures).
CREATE TABLE owed_pictures (
    press_id TEXT PRIMARY KEY,
    verdict  TEXT NOT NULL,
    time_ns  INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
