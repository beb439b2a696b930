from plugins.detectors.spade.fit import spade
from plugins.detectors.spade.parameters import SpadeParameters

__all__ = ["SpadeParameters", "spade"]
