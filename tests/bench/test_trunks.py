"""What trunks and heads cost, in one run: milliseconds, ratio to the bare trunk, bank bytes.

The shipped backbone in each precision, cut where a method stops reading and whole, with every method's own settings;
then operating points of PaDiM and the subspace on random weights.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import numpy_helper
from presses import fitted

from edge import registry
from edge.core.detector import Bank, Features, Grid, Nominal
from edge.core.imaging.tiles import tiling
from edge.model.graph_cut import cut_trunk
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk
from plugins.backbones.tactile import tactile_resnet18, tactile_resnet18_int8
from plugins.backbones.tactile_lite0 import tactile_lite0
from plugins.backbones.tiled import mosaic_trunk
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.padim import padim

pytestmark = pytest.mark.bench

THREADS = 2
PRESSES = 24
BYTES = {"int8": 1, "float16": 2}

ALL = ("layer1", "layer2", "layer3")
POINTS: dict[str, tuple[Any, Any]] = {
    "padim": (padim, padim.parameters()),
    "padim each cell its own": (padim, padim.parameters(block=1)),
    "padim exact": (padim, padim.parameters(rank=None)),
    "padim 448 rank 16": (
        padim,
        padim.parameters(taps=ALL, channels=448, rank=16, neighbours=0, block=1),
    ),
    "padim 448 rank 16 28x28": (
        padim,
        padim.parameters(taps=ALL, channels=448, rank=16, neighbours=0, block=1, grid_tap="layer2"),
    ),
    "padim paper": (padim, padim.parameters("paper")),
    "subspace": (subspace, subspace.parameters()),
}
LARGE: dict[str, tuple[Any, Any]] = {
    "padim": (padim, padim.parameters()),
    "padim layer2's grid": (
        padim,
        padim.parameters(taps=("layer1", "layer2"), grid_tap="layer2", channels=96, block=1),
    ),
    "subspace": (subspace, subspace.parameters()),
}


def session(graph: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = THREADS
    return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])


def best_ms(*works: Callable[[], object], repeats: int) -> list[float]:
    """The shortest run of each, taken in turns: what the work costs where nothing else runs."""
    best = [np.inf] * len(works)
    for _ in range(repeats + 1):
        for index, work in enumerate(works):
            start = time.perf_counter()
            work()
            best[index] = min(best[index], (time.perf_counter() - start) * 1e3)
    return best


def bound(opened: onnxruntime.InferenceSession, feeds: dict[str, np.ndarray]) -> Callable[[], object]:
    """One run with every input bound beforehand, as the scorer does it."""
    io = opened.io_binding()
    for name, array in feeds.items():
        io.bind_ortvalue_input(name, onnxruntime.OrtValue.ortvalue_from_numpy(np.ascontiguousarray(array)))
    for output in opened.get_outputs():
        if output.name != "raw_map":
            io.bind_output(output.name)
    return lambda: opened.run_with_iobinding(io)


def stored_bytes(bank: Bank) -> int:
    return sum(
        array.size * BYTES.get(bank.packing.get(name, "none"), array.itemsize)
        for name, array in bank.arrays.items()
    )


def frames(n: int, h: int, w: int) -> np.ndarray:
    """Blocky pictures that differ by 10 % from press to press, uint8."""
    rng = np.random.default_rng(0)
    base = rng.integers(0, 256, (1, h // 8, w // 8, 3))
    small = np.clip(base + rng.normal(0, 12, (n, h // 8, w // 8, 3)), 0, 255).astype(np.uint8)
    rgb: np.ndarray = small.repeat(8, axis=1).repeat(8, axis=2)
    return rgb


def report(
    name: str, graph: bytes, points: dict[str, tuple[Any, Any]], rgb: np.ndarray, repeats: int, grid_of: Any
) -> None:
    trunk = session(graph)
    start = time.perf_counter()
    parts = [trunk.run(None, {"frames": rgb[i : i + 1]}) for i in range(len(rgb))]
    extraction = time.perf_counter() - start
    taps = [output.name for output in trunk.get_outputs()]
    features: Features = {tap: np.concatenate([part[i] for part in parts]) for i, tap in enumerate(taps)}
    grid = grid_of({tap: value.shape[1:] for tap, value in features.items()})
    run_trunk = bound(trunk, {"frames": rgb[:1]})
    print(f"\n{name}: features of {len(rgb)} presses {extraction:.2f} s")
    for label, (detector, parameters) in points.items():
        start = time.perf_counter()
        bank = fitted(detector, parameters, Nominal(features), grid)
        fit = time.perf_counter() - start
        head = session(detector.head(grid, bank, parameters))
        feeds = {
            i.name: features[i.name][:1] if i.name in features else bank.arrays[i.name]
            for i in head.get_inputs()
        }
        bare, taken = best_ms(run_trunk, bound(head, feeds), repeats=repeats)
        unpacked = sum(array.nbytes for array in bank.arrays.values())
        print(
            f"  {label:26s} trunk {bare:6.1f} ms  head {taken:6.2f} ms  ratio {(bare + taken) / bare:5.2f}  "
            f"bank {stored_bytes(bank) / 1e6:6.1f} MB stored {unpacked / 1e6:6.1f} MB unpacked  "
            f"fit {fit:5.2f} s = {fit / extraction:4.1f} x features"
        )


@pytest.mark.parametrize("topology", ["resnet18", "wide_resnet50_2"])
def test_heads_at_224(topology: str) -> None:
    """Per operating point: the head's time and its ratio to the trunk, bank bytes, fit time. All cells touched."""
    graph = build_trunk(random_state(topology), topology)
    report(
        f"{topology} 224x224",
        graph,
        POINTS,
        frames(PRESSES, 224, 224),
        15,
        lambda t: Grid((224, 224), t, 15.77),
    )


def test_high_resolution() -> None:
    """1280x720 in one piece and in 32 tiles: what each costs with resnet18."""
    graph = build_trunk(random_state("resnet18"), "resnet18")
    rgb, tiles = frames(4, 720, 1280), tiling((720, 1280))
    report("resnet18 1280x720, one piece", graph, LARGE, rgb, 3, lambda t: Grid((720, 1280), t, 63.0))
    report(
        "resnet18 1280x720, 32 tiles",
        mosaic_trunk(graph, tiles),
        LARGE,
        rgb,
        3,
        lambda t: Grid((720, 1280), t, 63.0, tiles),
    )


def widened(graph: bytes) -> bytes:
    """The same trunk with its weights stored as float32."""
    model = onnx.load_from_string(graph)
    for tensor in model.graph.initializer:
        if tensor.data_type == onnx.TensorProto.FLOAT16:
            wide = numpy_helper.to_array(tensor).astype(np.float32)
            tensor.CopyFrom(numpy_helper.from_array(wide, tensor.name))
    return bytes(model.SerializeToString())


def test_the_trunk_for_real_touch() -> None:
    """Its time after each tap and that of the default, in turns, with their ratio; one picture, two threads."""
    rgb = frames(1, 224, 224)
    for tap in ALL:
        runs = [
            bound(session(cut_trunk(one.trunk(), (tap,))), {"frames": rgb})
            for one in (tactile_lite0, tactile_resnet18)
        ]
        touch, default = best_ms(*runs, repeats=25)
        print(f"\n{tap}: {touch:.2f} ms, the default {default:.2f} ms, ratio {touch / default:.2f}")
        assert touch > 0


METHODS = ("padim", "spade", "fapm", "inreach", "subspace", "patchcore")


def test_the_shipped_backbone_in_each_precision() -> None:
    """Per precision: the trunk after each tap; then, per method with its own settings, trunk and head together, beside
    the bare trunk that it needs and the whole one. 24 presses, every cell touched, two threads.
    """
    stored = tactile_resnet18.trunk()
    trunks = {"fp32": widened(stored), "fp16 stored": stored, "int8": tactile_resnet18_int8.trunk()}
    rgb = frames(PRESSES, 224, 224)
    opened = {(name, tap): session(cut_trunk(graph, (tap,))) for name, graph in trunks.items() for tap in ALL}
    bare = {key: bound(one, {"frames": rgb[:1]}) for key, one in opened.items()}
    times = dict(zip(bare, best_ms(*bare.values(), repeats=25), strict=True))
    print("\ntrunk, ms" + "".join(f"{tap:>9s}" for tap in ALL))
    for name in trunks:
        print(f"  {name:12s}" + "".join(f"{times[name, tap]:9.2f}" for tap in ALL))
    whole = opened["fp16 stored", "layer3"]
    maps = [whole.run(list(ALL), {"frames": rgb[i : i + 1]}) for i in range(PRESSES)]
    features = {tap: np.concatenate([m[i] for m in maps]) for i, tap in enumerate(ALL)}
    print(
        f"{'':12s}{'precision':>12s}{'trunk':>8s}{'head':>8s}{'both':>8s}{'x trunk':>9s}{'x whole trunk':>15s}"
    )
    for method in METHODS:
        detector = registry.detector(method)
        parameters = detector.parameters()
        taps = detector.taps(parameters)
        grid = Grid((224, 224), {tap: features[tap].shape[1:] for tap in taps}, 15.77)
        bank = fitted(detector, parameters, Nominal({tap: features[tap] for tap in taps}), grid)
        head = session(detector.head(grid, bank, parameters))
        feeds = {
            i.name: features[i.name][:1] if i.name in features else bank.arrays[i.name]
            for i in head.get_inputs()
        }
        run_head = bound(head, feeds)
        for name in trunks:
            needed, all_taps = bare[name, max(taps)], bare[name, "layer3"]
            trunk, taken, complete = best_ms(needed, run_head, all_taps, repeats=15)
            both = trunk + taken
            print(
                f"{method:12s}{name:>12s}{trunk:8.2f}{taken:8.2f}{both:8.2f}{both / trunk:9.2f}{both / complete:15.2f}"
            )
    assert set(times) == set(opened)
