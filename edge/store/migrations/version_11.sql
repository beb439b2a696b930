-- Dropped rows that a person has acknowledged (alarm `outbox_full`); earlier ones were not noted.
ALTER TABLE dropped ADD COLUMN acknowledged INTEGER NOT NULL DEFAULT 0;
ALTER TABLE dropped_by_age ADD COLUMN acknowledged INTEGER NOT NULL DEFAULT 0;
UPDATE dropped SET acknowledged = rows;
UPDATE dropped_by_age SET acknowledged = rows;
