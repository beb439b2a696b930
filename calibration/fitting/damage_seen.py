"""What banks of one method on one trunk see of small damage put into the station's own nominal presses.

Out of fold, as the limit of a fit is found, and without a label. The damaged presses are the same for every method and
trunk. Where a method's presses are registered, each comes to it as the gateway would bring it, and its map is brought
back, so that places which left the field count.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.damaged_presses import damage_presses
from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.limits.folds import held_out_folds
from calibration.fitting.limits.held_out import Learner, ScoredPresses, score_held_out
from calibration.fitting.pose.pose_decision import PoseChoice, chosen_pose
from calibration.fitting.presses.augmentation import Copies, Take, augmentation_of
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.presses.scatter import scatter_warnings
from calibration.fitting.trunks import Trunk
from calibration.metrics import aupro, auroc
from edge.core.detector import Detector, Features, Nominal
from edge.core.registration.registrar import Registered, Registrar
from edge.model.session import open_session

__all__ = ["MOST_PRESSES", "Brought", "DamageJudge", "Seen", "TrunkBench", "separated"]

T = TypeVar("T")
U8 = NDArray[np.uint8]

MOST_PRESSES = 24
"""Of more presses methods and trunks are judged by this many, which bounds the time."""

_TIMED = 9
"""The trunk's time is the median of this many presses, one at a time, as a gateway runs it."""


@dataclass(frozen=True)
class Seen:
    """found: what the banks see of the damage, 0 to 1, by its kind. press_ms: of one press on this machine, from its
    frame to its score. is_registered: whether presses are brought to one pose."""

    found: Mapping[str, float]
    press_ms: float = 0.0
    is_registered: bool = False

    @property
    def mean(self) -> float:
        return float(np.mean(list(self.found.values())))


def separated(sound: ScoredPresses, damaged: ScoredPresses, masks: NDArray[np.bool_]) -> float:
    """The mean of image AUROC and AU-PRO up to 1 % false positives. masks: of the damage, bool (m, h, w)."""
    scores = np.concatenate([sound.scores, damaged.scores])
    is_damaged = np.arange(len(scores)) >= len(sound.scores)
    none = np.zeros(sound.maps.shape, np.bool_)
    area = aupro([*sound.maps, *damaged.maps], [*none, *masks])
    return 0.5 * (auroc(scores, is_damaged) or 0.0) + 0.5 * (area or 0.0)


@dataclass(frozen=True, eq=False)
class Brought:
    """learnt: the presses as a bank learns them. frames: sound and damaged ones as they come to the trunk, uint8
    (n + m, h, w, 3). registered: each of these; None where presses are scored as they lie. registration_ms: of each."""

    learnt: NominalPresses
    frames: U8
    registered: Sequence[Registered] | None = None
    registration_ms: float = 0.0

    def in_press(self, scored: ScoredPresses) -> ScoredPresses:
        """Maps and scores of the presses as they lie; a press whose pose is refused shows nothing."""
        if self.registered is None:
            return scored
        maps, scores = np.zeros_like(scored.maps), np.zeros_like(scored.scores)
        for k, one in enumerate(self.registered):
            if one.refusal is None:
                maps[k], scores[k] = one.in_press(scored.maps[k]), one.score(scored.maps[k])
        return ScoredPresses(maps, scores, scored.head_ms)


class DamageJudge:
    """The same presses and the same damage for every method and trunk."""

    def __init__(self, presses: NominalPresses, config: FitConfig) -> None:
        self._config, self._all, self._few = config, presses, presses.spread(MOST_PRESSES)
        self.damaged = damage_presses(self._few, *config.view, config.seed)
        rng = np.random.default_rng(config.seed)
        self._folds = held_out_folds(self._few.specimens, config.folds, rng)[0]
        press = [np.arange(len(self._few)), *(one.press for one in self.damaged.values())]
        self._press = np.concatenate(press)
        self._poses: dict[str, PoseChoice] = {}
        self._brought: dict[bool, Brought] = {}

    def seen(self, detector: Detector, bench: "TrunkBench") -> Seen:
        """What banks of this method see on the trunk. Errors: FitError where it does not take the presses or the
        trunk."""
        learner = bench.learner(detector)
        brought = self._brought_to(learner, bench.take)
        nominal, features = bench.features(brought)
        learner = replace(learner, copies=self._copies(learner, brought, bench.take))
        shown = score_held_out(learner, nominal, self._folds, (features, self._press)).edited
        press_ms = brought.registration_ms + bench.trunk_ms + float(np.median(shown.head_ms))
        return Seen(self._by_kind(brought.in_press(shown)), press_ms, brought.registered is not None)

    def _by_kind(self, scored: ScoredPresses) -> dict[str, float]:
        first = len(self._few)
        sound, found = _part(scored, 0, first), {}
        for kind, one in self.damaged.items():
            found[kind] = separated(sound, _part(scored, first, len(one)), one.masks)
            first += len(one)
        return found

    def _brought_to(self, learner: Learner, take: Take) -> Brought:
        """How presses come to the method, decided on the first trunk. Errors: FitError where it does not take them."""
        config, name = self._config, learner.detector.name
        if name not in self._poses:
            self._poses[name] = chosen_pose(config.register, self._few, learner, take, config.view)
        pose = self._poses[name]
        if pose.learnt is None:
            scatter_warnings(self._all, config.profile, learner.detector, config.is_scattered, pose.why)
        is_registered = pose.learnt is not None
        if is_registered not in self._brought:
            self._brought[is_registered] = self._by(pose)
        return self._brought[is_registered]

    def _by(self, pose: PoseChoice) -> Brought:
        frames = np.concatenate([self._few.frames, *(one.frames for one in self.damaged.values())])
        if pose.learnt is None:
            return Brought(self._few, frames)
        found, ms = _timed(Registrar(pose.learnt.part).register, frames)
        return Brought(pose.posed(self._few), np.stack([one.rgb for one in found]), found, ms)

    def _copies(self, learner: Learner, brought: Brought, take: Take) -> Copies | None:
        config, is_registered = self._config, brought.registered is not None
        name = learner.detector.name
        each = augmentation_of(config.augment, self._few, name, config.mode, is_registered).each
        return Copies.of(self._few, each, config.profile.pixels_per_mm, config.seed, take)


def _timed(work: Callable[[U8], T], frames: U8) -> tuple[list[T], float]:
    """The work on each frame, and its median time in ms."""
    found, ms = [], []
    for rgb in frames:
        start = time.perf_counter()
        found.append(work(rgb))
        ms.append((time.perf_counter() - start) * 1e3)
    return found, float(np.median(ms))


def _part(scored: ScoredPresses, first: int, count: int) -> ScoredPresses:
    rows = slice(first, first + count)
    return ScoredPresses(scored.maps[rows], scored.scores[rows])


class TrunkBench:
    """One trunk, whose features serve every method. taps: all that the methods read. Errors: FitError for a trunk that
    lacks one."""

    def __init__(self, trunk: Trunk, taps: Sequence[str], config: FitConfig) -> None:
        self._config, self.trunk = config, trunk
        self._session = open_session(trunk.graph, config.threads, f"trunk '{trunk.id}'")
        size = config.region.height, config.region.width
        self._grid = trunk_grid(self._session, taps, size, config.profile.pixels_per_mm)
        self._features: dict[bool, tuple[Nominal, Features]] = {}
        self.trunk_ms = 0.0

    def learner(self, detector: Detector) -> Learner:
        """Errors: FitError for settings that the method refuses."""
        config = self._config
        parameters = detector.parameters(config.mode, **config.overrides)
        grid = replace(self._grid, taps={tap: self._grid.taps[tap] for tap in detector.taps(parameters)})
        return Learner(detector, grid, parameters, config.seed, config.threads)

    def take(self, frames: U8) -> Features:
        return extract(self._session, frames, self._grid, lambda fraction: None)

    def features(self, brought: Brought) -> tuple[Nominal, Features]:
        """Of the presses to learn and of those to score, taken once for all methods."""
        learnt, key = brought.learnt, brought.registered is not None
        if key not in self._features:
            free = None if learnt.no_contact is None else self.take(learnt.no_contact)
            nominal = Nominal(self.take(learnt.frames), learnt.touched, free)
            self._features[key] = nominal, self.take(brought.frames)
            _, self.trunk_ms = _timed(lambda rgb: self.take(rgb[None]), learnt.frames[:_TIMED])
        return self._features[key]
