"""What each method's head costs beside its trunk, interleaved in one run so that the ratio holds on a busy machine.

Run with `pytest tests/bench/test_heads.py -m bench -s`; GELGATE_BENCH_BACKBONE names another small backbone, installed
or a trunk's file; GELGATE_BENCH_POINTS, such as `inreach,patchcore`, times only those methods. Per method and mode:
milliseconds of the head and of the trunk as the bundle runs it, cut behind the last tap that is read, their ratio and
the whole layer1 to layer3 trunk's; bytes of the bank as stored and as held. Budget: 1.25 times the trunk, or the trunk
and 3 ms below 12 ms.
"""

import os
import time
from collections.abc import Callable

import numpy as np
import onnxruntime as ort
import pytest
from heads import RESNET18, fit, grid, presses_of, stored_bytes

from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from edge.model.graph_cut import cut_trunk
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.spade import spade

BACKBONE = os.environ.get("GELGATE_BENCH_BACKBONE", DEFAULT_BACKBONE)
WIDE_RESNET50 = {"layer1": (256, 56, 56), "layer2": (512, 28, 28), "layer3": (1024, 14, 14)}
POINTS = (
    (spade, "corrected", {}),
    (spade, "paper", {}),
    (padim, "corrected", {}),
    (fapm, "corrected", {}),
    (fapm, "paper", {}),
    (inreach, "corrected", {}),
    (patchcore, "corrected", {}),
    (patchcore, "paper", {}),
    (subspace, "corrected", {}),
)
WANTED = tuple(filter(None, os.environ.get("GELGATE_BENCH_POINTS", "").split(",")))
ROUNDS = 15
# A point slower than this is timed three times only.
SLOW_S = 0.1


def bound(graph: bytes, feed: dict[str, np.ndarray]) -> Callable[[], None]:
    """One run with everything bound beforehand, two threads, as the gateway has it."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 2
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    binding = session.io_binding()
    for wanted in session.get_inputs():
        value = np.ascontiguousarray(feed[wanted.name])
        binding.bind_ortvalue_input(wanted.name, ort.OrtValue.ortvalue_from_numpy(value))
    for output in session.get_outputs():
        binding.bind_output(output.name)
    return lambda: session.run_with_iobinding(binding)


def trunk_of(name: str) -> bytes:
    """The whole trunk, layer1 to layer3; Wide-ResNet-50-2 has seeded random weights, which take as long."""
    if name == "wide_resnet50_2":
        return build_trunk(random_state(name), name, tuple(WIDE_RESNET50))
    return open_trunk(name, tuple(RESNET18)).graph


@pytest.mark.bench
@pytest.mark.parametrize(
    ("name", "taps", "presses"), [(BACKBONE, RESNET18, 40), ("wide_resnet50_2", WIDE_RESNET50, 20)]
)
def test_heads_beside_their_trunk(name: str, taps: dict[str, tuple[int, int, int]], presses: int) -> None:
    """Prints one line per operating point."""
    nominal, asked = presses_of(presses, 0, taps), presses_of(1, 1, taps)
    frames = np.random.default_rng(0).integers(0, 256, (1, 224, 224, 3), dtype=np.uint8)
    whole = trunk_of(name)
    runs, last, notes = {}, {}, {}
    for tap in taps:
        runs[tap] = bound(cut_trunk(whole, [tap]), {"frames": frames})
    for detector, mode, choice in POINTS:
        if WANTED and detector.name not in WANTED:
            continue
        p = detector.parameters(mode, **choice)
        bank = fit(detector, p, nominal, grid(taps))
        label = f"{detector.name} {mode}"
        last[label] = max(detector.taps(p))
        notes[label] = stored_bytes(bank), sum(array.nbytes for array in bank.arrays.values())
        runs[label] = bound(detector.head(grid(taps), bank, p), {**asked, **bank.arrays})
    ms = {label: 1e3 * best for label, best in best_seconds(runs).items()}
    print(f"\n{name}, {presses} presses: " + ", ".join(f"to {tap} {ms[tap]:.1f} ms" for tap in taps))
    for label, (stored, held) in notes.items():
        trunk, head = ms[last[label]], ms[label]
        budget = max(0.25 * trunk, 3.0) if trunk < 12 else 0.25 * trunk
        print(
            f"  {label:20s} head {head:7.2f} ms (budget {budget:5.2f})  "
            f"with its trunk, to {last[label]}, {trunk + head:6.1f} ms = x{1 + head / trunk:.2f}, "
            f"x{(trunk + head) / ms['layer3']:.2f} of the whole trunk  "
            f"bank {stored / 1e6:6.2f} MB stored {held / 1e6:7.2f} MB held"
        )


def best_seconds(runs: dict[str, Callable[[], None]]) -> dict[str, float]:
    """The shortest time of each, taken in turn; what is slow is timed three times only."""
    seconds: dict[str, list[float]] = {label: [] for label in runs}
    for run in runs.values():
        run()
    for _ in range(ROUNDS):
        for label, run in runs.items():
            if len(seconds[label]) >= 3 and min(seconds[label]) > SLOW_S:
                continue
            began = time.perf_counter()
            run()
            seconds[label].append(time.perf_counter() - began)
    return {label: min(each) for label, each in seconds.items()}
