"""A fit of the smallest detector: its presses and its configuration, each with what a test changes."""

import dataclasses

import tiny

from calibration.fitting.fit import FitConfig
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk


def presses(n: int, **changes: object) -> NominalPresses:
    frames = tiny.presses(n)
    return dataclasses.replace(NominalPresses(frames, tuple(f"press {k}" for k in range(n))), **changes)  # type: ignore[arg-type]


def config(**changes: object) -> FitConfig:
    whole = FitConfig(
        part="bolt",
        position="crest",
        profile=tiny.PROFILE,
        region=tiny.REGION,
        detector=tiny.TINY,
        trunk=Trunk("tiny", tiny.tiny_trunk()),
    )
    return dataclasses.replace(whole, **changes)  # type: ignore[arg-type]
