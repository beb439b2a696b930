"""Feature maps without a trunk, heads run as the gateway runs them, and a graph compared with its oracle."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnxruntime as ort

from edge.core.detector import Bank, Detector, Features, Grid, Nominal, ScoreMaps
from edge.model.packing import pack, unpack

SMALL = {"layer1": (6, 8, 8), "layer2": (8, 4, 4), "layer3": (10, 2, 2)}
"""Taps of a toy trunk on a 32x32 frame."""

RESNET18 = {"layer1": (64, 56, 56), "layer2": (128, 28, 28), "layer3": (256, 14, 14)}
"""The taps of a real trunk on the default region."""

LIKE_RESNET = Grid((48, 48), {"layer1": (8, 12, 12), "layer2": (12, 6, 6), "layer3": (20, 3, 3)}, 15.77)
"""Three taps in a ResNet's proportions: strides 4, 8 and 16, 40 channels together."""


def grid(taps: Mapping[str, tuple[int, int, int]] = SMALL) -> Grid:
    side = 4 * next(iter(taps.values()))[1]
    return Grid((side, side), taps, 15.77)


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


def presses_of(
    n: int,
    seed: int = 0,
    taps: Mapping[str, tuple[int, int, int]] = SMALL,
    scale: float = 1.0,
    spread: float = 0.3,
) -> Features:
    """n presses of one part: the same relief each time, a few ways in which presses vary, and noise; no negatives."""
    part, own = np.random.default_rng(77), np.random.default_rng(seed)
    found = {}
    for tap, shape in taps.items():
        relief, ways = part.normal(0.5, 1, shape), part.normal(size=(4, *shape))
        varied = np.einsum("nk,kchw->nchw", own.normal(size=(n, 4)), ways)
        maps = relief + spread * (varied + own.normal(size=(n, *shape)))
        found[tap] = (np.maximum(maps, 0) * scale).astype(np.float32)
    return found


def hard_presses(n: int, kind: str, seed: int, scale: float) -> Features:
    """Nominal sets that break careless arithmetic. kind: noise, same (n equal presses), constant, dead (channels)."""
    found = dict(presses_of(n, seed, scale=scale))
    for tap, maps in found.items():
        if kind == "same":
            found[tap] = np.repeat(maps[:1], n, axis=0)
        elif kind == "constant":
            found[tap] = np.full_like(maps, scale)
        elif kind == "dead":
            maps[:, ::2] = 0
    return found


def with_spot(features: Features, fraction: float = 0.5, amount: float = 5.0) -> Features:
    """The same presses with a foreign patch at one place, seen by every tap."""
    found = {}
    for tap, maps in features.items():
        changed = maps.copy()
        row, column = (int(fraction * size) for size in maps.shape[2:])
        top = np.float32(max(float(maps.max()), np.finfo(np.float32).tiny))
        changed[:, ::2, row, column] += np.float32(amount) * top
        found[tap] = changed
    return found


def fit(
    detector: Detector, parameters: Any, shown: Features | Nominal, at: Grid = LIKE_RESNET, seed: int = 0
) -> Bank:
    nominal = shown if isinstance(shown, Nominal) else Nominal(shown)
    return detector.fit(nominal, at, parameters, np.random.default_rng(seed), lambda fraction: None)


def stored_bytes(bank: Bank) -> int:
    """Bytes of a bank as a bundle keeps it."""
    packed = [pack(array, bank.packing.get(name, "none")) for name, array in bank.arrays.items()]
    return sum(each.data.nbytes + (0 if each.scale is None else each.scale.nbytes) for each in packed)


def stored(bank: Bank) -> Bank:
    """The bank as it comes back from storage in its packing."""
    arrays = {}
    for name, array in bank.arrays.items():
        packing = bank.packing.get(name, "none")
        arrays[name] = unpack(pack(array, packing), packing)
    return Bank(arrays, bank.packing, bank.facts)


def run_head(head: bytes, features: Features, bank: Bank, threads: int = 1) -> dict[str, np.ndarray]:
    """The graph's outputs by name, with the bank bound to the inputs of its arrays' names."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.use_deterministic_compute = True
    session = ort.InferenceSession(head, options, providers=["CPUExecutionProvider"])
    wanted = [i.name for i in session.get_inputs()]
    feed = {name: features[name] if name in features else bank.arrays[name] for name in wanted}
    names = [o.name for o in session.get_outputs()]
    return dict(zip(names, session.run(names, feed), strict=True))


def head_scores(
    detector: Detector, parameters: Any, query: Features, bank: Bank, grid: Grid = LIKE_RESNET
) -> ScoreMaps:
    """What the detector's graph answers, in the shape of the oracle's answer."""
    found = run_head(detector.head(grid, bank, parameters), query, bank)
    return ScoreMaps(found["score_map"], found["score"])


def largest_error(found: ScoreMaps, expected: ScoreMaps) -> float:
    """The largest error of map and score, relative to the largest value of the map."""
    scale = float(np.abs(expected.score_map).max()) or 1.0
    apart = (np.abs(found.score_map - expected.score_map), np.abs(found.score - expected.score))
    return max(float(each.max()) for each in apart) / scale


def parity(
    detector: Detector, parameters: Any, nominal: Features, asked: Features, at: Grid, seed: int = 0
) -> tuple[ScoreMaps, float, float]:
    """The oracle's answer, and the graph's largest errors of map and score relative to the oracle's maxima."""
    bank = fit(detector, parameters, nominal, at, seed)
    oracle = detector.reference_score(asked, at, bank, parameters)
    graph = run_head(detector.head(at, bank, parameters), asked, bank)
    assert graph["score_map"].dtype == np.float32
    assert graph["score_map"].shape == oracle.score_map.shape
    errors = []
    for found, expected in ((graph["score_map"], oracle.score_map), (graph["score"], oracle.score)):
        top = max(float(np.abs(expected).max()), np.finfo(np.float64).tiny)
        errors.append(float(np.abs(found - expected).max()) / top)
    return oracle, errors[0], errors[1]


def around(score_map: np.ndarray, pixel: tuple[int, int]) -> float:
    """The highest score within 12 pixels."""
    row, column = pixel
    return float(score_map[max(row - 12, 0) : row + 13, max(column - 12, 0) : column + 13].max())
