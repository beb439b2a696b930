"""Equal seeds give equal bytes, whatever vector instructions the processor offers."""

import os
import subprocess
import sys

SCRIPT = """
import hashlib, sys, tempfile
from pathlib import Path
from calibration.simulator.scene import load_scene
from calibration.simulator.motion import Motion
from calibration.simulator.dataset_writer import simulate_dataset
from calibration.simulator.record import simulate_recording
from calibration.simulator.effects import EFFECTS
from calibration.simulator.field_of_view import LR, native_field
from calibration.simulator.parts import PARTS
from calibration.simulator.renderer import Renderer
from calibration.simulator.streams import Streams
from calibration.simulator.random_parts import random_part
from calibration.simulator.defects import Damaged, Defect
from calibration.simulator.reproducible_math import reproducible_opencv
total = hashlib.sha256()
with reproducible_opencv():
    for number, part in enumerate(PARTS.values()):
        for field in (LR, native_field(8)) if number == 0 else (LR,):
            renderer = Renderer(field, tuple(EFFECTS), streams=Streams(number))
            sound = part.positions["pos1"]
            kind = ("dent", "burr", "abrasion", "material_loss", "impact_mark")[number]
            worn = Damaged(sound, Defect(kind, 0.7, (0.3, 1.0), 0.5, 1.0, 3))
            total.update(renderer.press(worn, 0.4, (kind,), presses=400).tobytes())
    for number in range(6):
        stream = Streams(number)
        total.update(Renderer(LR, tuple(EFFECTS), streams=stream).press(random_part(stream("part")), 0.4).tobytes())
with tempfile.TemporaryDirectory() as folder:
    simulate_dataset(load_scene("small"), Path(folder) / "set", presses=1)
    short = Motion(idle_s=0.1, approach_s=0.1, press_s=0.1, settle_s=0.1, hold_s=0.1, lift_s=0.05, tail_s=0.1)
    scene = load_scene("demo").model_copy(update={"motion": short})
    simulate_recording(scene, Path(folder) / "run", presses=1)
    for path in sorted(Path(folder).rglob("*.*")):
        total.update(path.read_bytes() if path.is_file() else b"")
sys.stdout.write(total.hexdigest())
"""


def digest(**settings: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, **settings},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout


def test_fewer_vector_instructions_give_the_same_pictures() -> None:
    """Every effect on every part, damaged and random ones, and files: one digest with and without them."""
    assert digest() == digest(
        OPENCV_IPP="disabled",
        OPENCV_CPU_DISABLE="AVX,AVX2,FMA3,AVX512-SKX,AVX512-ICL",
        OMP_NUM_THREADS="1",
        NPY_DISABLE_CPU_FEATURES="X86_V3 X86_V4 AVX512_ICL",
        OPENBLAS_CORETYPE="Nehalem",
    )
