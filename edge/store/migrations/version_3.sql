-- The newest bundle in use for each position of each part, and the position that is selected.
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
