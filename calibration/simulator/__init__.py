"""Simulated presses of a tactile sensor: parts and defects as geometry, effects one by one, exact masks."""
