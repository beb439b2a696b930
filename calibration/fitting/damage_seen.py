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
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, ScoredPresses, ShownPresses, score_held_out
from calibration.fitting.pose.pose_decision import PoseChoice, choose_pose
from calibration.fitting.presses.augmentation import Copies, Take, plan_copies
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.presses.scatter import scatter_warnings
from calibration.fitting.tap_reader import TapReader
from calibration.fitting.trunks import Trunk
from calibration.metrics import aupro, auroc
from edge.core.detector import Detector, Features, Nominal
from edge.core.errors import FitError
from edge.core.registration.pose import Registered
from edge.core.registration.registrar import Registrar

__all__ = ["MOST_PRESSES", "DamageJudge", "PosedPresses", "Separation", "measure_separation"]

T = TypeVar("T")
U8 = NDArray[np.uint8]

MOST_PRESSES = 24
"""Of more presses methods and trunks are judged by this many, which bounds the time."""

_TIMED = 9
"""The trunk's time is the median of this many presses, one at a time, as a gateway runs it."""


@dataclass(frozen=True)
class Separation:
    """How well the banks of a method on a trunk tell damaged presses from sound ones."""

    by_kind: Mapping[str, float]
    """0 to 1, by the kind of damage."""
    press_ms: float = 0.0
    """The time of one press on this machine, from its frame to its score."""
    is_registered: bool = False

    @property
    def mean(self) -> float:
        return float(np.mean(list(self.by_kind.values())))


def measure_separation(sound: ScoredPresses, damaged: ScoredPresses, masks: NDArray[np.bool_]) -> float:
    """Return the mean of image AUROC and AU-PRO up to 1 % false positives. masks: of the damage, bool (m, h, w)."""
    scores = np.concatenate([sound.scores, damaged.scores])
    is_damaged = np.arange(len(scores)) >= len(sound.scores)
    none = np.zeros(sound.maps.shape, np.bool_)
    area = aupro([*sound.maps, *damaged.maps], [*none, *masks])
    return 0.5 * (auroc(scores, is_damaged) or 0.0) + 0.5 * (area or 0.0)


@dataclass(frozen=True, eq=False)
class PosedPresses:
    """Presses as they come to a method: as they lie, or in one pose."""

    learnt: NominalPresses
    """The presses as a bank learns them."""
    frames: U8
    """Sound and damaged ones as they come to the trunk, uint8 (n + m, h, w, 3)."""
    registered: Sequence[Registered] | None = None
    """Each of these; None where presses are scored as they lie."""
    registration_ms: float = 0.0

    def bring_back(self, scored: ScoredPresses) -> ScoredPresses:
        """Bring maps and scores to the presses as they lie; a press whose pose is refused shows nothing."""
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
        self._folds = divide_presses(self._few.specimens, config.folds, rng)[0]
        press = [np.arange(len(self._few)), *(one.press for one in self.damaged.values())]
        self._press = np.concatenate(press)
        frames = [self._few.frames, *(one.frames for one in self.damaged.values())]
        self._still = PosedPresses(self._few, np.concatenate(frames))
        self._registered: PosedPresses | None = None
        self._poses: dict[str, PoseChoice] = {}

    def judge(
        self, trunk: Trunk, taps: Sequence[str], detectors: Mapping[str, Detector]
    ) -> dict[str, Separation | FitError]:
        """Measure what banks of each method see on the trunk, or why it does not take the presses or the trunk.

        taps: all that the methods read. Errors: FitError for a trunk that lacks one.
        """
        config, found = self._config, dict[str, Separation | FitError]()
        frame, name = (config.region.height, config.region.width), f"trunk '{trunk.id}'"
        reader = TapReader(trunk.graph, taps, frame, config.profile.pixels_per_mm, config.threads, name)
        _, trunk_ms = _time(lambda rgb: reader.take(rgb[None]), self._few.frames[:_TIMED])
        taken: dict[bool, tuple[Nominal, Features]] = {}
        for name, detector in detectors.items():
            try:
                found[name] = self._judge_method(detector, reader, taken, trunk_ms)
            except FitError as error:
                found[name] = error
        return found

    def _judge_method(
        self,
        detector: Detector,
        reader: TapReader,
        taken: dict[bool, tuple[Nominal, Features]],
        trunk_ms: float,
    ) -> Separation:
        """Measure what banks of this method see. taken: features of presses as they lie or registered, for all methods.
        Errors: FitError where it does not take the presses."""
        config = self._config
        learner = reader.learner(detector, detector.parameters(config.mode, **config.overrides), config.seed)
        posed = self._pose(learner, reader.take)
        is_registered = posed.registered is not None
        if is_registered not in taken:
            taken[is_registered] = reader.nominal(posed.learnt), reader.take(posed.frames)
        nominal, features = taken[is_registered]
        each = plan_copies(config.augment, self._few, detector.name, config.mode, is_registered).each
        copies = Copies.of(self._few, each, config.profile.pixels_per_mm, config.seed, reader.take)
        learner = replace(learner, copies=copies)
        shown = score_held_out(learner, nominal, self._folds, (ShownPresses(features), self._press)).edited
        press_ms = posed.registration_ms + trunk_ms + float(np.median(shown.head_ms))
        return Separation(self._by_kind(posed.bring_back(shown)), press_ms, is_registered)

    def _by_kind(self, scored: ScoredPresses) -> dict[str, float]:
        first = len(self._few)
        sound, by_kind = _part(scored, 0, first), {}
        for kind, one in self.damaged.items():
            by_kind[kind] = measure_separation(sound, _part(scored, first, len(one)), one.masks)
            first += len(one)
        return by_kind

    def _pose(self, learner: Learner, take: Take) -> PosedPresses:
        """Bring the presses to the method, in the pose that is decided on the first trunk. Errors: FitError where the
        method does not take them."""
        config, name = self._config, learner.detector.name
        if name not in self._poses:
            self._poses[name] = choose_pose(config.register, self._few, learner, take, config.view)
        pose = self._poses[name]
        if pose.learnt is None:
            scatter_warnings(self._all, config.profile, learner.detector, config.is_scattered, pose.why)
            return self._still
        if self._registered is None:
            found, ms = _time(Registrar(pose.learnt.part).register, self._still.frames)
            frames = np.stack([one.rgb for one in found])
            self._registered = PosedPresses(pose.apply(self._few), frames, found, ms)
        return self._registered


def _time(work: Callable[[U8], T], frames: U8) -> tuple[list[T], float]:
    """Do the work on each frame, and measure its median time in ms."""
    done, ms = [], []
    for rgb in frames:
        start = time.perf_counter()
        done.append(work(rgb))
        ms.append((time.perf_counter() - start) * 1e3)
    return done, float(np.median(ms))


def _part(scored: ScoredPresses, first: int, count: int) -> ScoredPresses:
    rows = slice(first, first + count)
    return ScoredPresses(scored.maps[rows], scored.scores[rows])
