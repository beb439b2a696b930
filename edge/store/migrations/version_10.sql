-- `shadow`: what a bundle that decides nothing says of the press (edge.core.shadow). `instead_of`: the configured bundle
-- whose place the one in use has taken.
ALTER TABLE presses ADD COLUMN shadow TEXT;
ALTER TABLE bundles_in_use ADD COLUMN instead_of TEXT;
