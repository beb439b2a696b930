"""What every detector must do, on synthetic features."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, cast

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from edge.core.arrays import F32
from edge.core.detector import Bank, Detector, Features, Grid, HasReference, Nominal, ScoreMaps
from edge.core.errors import FitError
from edge.model.onnx_validation import check_graph
from edge.model.session import open_session
from plugins.conformance.running import collect, raises, require, run_all

__all__ = ["DETECTOR_CHECKS", "DetectorCase", "check_detector"]

# A small frame, and the taps of the shipped backbone: (channels, pixels per cell). Other taps are as layer2.
FRAME: Final = (64, 64)
TAPS: Final = {"layer1": (64, 4), "layer2": (128, 8), "layer3": (256, 16)}
PRESSES: Final = 8
DTYPES: Final = ("float32", "int64", "bool")
# Relative to the largest value: float32 sums of some thousand terms and a square root.
PARITY: Final = 1e-4
# Between the methods that compare places (1.6 and more on these features) and those that do not (1.1 at most).
MOVED: Final = 1.3


@dataclass(frozen=True)
class DetectorCase:
    """A detector with parameters and a grid to check it on. parameters None: the defaults."""

    detector: Detector
    parameters: Any = None
    frame: tuple[int, int] = FRAME

    @cached_property
    def chosen(self) -> Any:
        return self.detector.parameters() if self.parameters is None else self.parameters

    @cached_property
    def grid(self) -> Grid:
        h, w = self.frame
        sizes = {tap: TAPS.get(tap, TAPS["layer2"]) for tap in self.detector.taps(self.chosen)}
        return Grid(self.frame, {tap: (c, h // cell, w // cell) for tap, (c, cell) in sizes.items()}, 15.77)

    def presses(self, n: int, seed: int) -> Features:
        """n presses of one part: a common pattern and deviations of 30 %; not negative, as after a ReLU."""
        part, own = np.random.default_rng(77), np.random.default_rng(seed)
        return {
            tap: np.maximum(part.normal(0.5, 1, shape) + own.normal(0, 0.3, (n, *shape)), 0).astype(
                np.float32
            )
            for tap, shape in self.grid.taps.items()
        }

    def fit(
        self, features: Features, seed: int = 0, progress: Callable[[float], None] = lambda _: None
    ) -> Bank:
        rng = np.random.default_rng(seed)
        return self.detector.fit(Nominal(features), self.grid, self.chosen, rng, progress)

    def score(self, features: Features, bank: Bank) -> ScoreMaps:
        """Map and score of each press by the graph, as in the gateway."""
        session = open_session(self.detector.head(self.grid, bank, self.chosen), 1, "head.onnx")
        wanted = [end.name for end in session.get_inputs()]
        feed = {name: features[name] if name in features else bank.arrays[name] for name in wanted}
        score_map, score = cast("list[NDArray[Any]]", session.run(["score_map", "score"], feed))
        return ScoreMaps(score_map, score)


def check_detector(detector: Detector, parameters: Any = None) -> None:
    """Run every check on a detector. Errors: ExceptionGroup."""
    run_all(f"detector {detector.name}", DETECTOR_CHECKS, lambda: DetectorCase(detector, parameters))


def check_it_is_a_detector(case: DetectorCase) -> None:
    """The detector has all members of `edge.core.detector.Detector`."""
    require(isinstance(case.detector, Detector), f"{type(case.detector).__name__} lacks a part of Detector")


def check_parameters(case: DetectorCase) -> None:
    """Parameters have `vars` that JSON can hold, and are equal for equal choices; an unknown one is a FitError."""
    once, again = case.detector.parameters(), case.detector.parameters()
    require(once == again, f"{once} and {again} differ")
    json.dumps(vars(once))
    raises(FitError, "no_such_parameter=1", lambda: case.detector.parameters(no_such_parameter=1))


def check_fit_can_be_repeated(case: DetectorCase) -> None:
    """Two fits of equal presses and seed give equal banks; features are not changed; progress is between 0 and 1."""
    features, seen = case.presses(PRESSES, 1), list[float]()
    before = {tap: maps.copy() for tap, maps in features.items()}
    first, second = case.fit(features, progress=seen.append), case.fit(features)
    same = all(np.array_equal(first.arrays[name], second.arrays[name]) for name in first.arrays)
    require(first.arrays.keys() == second.arrays.keys() and same, "two fits of the same presses differ")
    require(all(np.array_equal(before[tap], features[tap]) for tap in before), "fit changes its features")
    require(all(0 <= fraction <= 1 for fraction in seen), f"progress of {seen}")


def check_bank(case: DetectorCase) -> None:
    """Arrays are float32, int64 or bool and finite, packing names existing arrays, facts are plain JSON."""
    bank = case.fit(case.presses(PRESSES, 1))
    require(bool(bank.arrays), "the bank has no arrays")
    for name, array in bank.arrays.items():
        require(str(array.dtype) in DTYPES, f"array '{name}' is {array.dtype}")
        require(bool(np.isfinite(array).all()), f"array '{name}' is not finite")
    require(bank.packing.keys() <= bank.arrays.keys(), f"packing of {set(bank.packing) - set(bank.arrays)}")
    json.dumps(dict(bank.facts))


def check_head(case: DetectorCase) -> None:
    """The graph is allowed in a bundle, reads taps and bank arrays, gives float32 maps (n, h, w) and scores (n,)."""
    bank, asked = case.fit(case.presses(PRESSES, 1)), case.presses(3, 2)
    graph = case.detector.head(case.grid, bank, case.chosen)
    check_graph(graph)
    session = ort.InferenceSession(graph, providers=["CPUExecutionProvider"])
    inputs, outputs = ({end.name for end in ends} for ends in (session.get_inputs(), session.get_outputs()))
    require({"score_map", "score"} <= outputs, f"it gives {sorted(outputs)}")
    require(bool(inputs & case.grid.taps.keys()), f"it reads {sorted(inputs)} and no tap")
    require(inputs <= case.grid.taps.keys() | bank.arrays.keys(), f"it reads {sorted(inputs)}")
    maps = case.score(asked, bank)
    require(str(maps.score_map.dtype) == str(maps.score.dtype) == "float32", "maps or scores are not float32")
    require(maps.score_map.shape == (3, *case.frame), f"maps are {maps.score_map.shape}")
    require(maps.score.shape == (3,), f"scores are {maps.score.shape}")
    require(
        bool(np.isfinite(maps.score_map).all() and np.isfinite(maps.score).all()), "scores are not finite"
    )


def check_a_press_is_scored_by_itself(case: DetectorCase) -> None:
    """A press has the same map and score alone and in a batch."""
    bank, asked = case.fit(case.presses(PRESSES, 1)), case.presses(3, 2)
    among = case.score(asked, bank)
    alone = case.score({tap: maps[1:2] for tap, maps in asked.items()}, bank)
    compare(alone, ScoreMaps(among.score_map[1:2], among.score[1:2]))


def check_damage_scores_higher(case: DetectorCase) -> None:
    """A press with one abnormal cell scores above every nominal one."""
    train, asked = case.presses(PRESSES, 1), case.presses(3, 2)
    damaged = case.score(with_damage(asked), case.fit(train)).score
    sound = case.score(asked, case.fit(train)).score
    require(bool(damaged.min() > sound.max()), f"damaged presses score {damaged}, nominal ones {sound}")


def check_it_compares_places_if_it_says_so(case: DetectorCase) -> None:
    """A press moved by half a frame scores well above one in place if `compares_places` is true, else the same."""
    bank, asked = case.fit(case.presses(PRESSES, 1)), case.presses(3, 2)
    moved = {tap: np.roll(m, (m.shape[2] // 2, m.shape[3] // 2), (2, 3)) for tap, m in asked.items()}
    ratio = float(case.score(moved, bank).score.mean() / case.score(asked, bank).score.mean())
    message = f"a moved press scores {ratio:.2f} of one in place, compares_places is {case.detector.compares_places}"
    require((ratio > MOVED) == case.detector.compares_places, message)


def check_reference(case: DetectorCase) -> None:
    """If there is a float64 oracle, the graph agrees with it."""
    if isinstance(case.detector, HasReference):
        bank, asked = case.fit(case.presses(PRESSES, 1)), with_damage(case.presses(2, 2))
        compare(case.score(asked, bank), case.detector.reference_score(asked, case.grid, bank, case.chosen))


def check_no_presses(case: DetectorCase) -> None:
    """A fit without presses is a FitError, not an empty bank."""
    raises(FitError, "no presses", lambda: case.fit(case.presses(0, 1)))


def check_one_press(case: DetectorCase) -> None:
    """A single press is a FitError, or gives finite scores."""
    require_refused_or_finite(case, case.presses(1, 1))


def check_equal_presses(case: DetectorCase) -> None:
    """Presses without any difference are a FitError, or give finite scores."""
    require_refused_or_finite(
        case, {tap: maps.repeat(PRESSES, axis=0) for tap, maps in case.presses(1, 1).items()}
    )


def check_features_that_are_not_finite(case: DetectorCase) -> None:
    """Fitting refuses a value that is not finite among the nominal presses: FitError."""
    for value in (np.nan, np.inf):
        presses = with_value(case, PRESSES, value)
        raises(FitError, f"a feature of {value}", partial(case.fit, presses))


def check_a_press_that_is_not_finite_does_not_pass(case: DetectorCase) -> None:
    """A press with a NaN gets a map that is not finite (then refused), or a score that is not below a nominal one."""
    bank = case.fit(case.presses(PRESSES, 1))
    sound = case.score(case.presses(1, 2), bank)
    maps = case.score(with_value(case, 1, np.nan), bank)
    is_seen = not (np.isfinite(maps.score_map).all() and np.isfinite(maps.score).all())
    require(bool(is_seen or maps.score[0] > sound.score[0]), f"a press with a NaN scores {maps.score[0]}")


DETECTOR_CHECKS: Final[tuple[Callable[[DetectorCase], None], ...]] = collect(globals(), DetectorCase)


def compare(maps: ScoreMaps, expected: ScoreMaps) -> None:
    """Refuse a map or score that differs by more than PARITY of the largest value. Errors: AssertionError."""
    for what in ("score_map", "score"):
        values, reference = getattr(maps, what), getattr(expected, what)
        error = float(np.abs(values - reference).max()) / max(float(np.abs(reference).max()), 1e-30)
        require(error < PARITY, f"{what} differs by {error:.2g} of its largest value")


def with_damage(features: Features) -> Features:
    """Copy the presses, with one abnormal cell in the middle of every tap."""
    changed = {tap: maps.copy() for tap, maps in features.items()}
    for maps in changed.values():
        maps[:, ::2, maps.shape[2] // 2, maps.shape[3] // 2] += np.float32(5 * maps.max())
    return changed


def with_value(case: DetectorCase, n: int, value: float) -> Mapping[str, F32]:
    """n presses; the first has this value once in every tap."""
    features = {tap: maps.copy() for tap, maps in case.presses(n, 3).items()}
    for maps in features.values():
        maps[0, :, 1, 1] = value
    return features


def require_refused_or_finite(case: DetectorCase, features: Features) -> None:
    try:
        bank = case.fit(features)
    except FitError:
        return
    maps = case.score(case.presses(1, 2), bank)
    require(bool(np.isfinite(maps.score_map).all()), "a bank was fitted that gives no finite scores")
