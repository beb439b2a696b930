"""Networks that the installed anomalib trains and exports to ONNX, wrapped, and run by the gateway."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from anomalib_files import interpreter, made_by_anomalib
from command_line import gelgate, ran
from numpy.typing import NDArray
from station import gel, jpeg, station_config

from edge.model.bundle import Bundle
from export.parity import Stage, compare, order_stage

pytestmark = pytest.mark.importers

ONNX = {"formats": ["onnx"]}
GOOD, BAD = 10, 2
# Size (h, w) of the network's pictures, and anomalib's arguments; the smallest that these networks take.
NETWORKS: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {
    "stfpm": ((64, 64), ONNX),
    "supersimplenet": ((128, 128), {"backbone": "resnet18.tv_in1k", "epochs": 10, **ONNX}),
    "dinomaly": ((64, 64), {"encoder_name": "vit_small_patch14_reg4_dinov2", "crop_size": 56, **ONNX}),
    "efficient_ad": ((256, 256), ONNX),
}
# Two runtimes, float32, relative to the largest score: measured 2e-7 to 4e-6.
ALIKE = 1e-4


@dataclass(frozen=True)
class Pressed:
    """Presses as anomalib read them, and a recording of the same ones."""

    folder: Path
    recording: Path

    @property
    def nominal(self) -> Path:
        return self.folder / "pictures" / "good"


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> Pressed:
    folder = tmp_path_factory.mktemp("networks")
    rng = np.random.default_rng(0)
    for name in ("pictures/good", "pictures/bad", "shown"):
        (folder / name).mkdir(parents=True)
    (folder / "free.jpg").write_bytes(jpeg(gel(rng)))
    for number in range(GOOD + BAD):
        sent = jpeg(gel(rng, 1.0, number >= GOOD))
        (folder / "shown" / f"{number:03}.jpg").write_bytes(sent)
        part = "good" if number < GOOD else "bad"
        shown = cv2.imdecode(np.frombuffer(sent, np.uint8), cv2.IMREAD_COLOR)
        cv2.imwrite(str(folder / "pictures" / part / f"{number:03}.png"), shown)
    ran("record", folder / "recording", "--from-images", folder / "shown", "--reference", folder / "free.jpg",
        "--profile", "cropped_lr")  # fmt: skip
    return Pressed(folder, folder / "recording")


def results(folder: Path) -> list[dict[str, Any]]:
    """The payloads of the presses, in their order."""
    lines = [
        json.loads(line) for file in sorted(folder.rglob("*.jsonl")) for line in file.read_text().splitlines()
    ]
    return [
        one["payload"] for one in lines if one["topic"].endswith("result") and "press_id" in one["payload"]
    ]


@pytest.mark.parametrize("name", NETWORKS)
def test_the_gateway_gives_the_scores_of_the_network(name: str, pressed: Pressed, tmp_path: Path) -> None:
    """Input and outputs are found, the scores are anomalib's before its normalisation, the threshold is from presses.
    The networks are hardly trained: a network whose scores fall with a painted square is refused first."""
    size, options = NETWORKS[name]
    made = made_by_anomalib(pressed.folder, {name: dict(options)}, size, interpreter())
    expected = np.load(made / f"{name}.npz")["exported_score"].astype(np.float64)
    wrap = (
        "bundle", "wrap", made / f"{name}_onnx" / "model.onnx", pressed.nominal, "-o", tmp_path / "bundle",
        "--part", "bolt", "--licence", "own", "--profile", "cropped_lr", "--region", "full",
    )  # fmt: skip

    first = gelgate(*wrap)
    sign = -1.0 if "pass --negate" in first.err else 1.0
    said = first.out if sign > 0 else ran(*wrap, "--negate")
    assert sign < 0 or first.code == 0, first.err
    ran("run", "--config", station_config(tmp_path / "station", pressed.recording, tmp_path / "bundle"))

    payloads = results(tmp_path / "station")
    scores: NDArray[np.float64] = np.array([one["score"] for one in payloads], np.float64)
    stages = [Stage("score", sign * expected, scores, "score", ALIKE), order_stage(sign * expected, scores)]
    compare(stages).raise_if_different()
    assert "input: input, nchw, float32, 0..1 (an export of anomalib" in said
    assert "outputs: map anomaly_map, score pred_score" in said
    assert "normalisation: left out: " in said
    threshold = Bundle.load(tmp_path / "bundle").manifest.threshold
    assert threshold.method.startswith("split-conformal")
    assert threshold.value > scores[:GOOD].max()
    print(
        f"\n{name}: {len(scores)} presses, largest difference {np.abs(scores - sign * expected).max():.2g} of "
        f"{np.abs(expected).max():.4g}, {'as it is' if sign > 0 else 'negated'}"
    )
