-- On which gel each bundle is proven, and the presses of sound parts on gels where it is not (edge.store.gel_proofs).
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
