"""Bundles and trunks that were made on x86_64 score the same on aarch64, emulated by qemu: `make test-aarch64`."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from edge.model.session import open_session

pytestmark = pytest.mark.aarch64

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
BUNDLES = (*sorted((HERE / "golden/bundles").iterdir()), HERE / "version_0_1_0/bundle")
TRUNKS = tuple(sorted((ROOT / "plugins/backbones").glob("*.onnx")))

# The processor that onnxruntime reads there; from that of the emulator's machine it ends with a crash.
PROCESSOR = (
    "processor : 0\nFeatures : fp asimd\nCPU implementer : 0x41\nCPU architecture: 8\nCPU part : 0xd0c\n\n"
)
PROGRAM = """
import json, sys
from pathlib import Path
import numpy as np
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.model.session import open_session
frames, trunks, *bundles = sys.argv[1:]
for path in bundles:
    scorer = Scorer(Bundle.load(Path(path)), threads=1)
    print(json.dumps([path, scorer.check_golden(), [frame.score for frame in scorer.bundle.golden]]))
for path in sorted(Path(trunks).glob("*.onnx")):
    session = open_session(path.read_bytes(), 1, path.name)
    np.savez(Path(frames).parent / path.stem, *session.run(None, {"frames": np.load(frames)}))
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, tuple[float, list[float]]], Path]:
    """What one emulated process has found: of each bundle its difference and golden scores, and files of features."""
    emulator, made = shutil.which("qemu-aarch64"), Path(os.environ.get("GELGATE_AARCH64", "nowhere"))
    if emulator is None or not (made / "site/onnxruntime").is_dir():
        pytest.skip(
            "SKIPPED, NOT TESTED: `make test-aarch64` makes the packages where apt and PyPI have them"
        )
    system, out = made / "root", tmp_path_factory.mktemp("aarch64")
    (system / "proc").mkdir(exist_ok=True)
    (system / "proc/cpuinfo").write_text(PROCESSOR, encoding="ascii")
    np.save(out / "frames.npy", np.random.default_rng(0).integers(0, 256, (1, 224, 224, 3), np.uint8))

    (python,) = (system / "usr/bin").glob("python3.[0-9]*[0-9]")
    words = [emulator, "-L", system, python, "-c", PROGRAM, out / "frames.npy", TRUNKS[0].parent, *BUNDLES]
    places = {"PYTHONHOME": str(system / "usr"), "PYTHONPATH": f"{ROOT}:{made / 'site'}"}
    done = subprocess.run(
        [str(word) for word in words], env=os.environ | places, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    return {path: (difference, scores) for path, difference, scores in lines}, out


@pytest.mark.parametrize("bundle", BUNDLES, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_golden_presses_score_the_same(
    answers: tuple[dict[str, tuple[float, list[float]]], Path], bundle: Path
) -> None:
    """The station's own check passes there, and no score differs by more than float32 rounding."""
    difference, scores = answers[0][str(bundle)]

    assert len(scores) == 3
    assert difference <= 1e-5 * max(scores)


@pytest.mark.parametrize("trunk", TRUNKS, ids=lambda path: path.stem)
def test_features_are_the_same(
    answers: tuple[dict[str, tuple[float, list[float]]], Path], trunk: Path
) -> None:
    """Of every trunk that comes with the program, those in int8 too."""
    session = open_session(trunk.read_bytes(), 1, trunk.name)
    expected = session.run(None, {"frames": np.load(answers[1] / "frames.npy")})

    with np.load(answers[1] / f"{trunk.stem}.npz") as found:
        for name, features in zip(found.files, expected, strict=True):
            np.testing.assert_allclose(found[name], features, rtol=0, atol=1e-4 * np.abs(features).max())
