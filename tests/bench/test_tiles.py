"""What a 1280x720 press costs, of which the part touches a piece: milliseconds against the bare trunk, and memory.

Budget: at most 1.3 times the bare trunk over the area that the part touches. The bare trunk runs over the rectangle
around the touched area in one piece; everything is timed in turn, medians. Overlap has a floor: 32 tiles of 224 hold
1.74 times the pixels of the frame, so where every pixel counts once the region is inspected in one piece.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import onnxruntime as ort
import pytest

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.imaging.tiles import tiling
from edge.model.scorer import Scorer
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk
from plugins.backbones.tiled import tile_trunk
from plugins.detectors.baselines.subspace import subspace
from plugins.detectors.padim import padim

pytestmark = pytest.mark.bench

W, H = 1280, 720
# The part touches a quarter of the frame, in its middle: 640x384 pixels are 10 mm by 6 mm.
TOUCHED = Region(320, 160, 640, 384)
THREADS = 2
ROUNDS = 9
PRESSES = 4


def pictures(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """n nominal presses and three frames of the free gel, uint8 (n, 720, 1280, 3)."""
    part, own = np.random.default_rng(0), np.random.default_rng(seed)
    gel = cv2.resize(
        part.integers(90, 150, (3, 4, 3)).astype(np.float32), (W, H), interpolation=cv2.INTER_CUBIC
    )
    relief = cv2.resize(
        part.integers(-60, 60, (24, 40, 3)).astype(np.float32), (TOUCHED.width, TOUCHED.height)
    )
    frames = gel + own.normal(0, 1.5, (n + 3, H, W, 3)).astype(np.float32)
    for frame in frames[:n]:
        TOUCHED.crop(frame)[...] += relief + own.normal(0, 8)
    rgb = np.clip(frames, 0, 255).astype(np.uint8)
    return rgb[:n], rgb[n:]


def scorer(detector: Any, trunk: bytes, region: Region, is_skipping: bool = True) -> Scorer:
    """A detector fitted on the region, or on its tiles for a tiled trunk."""
    frames, gel = pictures(PRESSES, 1)
    touched = np.zeros((H, W), bool)
    TOUCHED.crop(touched)[...] = True
    presses = NominalPresses(
        np.stack([region.crop(f) for f in frames]),
        ("",) * PRESSES,
        touched=region.crop(touched).copy(),
        no_contact=np.stack([region.crop(f) for f in gel]),
    )
    config = FitConfig(
        part="bench",
        position="any",
        profile=SensorProfile("bench", (W, H), (0.0, 0.0), (W, H), 1, 63.0),
        region=region,
        detector=detector,
        trunk=Trunk("bench", trunk),
        threshold=1.0,
        threads=THREADS,
    )
    bundle = fit_files(presses, config, created="bench").bundle()
    return Scorer(bundle, THREADS, is_skipping=is_skipping)


def bare(trunk: bytes, frame: np.ndarray) -> Callable[[], object]:
    """One run of a trunk, its outputs bound."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = THREADS
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = ort.InferenceSession(trunk, options, providers=["CPUExecutionProvider"])
    binding = session.io_binding()
    binding.bind_cpu_input("frames", np.ascontiguousarray(frame[None]))
    for output in session.get_outputs():
        binding.bind_output(output.name, "cpu")
    return lambda: session.run_with_iobinding(binding)


@pytest.mark.parametrize("detector", [padim, subspace], ids=lambda d: d.name)
def test_a_large_frame_against_the_bare_trunk(detector: Any) -> None:
    """Prints one row per trunk and frame size."""
    trunk = build_trunk(random_state("resnet18"), "resnet18", ("layer1", "layer2"))
    tiled, frame = tile_trunk(trunk, tiling((H, W))), pictures(1, 2)[0][0]
    whole = Region.full((W, H))
    scorers = {
        "tiles, those without contact skipped": (scorer(detector, tiled, whole), frame),
        "tiles, all 32": (scorer(detector, tiled, whole, is_skipping=False), frame),
        "one piece, the touched rectangle": (scorer(detector, trunk, TOUCHED), TOUCHED.crop(frame).copy()),
        "one piece, the whole frame": (scorer(detector, trunk, whole), frame),
    }
    works: dict[str, Callable[[], object]] = {
        "bare trunk over the touched rectangle": bare(trunk, TOUCHED.crop(frame)),
        "bare trunk over the whole frame": bare(trunk, frame),
    }
    for name, (each, rgb) in scorers.items():
        works[name] = lambda each=each, rgb=rgb: each.score(rgb)  # type: ignore[misc]
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for number in range(ROUNDS + 1):
        for name, work in works.items():
            start = time.perf_counter()
            work()
            if number:
                seconds[name].append(time.perf_counter() - start)
    medians = {name: float(np.median(found)) for name, found in seconds.items()}
    one = medians["bare trunk over the touched rectangle"]
    print(f"\n{detector.name}, random resnet18, 1280x720, touched 640x384")
    for name, median in medians.items():
        runs = scorers[name][0].tiles_run if name in scorers else 0
        note = ""
        if runs:
            before = runs
            scorers[name][0].score(frame)
            note = f"  {scorers[name][0].tiles_run - before} tiles"
        bank = ""
        if name in scorers and scorers[name][0].bundle.manifest.cost is not None:
            cost = scorers[name][0].bundle.manifest.cost
            bank = f"  bank {cost.bank_bytes_stored / 1e6:6.2f} MB"  # type: ignore[union-attr]
        print(
            f"  {name:40s}{1e3 * median:9.1f} ms  x{median / one:5.2f} of the touched rectangle's{bank}{note}"
        )
    assert medians["tiles, those without contact skipped"] > 0


MEMORY = """
import sys
import numpy as np
import onnxruntime as ort
from edge.core.imaging.tiles import tiling
from edge.model.session import open_session
from edge.model.tile_runner import TiledMaps, TileRunner
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk
from plugins.backbones.tiled import mosaic_trunk, tile_trunk

def peak_mb():
    return next(int(line.split()[1]) / 1024 for line in open("/proc/self/status") if line.startswith("VmHWM"))

way, tiles = sys.argv[1], tiling((720, 1280))
trunk = build_trunk(random_state("resnet18"), "resnet18", ("layer1", "layer2"))
frame = np.random.default_rng(0).integers(0, 256, (1, 720, 1280, 3), dtype=np.uint8)
maps = {"layer1": (64, 56 * 4, 56 * 8), "layer2": (128, 28 * 4, 28 * 8)}
session = open_session((mosaic_trunk if way == "batch" else tile_trunk)(trunk, tiles), 2, way)
before = peak_mb()
if way == "batch":
    session.run(["layer1", "layer2"], {"frames": frame})
else:
    shown = TiledMaps(TileRunner(session, tiles, maps), maps, 1)
    shown.show(frame)
    shown.show(frame)
print(peak_mb() - before)
"""


def test_memory_of_tiles() -> None:
    """One tile at a time and 32 in one batch: the growth of the process after opening the session, in MB."""
    grown = {
        way: float(
            subprocess.run(
                [sys.executable, "-c", MEMORY, way], capture_output=True, check=True, text=True
            ).stdout
        )
        for way in ("one by one", "batch")
    }
    print("\n32 tiles of 224, resnet18 to layer2, memory beyond the open trunk: " + str(grown))
    assert grown["one by one"] < grown["batch"] / 2
