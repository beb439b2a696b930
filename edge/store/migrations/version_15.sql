-- Of the deviation with the highest score, measured after the press was recorded (edge.model.deviations).
ALTER TABLE presses ADD COLUMN depth_mm REAL;
ALTER TABLE presses ADD COLUMN depth_u95_mm REAL;
ALTER TABLE presses ADD COLUMN size_mm REAL;
ALTER TABLE presses ADD COLUMN size_u95_mm REAL;
