"""What each method's head costs beside its trunk, interleaved in one run so that the ratio holds on a busy machine.

Per method and mode: milliseconds of the head, (trunk + head) / trunk, bytes of the bank as stored and as
held, and the fit in times of extracting the features. Budget: 1.25 times the trunk, or the trunk and 3 ms below 12 ms.
"""

import time
from collections.abc import Callable

import numpy as np
import onnxruntime as ort
import pytest
from heads import RESNET18, fit, grid, presses_of

from edge.core.detector import Bank
from edge.packing import pack
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.patchcore import patchcore
from plugins.detectors.spade import spade
from plugins.detectors.subspace import subspace

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


def stored_bytes(bank: Bank) -> int:
    total = 0
    for name, array in bank.arrays.items():
        packed = pack(array, bank.packing.get(name, "none"))
        total += packed.data.nbytes + (0 if packed.scale is None else packed.scale.nbytes)
    return total


@pytest.mark.bench
@pytest.mark.parametrize(
    ("name", "taps", "presses"), [("resnet18", RESNET18, 40), ("wide_resnet50_2", WIDE_RESNET50, 20)]
)
def test_heads_beside_their_trunk(name: str, taps: dict[str, tuple[int, int, int]], presses: int) -> None:
    """Prints one line per operating point."""
    nominal, asked = presses_of(presses, 0, taps), presses_of(1, 1, taps)
    frames = np.random.default_rng(0).integers(0, 256, (1, 224, 224, 3), dtype=np.uint8)
    runs = {"trunk": bound(build_trunk(random_state(name), name, tuple(taps)), {"frames": frames})}
    notes: dict[str, tuple[float, int, int]] = {}
    for detector, mode, choice in POINTS:
        p = detector.parameters(mode, **choice)
        began = time.perf_counter()
        bank = fit(detector, p, nominal, grid(taps))
        label = f"{detector.name} {mode}"
        held = sum(array.nbytes for array in bank.arrays.values())
        notes[label] = (time.perf_counter() - began, stored_bytes(bank), held)
        runs[label] = bound(detector.head(grid(taps), bank, p), {**asked, **bank.arrays})
    seconds: dict[str, list[float]] = {label: [] for label in runs}
    for run in runs.values():
        run()
    for _ in range(ROUNDS):
        for label, run in runs.items():
            if len(seconds[label]) >= 3 and min(seconds[label]) > SLOW_S and label != "trunk":
                continue
            began = time.perf_counter()
            run()
            seconds[label].append(time.perf_counter() - began)
    trunk = min(seconds["trunk"])
    print(f"\n{name}: trunk {1e3 * trunk:.1f} ms, {presses} presses")
    for label, (fit_s, stored, held) in notes.items():
        head = min(seconds[label])
        print(
            f"  {label:20s} head {1e3 * head:7.2f} ms  with trunk x{1 + head / trunk:.2f}  "
            f"bank {stored / 1e6:6.2f} MB stored {held / 1e6:7.2f} MB held  "
            f"fit x{fit_s / (presses * trunk):.2f} of extraction"
        )
    assert set(notes) < set(runs)
