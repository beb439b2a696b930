-- The ledger chained by hash (edge.store.ledger_chain): a link for every row written, and where the chain starts.
-- `gel_presses` is the count of the gel with this press, `evidence` the SHA-256 of its record in the archive.
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
