"""Probability of detection: damage of known size rendered into the station's own nominal presses, and what is found."""
