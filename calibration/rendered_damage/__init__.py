"""Damage of known size rendered into real presses: the imprint's surface, the damage, the change of the picture."""
