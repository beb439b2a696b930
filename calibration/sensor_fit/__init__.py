"""The simulator fitted to a real sensor: its colours, gel and noise, from presses of a ball of known radius."""
