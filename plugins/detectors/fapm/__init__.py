"""FAPM: what can be set (parameters.py), the bank and the graph (fit.py), as published (paper.py)."""

from plugins.detectors.fapm.fit import fapm
from plugins.detectors.fapm.parameters import FapmParameters

__all__ = ["FapmParameters", "fapm"]
