"""InReaCh: what can be set (parameters.py), the bank (fit.py), the graph (head.py), as published (paper.py)."""

from plugins.detectors.inreach.fit import inreach
from plugins.detectors.inreach.parameters import InreachParameters

__all__ = ["InreachParameters", "inreach"]
