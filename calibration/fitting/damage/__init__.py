"""Damage of known size in real presses: the imprint's surface, the damage, the change of the picture."""
