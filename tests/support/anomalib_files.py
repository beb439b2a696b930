"""Files that anomalib itself wrote: the small ones in the repository, and new ones where anomalib is installed.

The small ones are of anomalib 2.7.0, on eight pictures of 64x48, ResNet-18 until layer1 with random weights:

    python tests/support/anomalib_files.py tests/export/importers/anomalib_2_7_0
"""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
SMALL = ROOT / "tests" / "export" / "importers" / "anomalib_2_7_0"
MAKER = Path(__file__).with_name("make_anomalib_files.py")
LAYER1 = {"backbone": "resnet18", "layers": ["layer1"], "formats": []}
WANTED: dict[str, dict[str, Any]] = {
    "padim": {**LAYER1, "n_features": 12, "formats": ["onnx"]},
    "patchcore": {**LAYER1, "coreset_sampling_ratio": 0.1, "formats": ["torch"]},
    "dfm": {"backbone": "resnet18", "layer": "layer1", "formats": []},
    "dfkde": {**LAYER1, "n_pca_components": 3},
}


def interpreter() -> str:
    """A Python with anomalib; skips the test where there is none."""
    named = os.environ.get("GELGATE_IMPORTERS_PYTHON", str(ROOT / ".venv-importers" / "bin" / "python"))
    if Path(named).is_file():
        return named
    if importlib.util.find_spec("anomalib") is not None:
        return sys.executable
    pytest.skip("anomalib is not installed; make test-importers makes an environment that has it")


def picture(number: int, is_bad: bool = False, size: tuple[int, int] = (48, 64)) -> NDArray[np.uint8]:
    """A smooth RGB picture (h, w, 3), with a dark square where it is bad."""
    rng = np.random.default_rng(number)
    levels = 128 + 40 * cv2.resize(rng.normal(size=(6, 8, 3)), size[::-1], interpolation=cv2.INTER_CUBIC)
    levels += 25 * np.sin(np.arange(size[1]) / 3)[None, :, None]
    if is_bad:
        levels[20:32, 24:40] *= 0.4
    return np.asarray(np.clip(levels, 0, 255), np.uint8)


def pictures(good: int = 10, bad: int = 2) -> NDArray[np.uint8]:
    """All pictures, the bad ones last."""
    return np.stack([picture(n, n >= good) for n in range(good + bad)])


def write_pictures(folder: Path, frames: NDArray[np.uint8], bad: int) -> Path:
    """`good` and `bad` as anomalib reads them."""
    for name in ("good", "bad"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(frames):
        part = "bad" if number >= len(frames) - bad else "good"
        cv2.imwrite(str(folder / part / f"{number:03}.png"), np.ascontiguousarray(frame[..., ::-1]))
    return folder


def write_weights(path: Path, topology: str = "resnet18") -> Path:
    """Random weights whose batch norms fit pictures, in half precision so that files compress."""
    from plugins.backbones.random import random_state

    state = {
        name: value.astype(np.float16).astype(np.float32) for name, value in random_state(topology).items()
    }
    np.savez(path, **state)
    return path


def made_by_anomalib(
    folder: Path, wanted: dict[str, dict[str, Any]], size: tuple[int, int], python: str
) -> Path:
    """Files of these models, trained on `folder/pictures` with `folder/weights.npz`."""
    command = [
        python,
        str(MAKER),
        str(folder / "pictures"),
        str(folder / "weights.npz"),
        str(folder / "made"),
    ]
    done = subprocess.run(
        [*command, json.dumps(wanted), f"{size[0]}x{size[1]}"], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return folder / "made"


def without_traces(path: Path) -> None:
    """The exporter notes the folders of its machine at every node; the file here has none."""
    import onnx

    from export.onnx_values import drop_traces

    model = onnx.load(path, load_external_data=False)
    drop_traces(model)
    path.write_bytes(model.SerializeToString())


def main(out: Path) -> None:
    """The small files, made again."""
    import shutil
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_pictures(folder / "pictures", pictures(), 2)
        write_weights(folder / "weights.npz")
        made = made_by_anomalib(folder, WANTED, (32, 32), interpreter())
        out.mkdir(exist_ok=True)
        for file in (
            "padim.ckpt",
            "patchcore.pt",
            "dfm.ckpt",
            "dfkde.ckpt",
            *(f"{name}.npz" for name in WANTED),
        ):
            shutil.copy(made / file, out / file)
        shutil.copytree(made / "padim_onnx", out / "padim_onnx", dirs_exist_ok=True)
        without_traces(out / "padim_onnx" / "model.onnx")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
