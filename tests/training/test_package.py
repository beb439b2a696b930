"""Packaging: graphs equal to the trained network, variants of limited size, and a model card made of facts."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest
import torch
from command_line import gelgate

from calibration.quantise import quantise_graph
from calibration.training import package as packaging
from calibration.training.network import TrunkNetwork
from calibration.training.train_config import STAGES
from plugins.backbones.resnet import build_trunk


def state_arrays(trunk: TrunkNetwork) -> dict[str, np.ndarray]:
    """Return the weights under torchvision's names, float32, without batch counters."""
    return {
        name: value.detach().float().cpu().numpy().copy()
        for name, value in trunk.state_dict().items()
        if not name.endswith("num_batches_tracked")
    }


def run(graph: bytes, frames: np.ndarray) -> list[np.ndarray]:
    session = ort.InferenceSession(graph, providers=["CPUExecutionProvider"])
    answer: list[np.ndarray] = session.run(list(STAGES), {"frames": frames})
    return answer


def test_the_graph_is_the_network(trunk: TrunkNetwork) -> None:
    """The ONNX trunk answers as torch does, to 1e-4 of the largest feature, at two sizes."""
    graph = build_trunk(state_arrays(trunk), "resnet18", STAGES)
    for side in (64, 96):
        frames = np.random.default_rng(side).integers(0, 256, (2, side, side, 3), dtype=np.uint8)
        with torch.no_grad():
            expected = trunk(torch.tensor(frames.tolist(), dtype=torch.float32).permute(0, 3, 1, 2))
        for found, wanted in zip(run(graph, frames), expected, strict=True):
            assert np.abs(found - wanted.numpy()).max() < 1e-4 * float(wanted.max())


def test_int8_keeps_inputs_outputs_and_features(trunk: TrunkNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    """The int8 trunk takes the same frames and gives the same taps within a fifth, in a third of the bytes."""

    def few(purpose: str, batches: int, pairs: int = 2) -> Iterator[np.ndarray]:
        rng = np.random.default_rng(batches)
        return iter([rng.integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)])

    monkeypatch.setattr(packaging, "calibration_frames", few)
    plain = build_trunk(state_arrays(trunk), "resnet18", STAGES)
    small = quantise_graph(plain, next(few("calibrate", 1)))
    assert len(small) < len(plain) / 3
    assert len(small) < packaging.MOST_BYTES
    errors = packaging.feature_errors(small, plain)
    assert list(errors) == list(STAGES)
    assert 0 < max(errors.values()) < 0.2
    half = build_trunk(state_arrays(trunk), "resnet18", STAGES, weights="float16")
    assert len(half) < packaging.MOST_BYTES
    assert max(packaging.feature_errors(half, plain).values()) < 0.005


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file and --set give the recipe: one small step runs, a second start in the same folder is refused, and a
    missing torch names the extra."""
    recipe, run = tmp_path / "small.toml", tmp_path / "run"
    recipe.write_text("steps = 1\npairs = 1\nside = 32\n")
    small = ("lab", "train-backbone", run, "--recipe", recipe, "--set", "side=64", "--device", "cpu")
    odd = gelgate(*small, "--set", "side=100")
    assert (odd.code, "'side' is 100" in odd.err, run.exists()) == (3, True, False)
    for words, code, said in (
        ((), 0, "step 1/1"),
        ((), 3, "already holds a run"),
        (("--resume", "--set", "seed=1"), 3, "seed: 1, not 0"),
    ):
        done = gelgate(*small, *words)
        assert (done.code, said in done.err) == (code, True)
    for name in [n for n in sys.modules if n.startswith("calibration.training.t")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    bare = gelgate(*small)
    assert (bare.code, "pip install 'gelgate[train]'" in bare.err) == (3, True)
