"""The trunk for real touch: its bytes, and its channels against the originals."""

import hashlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import gelgate
from graph_session import open_graph

from calibration.fitting.trunks import open_trunk
from calibration.training.package import MOST_BYTES
from edge import registry
from edge.core.errors import ConfigError
from plugins.backbones.efficientnet_lite0 import efficientnet_lite0
from plugins.backbones.input_steps import IMAGENET
from plugins.backbones.tactile import tactile_resnet18
from plugins.backbones.tactile_lite0 import tactile_lite0

HOME = Path(__file__).parents[2] / "plugins" / "backbones"
FACTS = json.loads((HOME / "tactile_lite0.json").read_text())
EVALUATION = json.loads((HOME / "tactile_lite0_evaluation.json").read_text())
TAPS = ["layer1", "layer2", "layer3"]
FRAMES = np.random.default_rng(0).integers(0, 256, (2, 64, 96, 3), dtype=np.uint8)


def run(trunk: bytes) -> list[np.ndarray[Any, Any]]:
    session = open_graph(trunk)
    found: list[np.ndarray[Any, Any]] = session.run(TAPS, {"frames": FRAMES})
    return found


def test_it_is_installed_with_the_bytes_of_its_facts() -> None:
    """Users find it by name, within the limit of a trunk; its licence goes into the manifest."""
    assert registry.backbone("tactile_lite0") is tactile_lite0
    trunk = open_trunk("tactile_lite0")
    assert hashlib.sha256(trunk.graph).hexdigest() == FACTS["sha256"]
    assert len(trunk.graph) == FACTS["bytes"] <= MOST_BYTES
    assert trunk.facts["licence"] == "Apache-2.0"


def test_it_answers_as_every_trunk_does() -> None:
    """Frames uint8 to taps at strides 4, 8 and 16; another tap is refused. Cut after layer1, what the detectors read by
    default, it is smaller than the default cut there."""
    small, usual = (
        len(open_trunk(name, ("layer1",)).graph) for name in ("tactile_lite0", "tactile_resnet18")
    )
    assert small < usual
    assert [one.shape for one in run(tactile_lite0.trunk())] == [
        (2, 64 + 24, 16, 24),
        (2, 40, 8, 12),
        (2, 112, 4, 6),
    ]
    with pytest.raises(ConfigError, match="gives layer1, layer2, layer3, requested were layer4"):
        tactile_lite0.trunk(("layer4",))


@pytest.mark.train
def test_its_tactile_channels_are_those_of_a_residual_block() -> None:
    """Within 1e-4 of torch's own operations with the same weights, after the first residual block."""
    import torch

    planes = (FRAMES / np.float32(255) - np.float32(IMAGENET.mean)) / np.float32(IMAGENET.std)
    expected = _first_block(torch, torch.from_numpy(planes.transpose(0, 3, 1, 2).astype(np.float32))).numpy()

    found = run(tactile_lite0.trunk())[0][:, :64] / FACTS["tactile_scale"]

    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def _first_block(torch: Any, x: Any) -> Any:
    import onnx
    from onnx import numpy_helper

    model = onnx.load_from_string(tactile_lite0.trunk()).graph
    stored = {one.name: numpy_helper.to_array(one) for one in model.initializer}
    halves = {node.output[0]: node.input[0] for node in model.node if node.op_type == "Cast"}
    inputs = [node.input[1:] for node in model.node if node.op_type == "Conv"]

    def conv(x: Any, number: int, stride: int) -> Any:
        weight, bias = (
            torch.from_numpy(stored[halves.get(name, name)].copy()).float() for name in inputs[number]
        )
        return torch.nn.functional.conv2d(x, weight, bias, stride, weight.shape[2] // 2)

    f = torch.nn.functional
    x = f.max_pool2d(f.relu(conv(x, 0, 2)), 3, 2, 1)
    return f.relu(conv(f.relu(conv(x, 1, 1)), 2, 1) + x)


def test_its_other_channels_are_those_of_efficientnet_lite0(package: None) -> None:
    """Bit for bit; that backbone is compared with torch in a test of its own."""
    first, second, third = run(efficientnet_lite0.trunk())
    found = run(tactile_lite0.trunk())
    assert np.array_equal(found[0][:, 64:], first)
    assert np.array_equal(found[1], second)
    assert np.array_equal(found[2], third)


def test_a_detector_is_fitted_on_it(tmp_path: Path) -> None:
    """A bundle that verifies, with the trunk's name and licence inside."""
    (tmp_path / "good").mkdir()
    for k in range(5):
        frame = np.random.default_rng(k).integers(90, 160, (240, 320, 3), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / "good" / f"{k}.png"), frame)
    bundle, region = tmp_path / "bundle", ("--region", "96,64,96x96")
    fit = gelgate(
        "fit", tmp_path / "good", "-o", bundle, "--part", "bolt", "--backbone", "tactile_lite0", *region
    )
    assert fit.code == 0, fit.err
    assert gelgate("bundle", "verify", bundle).code == 0
    shown = gelgate("bundle", "inspect", bundle).out
    assert "tactile_lite0" in shown
    assert "weights Apache-2.0" in shown


def aupro(set_name: str, backbone: str) -> dict[tuple[str, str], float]:
    """By detector and trial."""
    return {
        (row["detector"], trial): measures["aupro_fpr01"]
        for row in EVALUATION["sets"][set_name]["rows"]
        if row["backbone"] == backbone
        for trial, measures in row["trials"].items()
    }


def test_its_tables_are_of_the_bytes_that_ship() -> None:
    """The page compares this trunk with the default and with random weights, by every method."""
    assert EVALUATION["trunks"]["tactile_lite0"]["sha256"] == FACTS["sha256"]
    assert EVALUATION["trunks"]["shipped"]["sha256"] == hashlib.sha256(tactile_resnet18.trunk()).hexdigest()
    methods = set(registry.names("detectors"))
    for name in ("real-touch", "parts"):
        for backbone in ("shipped", "tactile_lite0", "efficientnet_lite0", "random"):
            assert {detector for detector, _ in aupro(name, backbone)} == methods


def test_it_leads_the_default_on_real_touch_in_every_cell() -> None:
    """Every method on every trial; on simulated parts it loses less than a fifth of that, in the mean."""
    gained, lost = (
        np.array([aupro(name, one)[cell] - aupro(name, other)[cell] for cell in aupro(name, one)])
        for name, one, other in (
            ("real-touch", "tactile_lite0", "shipped"),
            ("parts", "shipped", "tactile_lite0"),
        )
    )
    assert gained.min() > 0
    assert 0 < lost.mean() < gained.mean() / 5
