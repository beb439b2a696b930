"""anomalib's PaDiM and PatchCore against their bundles: the same scores, how much faster, how much smaller.

    make demo-import

trains both with the installed anomalib on simulated presses (ResNet-18 with random weights, anomalib's defaults at
256x256; PatchCore with a coreset of 1 %), imports the checkpoints, and plays the presses to a gateway on the virtual
sensor. Times are processor seconds of one thread in both programs, so that other load of the machine hardly counts.
`IMPORTED_CACHE` names a folder of files that were trained before, `IMPORTED_BACKBONE` another backbone, such as
wide_resnet50_2, for which anomalib's PaDiM has 550 channels.
"""

import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from anomalib_files import interpreter, made_by_anomalib, write_weights
from command_line import gelgate
from numpy.typing import NDArray
from station import station_config

from calibration.metrics.pixel import aupro
from calibration.simulator.field_of_view import LR
from calibration.simulator.renderer import Renderer
from calibration.simulator.scene import load_scene
from calibration.simulator.sensor_appearance import SENSORS
from calibration.simulator.streams import Streams
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.model.session import open_session
from export.importers.api import ImportedBundle, ImportOptions, import_detector
from export.importers.heads import Framing
from export.parity import rank_correlation

pytestmark = [pytest.mark.bench, pytest.mark.importers]

SIZE = tuple(int(n) for n in os.environ.get("IMPORTED_SIZE", "256x256").split("x"))
BACKBONE = os.environ.get("IMPORTED_BACKBONE", "resnet18")
WANTED = {
    "padim": {"backbone": BACKBONE, "formats": []},
    "patchcore": {
        "backbone": BACKBONE, "layers": ["layer2", "layer3"], "coreset_sampling_ratio": 0.01, "formats": [],
    },
}  # fmt: skip
AUPRO_LIMIT = 0.3


class Trained:
    """The presses, and what anomalib made of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        cache = os.environ.get("IMPORTED_CACHE")
        python = "" if cache else interpreter()
        done = gelgate("lab", "simulate", "small", "-o", folder / "dataset", "--workers", 2)
        assert done.code == 0, done.err
        self.files = sorted((folder / "dataset").glob("PZ3/pos1/rgb_320x240/*.png"))
        bad = sorted((folder / "dataset").glob("PZ3/pos1/fault/rgb_320x240/*.png"))
        for part, files in (("good", self.files), ("bad", bad)):
            (folder / "pictures" / part).mkdir(parents=True)
            for file in files:
                # The virtual sensor sends JPEG: both programs get what is left after it.
                shown = cv2.imencode(".jpg", cv2.imread(str(file)), [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
                file.with_suffix(".jpg").write_bytes(shown.tobytes())
                cv2.imwrite(
                    str(folder / "pictures" / part / file.name), cv2.imdecode(shown, cv2.IMREAD_COLOR)
                )
        self.nominal = len(self.files)
        self.files = [file.with_suffix(".jpg") for file in (*self.files, *bad)]
        self.frames = np.stack([cv2.imread(str(file))[..., ::-1] for file in self.files])
        self.masks = np.zeros(self.frames.shape[:3], bool)
        for k, file in enumerate(bad):
            mask = cv2.imread(str(file.parents[1] / "mask_320x240" / file.name), cv2.IMREAD_GRAYSCALE)
            self.masks[self.nominal + k] = mask > 0
        self.made = Path(cache) if cache else self._made(python)

    def _made(self, python: str) -> Path:
        write_weights(self.folder / "weights.npz", BACKBONE)
        return made_by_anomalib(self.folder, WANTED, SIZE, python)

    def recording(self) -> Path:
        """The presses as the virtual sensor plays them, between pictures of the untouched gel."""
        folder = self.folder / "recording"
        if not folder.exists():
            scene = load_scene("small")
            gel = Renderer(LR, scene.effects, SENSORS[scene.camera.sensor], streams=Streams(0)).free_gel()
            cv2.imwrite(str(self.folder / "free.jpg"), gel[..., ::-1])
            shown = self.folder / "shown"
            shown.mkdir()
            for k, file in enumerate(self.files):
                (shown / f"{k:03}.jpg").write_bytes(file.read_bytes())
            done = gelgate(
                "record", folder, "--from-images", shown, "--reference", self.folder / "free.jpg",
                "--profile", "cropped_lr",
            )  # fmt: skip
            assert done.code == 0, done.err
        return folder


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    return Trained(tmp_path_factory.mktemp("imported"))


@pytest.fixture(params=["padim", "patchcore"])
def made(request: pytest.FixtureRequest, trained: Trained) -> tuple[str, ImportedBundle]:
    """The bundle of one model, exact rank, the bank in float16."""
    name = str(request.param)
    options = ImportOptions("PZ3", "own", profile="cropped_lr", packing="float16", threshold="model")
    output = trained.folder / f"{name}.zip"
    presses = trained.files[: trained.nominal]
    return name, import_detector(trained.made / f"{name}.ckpt", presses, output, options, overwrite=True)


def test_the_same_scores_faster_and_smaller(trained: Trained, made: tuple[str, ImportedBundle]) -> None:
    """The order of the presses to three digits and AU-PRO to 0.001; time and bytes are printed."""
    name, bundle = made
    expected = np.load(trained.made / f"{name}.npz")
    scorer = Scorer(Bundle.load(bundle.path), threads=1)
    maps, scores, seconds = _scored(scorer, trained.frames)
    framing = Framing((240, 320), SIZE)
    drawn = framing.back(0) @ expected["score_map"].astype(np.float64) @ framing.back(1).T
    order = _order(expected, scores)
    theirs, ours = (aupro(list(one), list(trained.masks), AUPRO_LIMIT) for one in (drawn, maps))
    assert theirs is not None
    assert ours is not None
    slow, backbone = 1e3 * np.median(expected["processor_seconds"], axis=0)
    fast, trunk = 1e3 * np.median(seconds, axis=0)
    large, small = (trained.made / f"{name}.ckpt").stat().st_size, bundle.path.stat().st_size
    bank = sum(value.nbytes for key, value in _detector_arrays(trained.made / f"{name}.ckpt").items())
    print(
        f"\n{name}: order {order:.4f}, AU-PRO@{AUPRO_LIMIT} {theirs:.4f} (anomalib) {ours:.4f} (bundle)"
        f"\n  processor time of a press {slow:.0f} ms (anomalib, torch) {fast:.1f} ms (bundle): {slow / fast:.1f} times"
        f"\n  of it the backbone {backbone:.0f} ms and {trunk:.1f} ms, the rest {slow - backbone:.0f} ms and "
        f"{fast - trunk:.1f} ms"
        f"\n  files {large / 1e6:.1f} MB (checkpoint) {small / 1e6:.1f} MB (bundle): {large / small:.1f} times"
        f"\n  without backbone {bank / 1e6:.1f} MB {bundle.losses.bytes_stored / 1e6:.2f} MB: "
        f"{bank / bundle.losses.bytes_stored:.1f} times"
        f"\n  {bundle.losses.words()}\n  " + "\n  ".join(bundle.model.says)
    )
    assert order >= 0.999
    assert abs(theirs - ours) < 1e-3


def test_the_gateway_gives_the_same_order(trained: Trained, made: tuple[str, ImportedBundle]) -> None:
    """Every press of the virtual sensor has the score of anomalib, within packing, and the verdict of its threshold."""
    name, bundle = made
    expected = np.load(trained.made / f"{name}.npz")
    config = station_config(trained.folder / f"station_{name}", trained.recording(), bundle.path)

    done = gelgate("run", "--config", config)

    assert done.code == 0, done.err
    lines = [
        json.loads(line)
        for file in sorted(config.parent.rglob("*.jsonl"))
        for line in file.read_text().splitlines()
    ]
    scores = np.array([score for line in lines if (score := _score(line)) is not None])
    print(f"\n{name}: the gateway scored {len(scores)} of {len(trained.files)} presses")
    assert len(scores) == len(trained.files)
    order = _order(expected, scores)
    print(f"  order {order:.4f}")
    assert order >= 0.999


def _order(expected: Mapping[str, NDArray[Any]], scores: NDArray[np.float64]) -> float:
    """The rank correlation over the presses that the model was not fitted to. The distance of the others is (n - 1) /
    sqrt(n), all alike but for rounding, where n is less than the channels."""
    new = ~expected["trained"]
    return rank_correlation(expected["score"][new], scores[new])


def _score(line: dict[str, object]) -> float | None:
    payload = line.get("payload") if str(line.get("topic")).endswith("result") else None
    score = payload.get("score") if isinstance(payload, dict) and "press_id" in payload else None
    return float(score) if isinstance(score, int | float) else None


def _scored(
    scorer: Scorer, frames: NDArray[np.uint8]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Maps (n, h, w), scores (n,), and processor seconds (n, 2): of all, of the trunk."""
    maps, scores, seconds = [], [], []
    trunk = open_session(scorer.bundle.graphs.trunk, 1, "the trunk")
    names = [one.name for one in trunk.get_outputs()]
    for frame in frames:
        start = time.process_time()
        scored = scorer.score(frame)
        middle = time.process_time()
        trunk.run(names, {"frames": frame[None]})
        seconds.append((middle - start, time.process_time() - middle))
        maps.append(np.array(scored.score_map, np.float64))
        scores.append(scored.anomaly_score)
    return np.array(maps), np.array(scores), np.array(seconds)


def _detector_arrays(path: Path) -> dict[str, NDArray[np.float32]]:
    """A checkpoint's arrays without its backbone."""
    from plugins.reading.files import read_here

    state = read_here(path)[1]["state_dict"]
    return {
        name: value
        for name, value in state.items()
        if name.startswith("model.") and "feature_extractor" not in name
    }
