-- Pieces that are pressed at several places (edge.store.pieces). `places`: the plan, JSON of [part, position] each.
CREATE TABLE pieces (
    number      INTEGER PRIMARY KEY AUTOINCREMENT,
    piece_id    TEXT NOT NULL UNIQUE,
    began_ns    INTEGER NOT NULL,
    places      TEXT NOT NULL,
    place_order TEXT NOT NULL,
    ended_ns    INTEGER,
    ended_by    TEXT,
    verdict     TEXT
) STRICT;
CREATE UNIQUE INDEX one_piece_in_progress ON pieces (ended_ns IS NULL) WHERE ended_ns IS NULL;
ALTER TABLE presses ADD COLUMN piece_id TEXT;
CREATE INDEX presses_of_pieces ON presses (piece_id) WHERE piece_id IS NOT NULL;
