"""By how much the variants of an ablation differ, and how far that is chance: least squares over variants and seeds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.studies.intervals import t_quantile

__all__ = ["LEAST_WORTH", "Worth", "differences"]

LEAST_WORTH = 0.02
"""In AU-PRO up to 1 % false alarms; a smaller worth is not looked for."""


@dataclass(frozen=True)
class Worth:
    """What a variant gains, in AU-PRO, below 0 where it loses. noise: half the width of the 95 % interval."""

    value: float
    noise: float

    @property
    def pays(self) -> bool:
        return self.value > self.noise

    @property
    def harms(self) -> bool:
        return self.value < -self.noise

    @property
    def is_small(self) -> bool:
        """Shown to be below `LEAST_WORTH`."""
        return self.value + self.noise < LEAST_WORTH

    def __str__(self) -> str:
        return f"{round(self.value, 3) + 0.0:+.3f} ± {self.noise:.3f}"


def differences(values: Sequence[tuple[str, int, float]], others: Sequence[str]) -> dict[str, Worth]:
    """What each of the others gains over the reference, which is every further variant among the values.

    values: variant, seed and value of each trunk. Two-way analysis of variance: a value is the sum of what its variant
    and its seed give it, for trunks of one seed have equal first weights and batches. What remains is the noise.
    Needs more values than variants and seeds.
    """
    seeds = sorted({seed for _, seed, _ in values})
    design = np.array(
        [
            [*(variant == name for name in others), *(seed == one for one in seeds)]
            for variant, seed, _ in values
        ],
        np.float64,
    )
    measured = np.array([value for *_, value in values])
    inverse = np.linalg.pinv(design)
    found = inverse @ measured
    freedom = len(measured) - design.shape[1]
    deviation = math.sqrt(float(((measured - design @ found) ** 2).sum()) / freedom)
    noises = t_quantile(freedom) * deviation * np.sqrt((inverse**2).sum(axis=1))
    return {
        name: Worth(float(value), float(noise))
        for name, value, noise in zip(others, found, noises, strict=False)
    }
