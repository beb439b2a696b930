"""The ideas for real touch that `calibration.benchmark.idea_ablation` compares, by their names."""

from collections.abc import Mapping

__all__ = ["BASE", "DIFFERENCE", "IDEAS", "NOT_TRAINED", "PHOTOGRAPH", "PHOTOGRAPH_OF_IT", "RATIO"]

BASE, NOT_TRAINED, PHOTOGRAPH = "base", "random weights", "EfficientNet-Lite0 alone"
DIFFERENCE, PHOTOGRAPH_OF_IT = "difference to the free gel", "EfficientNet-Lite0 alone, of the difference"
IDEAS: Mapping[str, str] = {
    BASE: "every effect but `pose_jitter`",
    "other units": "colours answer to a slope 1 to 1.7 times as strongly",
    "wandering exposure": "the light of two presses differs by up to a fifth",
    "other dots": "marker gels of other pitch (0.6 to 1.5 times), radius (0.5 to 1.4) and offset",
    "real gels": "half of the free gels are real: what a simulated press changes is added to them",
    "real gels and noise": "the same, with noise of the grain of real pictures",
    DIFFERENCE: "the trunk, and EfficientNet-Lite0 where joined, see each frame less its free gel",
    "real pairs": "crops of real presses under other light, noise and compression are pulled together, small bumps in "
    "them pushed apart",
    "real pairs alone": "the same, in place of the losses of simulated pairs; slopes and depth are learnt from those",
    "real pairs, gels and noise": "real pairs, with simulated pairs on real gels and noise",
    "distilled": "a 1x1 convolution reads the features of EfficientNet-Lite0 from the trunk's",
    "next to photographs": "the losses of pairs see the channels of EfficientNet-Lite0 too",
}
"""What a trunk learns otherwise than the base."""

RATIO = 2.0
"""How much more the channels of EfficientNet-Lite0 vary than the tactile ones in a joined trunk."""
