"""Sources of camera frames: the real sensor, the virtual one, and recordings."""
