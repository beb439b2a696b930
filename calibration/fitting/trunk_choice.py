"""Which trunk a fit uses: the one whose banks see most of small damage put into the station's own nominal presses.

Each trunk is judged out of fold, as the limit of a fit is found. No label is used. docs/detectors.md compares the
choice with the truth, part by part.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.augmentation import Copies, augmentation_of
from calibration.fitting.damaged_presses import DamagedPresses, damaged_presses
from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.folds import held_out_folds
from calibration.fitting.heads import check_head
from calibration.fitting.held_out import HeldOut, Learner, held_out
from calibration.fitting.nominal_presses import NominalPresses
from calibration.fitting.pose_decision import chosen_pose
from calibration.fitting.threshold import MIN_PRESSES
from calibration.fitting.trunks import Trunk, open_trunk
from calibration.metrics import aupro, auroc
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge.core.detector import Features, Nominal
from edge.core.errors import ConfigError, FitError
from edge.model.session import open_session

__all__ = ["MOST_PRESSES", "TrunkChoice", "choose_trunk", "separated"]

MOST_PRESSES = 24
"""Of more presses a trunk is judged by this many, which bounds the time."""


@dataclass(frozen=True)
class TrunkChoice:
    """why: a sentence for the operator. found: trunk to what its banks see of the damage, 0 to 1, by kind of damage."""

    trunk: Trunk
    why: str
    found: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def facts(self) -> dict[str, Any]:
        """For the manifest."""
        found = {trunk: {kind: round(one, 4) for kind, one in of.items()} for trunk, of in self.found.items()}
        return {"chosen": self.trunk.id, "why": self.why, "found": found}


@one_blas_thread()
def choose_trunk(
    presses: NominalPresses,
    config: FitConfig,
    others: Sequence[str],
    report: Report = lambda stage, fraction: None,
) -> TrunkChoice:
    """The trunk that separates most: that of the configuration, or an installed backbone of these names.

    That of the configuration where nothing can be compared. Errors: FitError where it does not fit.
    """
    usual = config.trunk
    if why := _hindrance(presses, config):
        return TrunkChoice(usual, f"{usual.id}, without a comparison: {why}")
    judge = _Judge(presses, config)
    if not judge.damaged:
        return TrunkChoice(usual, f"{usual.id}, without a comparison: no damage shows in the presses")
    trunks, found, left_out = {usual.id: usual}, {usual.id: judge.found(usual)}, []
    for number, name in enumerate(others, start=1):
        report("backbone", number / (len(others) + 1))
        try:
            trunks[name] = open_trunk(name, config.detector.taps(judge.parameters))
            found[name] = judge.found(trunks[name])
        except (ConfigError, FitError) as error:
            left_out.append(f"{name} was not tried: {error}")
    report("backbone", 1.0)
    best = max(found, key=lambda name: _mean(found[name]))
    return TrunkChoice(trunks[best], "; ".join([_why(best, found), *left_out]), found)


def _hindrance(presses: NominalPresses, config: FitConfig) -> str:
    """Why nothing can be compared; empty where it can."""
    if config.mode == "paper":
        return "the published methods have no choice"
    if presses.no_contact is None:
        return "damage is rendered with a picture of the free gel; give one with --no-contact"
    if len(presses) < MIN_PRESSES:
        return f"of fewer than {MIN_PRESSES} presses nothing can be held out"
    return ""


def _mean(found: Mapping[str, float]) -> float:
    return float(np.mean(list(found.values())))


def _why(best: str, found: Mapping[str, Mapping[str, float]]) -> str:
    seen = ", ".join(f"{name} {_mean(of):.3f}" for name, of in found.items())
    kinds = " and ".join(next(iter(found.values())))
    return (
        f"{best}: of {kinds} in the nominal presses its banks see most ({seen}; mean of image AUROC and AU-PRO up to "
        "1 %, out of fold)"
    )


class _Judge:
    """The same presses and the same damage for every trunk."""

    def __init__(self, presses: NominalPresses, config: FitConfig) -> None:
        self._config, self._few = config, presses.spread(MOST_PRESSES)
        self.parameters = config.detector.parameters(config.mode, **config.overrides)
        bench = _Bench(config, config.trunk, self.parameters)
        view = config.profile, config.region
        pose = chosen_pose(config.register, self._few, bench.learner, bench.take, view)
        self._is_registered, self._posed = pose.learnt is not None, pose.posed(self._few)
        self.damaged = damaged_presses(self._posed, *view, config.seed)
        specimens = self._few.specimens or (None,) * len(self._few)
        self._folds = held_out_folds(specimens, config.folds, np.random.default_rng(config.seed))[0]

    def found(self, trunk: Trunk) -> dict[str, float]:
        """What banks on this trunk see, by kind of damage. Errors: FitError for a trunk that does not fit."""
        bench = _Bench(self._config, trunk, self.parameters)
        free = self._few.no_contact
        nominal = Nominal(
            bench.take(self._posed.frames), self._posed.touched, None if free is None else bench.take(free)
        )
        frames = np.concatenate([one.frames for one in self.damaged.values()])
        press = np.concatenate([one.press for one in self.damaged.values()])
        learner = replace(bench.learner, copies=bench.copies(self._few, self._is_registered))
        shown = held_out(learner, nominal, self._folds, (bench.take(frames), press))
        found, first = {}, 0
        for name, one in self.damaged.items():
            found[name] = separated(shown, slice(first, first + len(one)), one)
            first += len(one)
        return found


def separated(shown: HeldOut, rows: slice, damaged: DamagedPresses) -> float:
    """The mean of image AUROC and AU-PRO up to 1 % false positives of damaged presses, rows of `edited`, against the
    sound ones."""
    sound, maps = shown.sound, shown.edited.maps[rows]
    scores = np.concatenate([sound.scores, shown.edited.scores[rows]])
    is_damaged = np.arange(len(scores)) >= len(sound.scores)
    none = np.zeros(sound.maps.shape, np.bool_)
    area = aupro([*sound.maps, *maps], [*none, *damaged.masks])
    return 0.5 * (auroc(scores, is_damaged) or 0.0) + 0.5 * (area or 0.0)


class _Bench:
    """One trunk, ready to learn and to take features."""

    def __init__(self, config: FitConfig, trunk: Trunk, parameters: Any) -> None:
        self._config, detector = config, config.detector
        self._session = open_session(trunk.graph, config.threads, f"trunk '{trunk.id}'")
        size = config.region.height, config.region.width
        self.grid = trunk_grid(self._session, detector.taps(parameters), size, config.profile.pixels_per_mm)
        check_head(detector, self.grid, parameters)
        self.learner = Learner(detector, self.grid, parameters, config.seed, config.threads)

    def take(self, frames: NDArray[np.uint8]) -> Features:
        return extract(self._session, frames, self.grid, lambda fraction: None)

    def copies(self, presses: NominalPresses, is_registered: bool) -> Copies | None:
        config = self._config
        found = augmentation_of(config.augment, presses, config.detector.name, config.mode, is_registered)
        return Copies.of(presses, found.each, config.profile.pixels_per_mm, config.seed, self.take)
