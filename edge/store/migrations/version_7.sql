-- `second_of`: the first press of the same piece, where this one was asked for.
ALTER TABLE presses ADD COLUMN second_of TEXT;
