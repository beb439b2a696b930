from plugins.detectors.padim.fit import padim
from plugins.detectors.padim.parameters import PadimParameters

__all__ = ["PadimParameters", "padim"]
