"""Feature maps without a trunk, and heads run as the gateway runs them: what the tests of detectors share."""

from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid, Nominal, ScoreMaps

LIKE_RESNET = Grid((48, 48), {"layer1": (8, 12, 12), "layer2": (12, 6, 6), "layer3": (20, 3, 3)}, 15.77)
"""Three taps in a ResNet's proportions: strides 4, 8 and 16, 40 channels together."""


def features(n: int, grid: Grid = LIKE_RESNET, seed: int = 0, scale: float = 1.0) -> Features:
    """n presses after a ReLU: a pattern that all share, and a deviation of 30 % of its own, float32."""
    shared = np.random.default_rng(99)
    rng = np.random.default_rng(seed)
    return {
        tap: (np.maximum(shared.normal(0.5, 1, shape) + rng.normal(0, 0.3, (n, *shape)), 0) * scale).astype(
            np.float32
        )
        for tap, shape in grid.taps.items()
    }


def fitted(detector: Any, parameters: Any, nominal: Nominal, grid: Grid = LIKE_RESNET, seed: int = 0) -> Bank:
    """The bank, with a fixed seed and no progress shown."""
    bank: Bank = detector.fit(nominal, grid, parameters, np.random.default_rng(seed), lambda fraction: None)
    return bank


def head_scores(
    detector: Any, parameters: Any, query: Features, bank: Bank, grid: Grid = LIKE_RESNET
) -> ScoreMaps:
    """What the detector's ONNX head answers, in the shape of the oracle's answer."""
    return run_head(detector.head(grid, bank, parameters), query, bank)


def run_head(head: bytes, query: Features, bank: Bank) -> ScoreMaps:
    """A serialised head on taps and bank."""
    session = onnxruntime.InferenceSession(head, providers=["CPUExecutionProvider"])
    feeds = {i.name: query[i.name] if i.name in query else bank.arrays[i.name] for i in session.get_inputs()}
    score_map, score = session.run(["score_map", "score"], feeds)
    return ScoreMaps(score_map, score)


def largest_error(found: ScoreMaps, expected: ScoreMaps) -> float:
    """The largest error of map and score, relative to the largest value of the map."""
    scale = float(np.abs(expected.score_map).max()) or 1.0
    return float(
        max(np.abs(found.score_map - expected.score_map).max(), np.abs(found.score - expected.score).max())
        / scale
    )


def stored(bank: Bank) -> Bank:
    """The bank as it comes back from storage in its packing."""
    from edge.model.packing import pack, unpack

    arrays: dict[str, NDArray[Any]] = {
        name: unpack(pack(array, bank.packing.get(name, "none")), bank.packing.get(name, "none"))
        for name, array in bank.arrays.items()
    }
    return Bank(arrays, bank.packing, bank.facts)
