"""Reference presses: a master piece pressed at a known time, and the control charts of what it gives."""
