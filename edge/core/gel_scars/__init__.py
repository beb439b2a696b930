"""Gel or part: does what a press shows come from the gel, and which places of a gel are too scarred to be judged."""
