-- Why a press is not passed: part, gel or unsure. Presses of earlier versions have no cause.
ALTER TABLE presses ADD COLUMN cause TEXT;
