"""Score maps in colour, and the published picture of a press."""
