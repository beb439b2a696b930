from plugins.detectors.fapm.fit import fapm
from plugins.detectors.fapm.parameters import FapmParameters

__all__ = ["FapmParameters", "fapm"]
