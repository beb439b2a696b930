"""InReaCh: what can be set (parameters.py), bank and graph (fit.py), as published (paper.py)."""

from plugins.detectors.inreach.fit import inreach
from plugins.detectors.inreach.parameters import InreachParameters

__all__ = ["InreachParameters", "inreach"]
