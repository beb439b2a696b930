"""Bootstrap replicates as weights: how often each image counts, drawn over images or over specimens.

Sound and defective units are drawn separately, so that a replicate keeps both classes; presses of one specimen
move together, because they are not independent evidence.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["CONFIDENCE", "image_weights", "interval", "specimen_weights"]

CONFIDENCE = 0.95

Float = NDArray[np.float64]


def image_weights(is_defective: NDArray[np.bool_], replicates: int, rng: np.random.Generator) -> Float:
    """Multiplicities float64 (replicates, images), each image its own unit."""
    return specimen_weights([str(i) for i in range(is_defective.size)], is_defective, replicates, rng)


def specimen_weights(
    specimens: Sequence[str], is_defective: NDArray[np.bool_], replicates: int, rng: np.random.Generator
) -> Float:
    """Multiplicities float64 (replicates, images), all images of a specimen together.

    A specimen with any defective image is drawn among the defective ones, its good images with it.
    """
    names, unit = np.unique(np.asarray(specimens), return_inverse=True)
    if unit.size != is_defective.size:
        raise ValueError(f"each image needs a specimen, found {unit.size} for {is_defective.size} images")
    unit_is_defective = np.zeros(names.size, np.bool_)
    np.logical_or.at(unit_is_defective, unit, is_defective)
    weights = np.zeros((replicates, names.size))
    for stratum in (np.flatnonzero(~unit_is_defective), np.flatnonzero(unit_is_defective)):
        if stratum.size:
            even = np.full(stratum.size, 1.0 / stratum.size)
            weights[:, stratum] = rng.multinomial(stratum.size, even, size=replicates)
    return weights[:, unit]


def interval(values: Float, confidence: float = CONFIDENCE) -> tuple[float, float] | None:
    """The percentile interval of the replicates that are defined; None when fewer than half are."""
    defined = values[np.isfinite(values)]
    if defined.size * 2 < values.size or not defined.size:
        return None
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(defined, [tail, 100.0 - tail])
    return float(low), float(high)
