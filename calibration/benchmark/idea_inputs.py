"""Another input for an idea of `idea_ablation`: the difference of each frame to its sensor's free gel.

A gateway would need a picture of the free gel of its own sensor and region, in the graph or as a further input of it.
`plugins.backbones.input_steps` has the first.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.trial import Trial
from edge.core.errors import DatasetError

__all__ = ["LEVEL", "of_differences"]

U8 = NDArray[np.uint8]

LEVEL = 128.0
"""Grey level of no difference."""

# Of the free gel's picture, in pixels: its light, without noise, dirt and dots, as a calibration stores it.
_LIGHT_PX = 8.0


def of_differences(trial: Trial) -> Trial:
    """The trial with every frame as its difference to the free gel. Errors: DatasetError without free gels."""
    nominal = trial.nominal
    if nominal.no_contact is None:
        raise DatasetError(f"{trial.name}: no free gel to take a difference to; record it with the presses")
    mean = nominal.no_contact.mean(axis=0)
    learnt = trial.learnt_free if trial.learnt_free is not None else [mean] * len(nominal.frames)
    scored = trial.scored_free if trial.scored_free is not None else [mean] * len(trial.frames)
    return replace(
        trial,
        nominal=replace(nominal, frames=_differences(nominal.frames, learnt)),
        frames=_differences(trial.frames, scored),
    )


def _differences(frames: U8, free: "list[NDArray[np.floating]] | U8") -> U8:
    found = [
        LEVEL + rgb - cv2.GaussianBlur(np.asarray(gel, np.float32), (0, 0), _LIGHT_PX)
        for rgb, gel in zip(frames, free, strict=True)
    ]
    return np.clip(np.rint(found), 0, 255).astype(np.uint8)
