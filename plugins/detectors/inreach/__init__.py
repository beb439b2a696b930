from plugins.detectors.inreach.fit import inreach
from plugins.detectors.inreach.parameters import InreachParameters

__all__ = ["InreachParameters", "inreach"]
