"""PaDiM: what can be set (parameters.py), the bank and the graph (fit.py), as published (paper.py)."""

from plugins.detectors.padim.fit import padim
from plugins.detectors.padim.parameters import PadimParameters

__all__ = ["PadimParameters", "padim"]
