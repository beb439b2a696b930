"""Training that rounds: what onnxruntime computes in int8, with gradients that pass."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from emulated_processor import needs_emulator, run_on_haswell
from numpy.typing import NDArray
from trunk_state import state_arrays

from calibration.training import package as packaging
from calibration.training.checkpoint import load, weights_sha256
from calibration.training.network import TrunkNetwork
from calibration.training.quantisation import rounded_activation, rounded_maps, rounded_weight
from calibration.training.train import TrainingRun, train
from calibration.training.train_config import STAGES, TrainConfig
from edge.core.errors import ConfigError
from edge.model.session import open_session
from plugins.backbones.resnet import build_trunk


def run_here(graph: bytes, inputs: Mapping[str, NDArray[Any]], folder: Path) -> list[NDArray[Any]]:
    """Opened as the gateway opens it: with wide sums where this processor's narrow ones saturate."""
    return list(open_session(graph, 1, "int8 trunk").run(None, dict(inputs)))


@pytest.mark.parametrize("run", [run_here, pytest.param(run_on_haswell, marks=needs_emulator)])
def test_it_loses_what_onnxruntime_loses(
    trunk: TrunkNetwork,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    run: Callable[..., list[NDArray[Any]]],
) -> None:
    """At each tap the rounded maps have 256 values at most and err by as much as the int8 graph does, within a
    twentieth, in the same direction more than by chance. They cannot be equal, because one takes its range from rounded
    values and the other from exact ones. This holds with VNNI and without.
    """
    frames = np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)
    monkeypatch.setattr(packaging, "calibration_frames", lambda *_: iter([frames]))
    graph = packaging.quantised(build_trunk(state_arrays(trunk), "resnet18", STAGES))
    int8 = run(graph, {"frames": frames}, tmp_path)
    planes = torch.from_numpy(frames).permute(0, 3, 1, 2).float()
    with torch.no_grad():
        ours, plain = rounded_maps(trunk, planes), trunk(planes)
    for found, rounded, own in zip(int8, ours, plain, strict=True):
        assert len(rounded.unique()) <= 256
        theirs, mine = (found - own.numpy()).ravel(), (rounded - own).numpy().ravel()
        assert np.linalg.norm(mine) == pytest.approx(np.linalg.norm(theirs), rel=0.05)
        assert mine @ theirs > 0.2 * np.linalg.norm(mine) * np.linalg.norm(theirs)


def test_values_are_steps_and_gradients_pass() -> None:
    """256 levels with zero among them, 255 per output channel, and a gradient of one."""
    x = torch.linspace(-1, 3, 5000, requires_grad=True)
    levels = rounded_activation(x)
    assert len(levels.detach().unique()) == 256
    assert (levels == 0).any()
    assert (levels - x).abs().max() <= 4 / 255
    levels.sum().backward()
    assert torch.equal(x.grad, torch.ones_like(x))
    weight = torch.randn(4, 8, 3, 3) * torch.tensor([1e-3, 1.0, 10.0, 0.0]).view(4, 1, 1, 1)
    steps = rounded_weight(weight)
    for ours, theirs in zip(steps, weight, strict=True):
        assert (ours - theirs).abs().max() <= theirs.abs().max() / 254 * 1.001


def test_a_run_rounds_and_keeps_the_statistics(tmp_path: Path) -> None:
    """Weights move, the batch norms' means and variances do not; without a start it is refused."""
    small = {"pairs": 2, "side": 64, "precision": "float32"}
    first = train(TrainConfig.shipped(steps=2, **small), TrainingRun(tmp_path / "first")).parent
    start = weights_sha256(first)
    aware = TrainConfig.shipped(steps=2, start=start, **(small | {"precision": "int8"}))
    train(aware, TrainingRun(tmp_path / "second", start=first))
    before, after = (packaging.trunk_state(load(run).weights) for run in (first, tmp_path / "second"))
    same = {name for name in before if np.array_equal(before[name], after[name])}
    assert same == {name for name in before if "running" in name}
    with pytest.raises(ConfigError, match="a run to start from"):
        TrainConfig.shipped(precision="int8")
