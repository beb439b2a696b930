"""The evaluation sets: presses of parts, damage and sensors that training never draws, and real frames.

Every set is a list of trials that any process can make. Simulated ones come from `presses.py`, real pictures from
`real_touch.py`. `sets.toml` says what each set shows, and what it cannot show.
"""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

from calibration.experiments.backbones.presses import PARTS, part_trial, random_part_trial
from calibration.experiments.backbones.real_touch import OBJECTS, real_touch_trial
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
    simulated: dict[str, Sequence[Callable[[], Trial]]] = {
        "random-parts": [partial(random_part_trial, number) for number in range(6)],
        "parts": [partial(part_trial, part) for part in PARTS],
        "sensor": [partial(part_trial, part, "unseen sensor") for part in PARTS],
        "worn-gel": [partial(part_trial, part, "worn gel") for part in _FEW],
        "marker-gel": [partial(part_trial, part, "marker gel") for part in _FEW],
        "residual-imprint": [partial(part_trial, part, "residual imprint") for part in _FEW],
        "sliding-press": [partial(part_trial, part, "sliding press") for part in _FEW],
    }
    found = {}
    for name, about in _DESCRIPTIONS.items():
        trials, missing = simulated.get(name, ()), ""
        if (sensors := SENSORS.get(name)) is not None:
            missing = _say_missing(real_tactile, list(sensors))
            objects = [one.name for one in OBJECTS if one.sensor in sensors and not missing]
            trials = [partial(real_touch_trial, real_tactile or Path(), one) for one in objects]
        found[name] = EvaluationSet(**about, trials=tuple(trials), missing=missing)
    return found


def _say_missing(folder: Path | None, sensors: Sequence[str]) -> str:
    """Say why there are no trials: the sensors without a folder; empty when all are there."""
    if folder is None:
        return "no folder of real tactile frames was given (--tactile)"
    if not folder.is_dir():
        return "the folder of real tactile frames given with --tactile does not exist"
    absent = [sensor for sensor in sensors if not (folder / sensor).is_dir()]
    return f"no frames of {', '.join(absent)} in the folder given with --tactile" if absent else ""
