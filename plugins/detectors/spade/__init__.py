"""SPADE: what can be set (parameters.py), the bank (fit.py), the graph (head.py), as published (paper.py)."""

from plugins.detectors.spade.fit import spade
from plugins.detectors.spade.parameters import SpadeParameters

__all__ = ["SpadeParameters", "spade"]
