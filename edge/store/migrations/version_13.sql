-- What the package of a gel says, as far as a person wrote it down, and the count and wear from which a gel goes on that is
-- mounted again.
ALTER TABLE gels ADD COLUMN gel_serial TEXT;
ALTER TABLE gels ADD COLUMN gel_type TEXT;
ALTER TABLE gels ADD COLUMN use_by TEXT;
ALTER TABLE gels ADD COLUMN presses_before INTEGER;
ALTER TABLE gels ADD COLUMN wear_before REAL;
