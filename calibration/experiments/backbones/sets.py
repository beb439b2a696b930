"""The evaluation sets: presses of parts, damage and sensors that training never draws, and real frames.

Every set is a list of trials that any process can make. Simulated ones come from `presses.py`, real pictures from
`pictures.py`, whose folders are not part of the product. `sets.toml` says what each set shows, and what it cannot show.
"""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

from calibration.experiments.backbones.presses import PARTS, development_trial, part_trial
from calibration.experiments.backbones.real_touch import missing_sensors, trials_of
from calibration.experiments.backbones.trial import Trial

__all__ = ["SENSORS", "SETS", "EvaluationSet", "evaluation_sets"]


@dataclass(frozen=True)
class EvaluationSet:
    """Trials whose measures are averaged."""

    title: str
    text: str
    """What they show, and what they cannot show."""
    trials: tuple[Callable[[], Trial], ...]
    is_brief: bool = False
    """Only the first backbone and random weights are compared on it."""
    is_on_request: bool = False
    """It is opened only where it is named."""
    missing: str = ""
    """Why there are no trials, empty when there are some."""

    def __post_init__(self) -> None:
        if bool(self.trials) == bool(self.missing):
            raise ValueError(f"set '{self.title}' has trials or a reason for having none")


_DESCRIPTIONS = tomllib.loads(
    files("calibration.experiments.backbones").joinpath("sets.toml").read_text(encoding="utf-8")
)

SENSORS: Mapping[str, Mapping[str, str]] = {
    name: about.pop("sensors") for name, about in _DESCRIPTIONS.items() if "sensors" in about
}
"""Of each set of real touch, the folder of each sensor with the licence of its frames. No sensor is in two sets."""

SETS = tuple(_DESCRIPTIONS)
"""The names of the sets, in the order of the tables."""

# Three parts are enough for the effects of gel and press.
_FEW = tuple(part for part in PARTS if part in ("PZ1", "PZ4", "PZ5"))


def evaluation_sets(real_tactile: Path | None) -> dict[str, EvaluationSet]:
    """Return every set by its name in `SETS`. real_tactile: the folder of real frames, None to omit their sets."""
    no_frames = _missing(real_tactile)
    missing = {}
    trials: dict[str, Sequence[Callable[[], Trial]]] = {
        "random-parts": [partial(development_trial, number) for number in range(6)],
        "parts": [partial(part_trial, part) for part in PARTS],
        "sensor": [partial(part_trial, part, "unseen sensor") for part in PARTS],
        "worn-gel": [partial(part_trial, part, "worn gel") for part in _FEW],
        "marker-gel": [partial(part_trial, part, "marker gel") for part in _FEW],
        "residual-imprint": [partial(part_trial, part, "residual imprint") for part in _FEW],
        "sliding-press": [partial(part_trial, part, "sliding press") for part in _FEW],
    }
    for name, sensors in SENSORS.items():
        missing[name] = no_frames
        if real_tactile is not None and not no_frames:
            missing[name] = missing_sensors(real_tactile, list(sensors))
            trials[name] = [] if missing[name] else trials_of(real_tactile, list(sensors))
    return {
        name: EvaluationSet(**about, trials=tuple(trials.get(name, ())), missing=missing.get(name, ""))
        for name, about in _DESCRIPTIONS.items()
    }


def _missing(folder: Path | None) -> str:
    if folder is None:
        return "no folder of real tactile frames was given (--tactile)"
    return "" if folder.is_dir() else "the folder of real tactile frames given with --tactile does not exist"
