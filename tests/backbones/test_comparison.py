"""The backbones for comparison: their weights and their graphs."""

from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_trunk import features_of

from edge.core.errors import ConfigError
from plugins.backbones.efficientnet_lite0 import (
    BLOCKS,
    FILE,
    MEAN,
    NORM_EPS,
    PACKAGE,
    STD,
    TAPS,
    MBConv,
    efficientnet_lite0,
    installed_weights,
)
from plugins.backbones.random import RandomBackbone, wide_resnet50_2_random


def test_lite0_answers_as_every_trunk_does(package: None) -> None:
    """Frames uint8 of any size to taps at strides 4, 8 and 16."""
    found = features_of(efficientnet_lite0.trunk(), np.full((2, 64, 96, 3), 128, np.uint8))

    assert {tap: found[tap].shape for tap in TAPS} == {
        "layer1": (2, 24, 16, 24),
        "layer2": (2, 40, 8, 12),
        "layer3": (2, 112, 4, 6),
    }
    with pytest.raises(ConfigError, match="gives layer1, layer2, layer3, requested were layer4"):
        efficientnet_lite0.trunk(("layer4",))


@pytest.mark.train
@pytest.mark.parametrize(("tap", "moved"), [("layer1", 3), ("layer2", 7), ("layer3", 15)])
def test_lite0_is_the_original_network_on_a_moved_picture(package: None, tap: str, moved: int) -> None:
    """Away from the border, the features are those of the network with TensorFlow's padding, within 1e-4."""
    import torch

    rgb = np.random.default_rng(0).integers(0, 256, (1, 512, 512, 3), dtype=np.uint8)
    at = np.zeros_like(rgb)
    at[:, moved:, moved:] = rgb[:, :-moved, :-moved]
    planes = torch.from_numpy(((at.astype(np.float32) - MEAN) / STD).transpose(0, 3, 1, 2).copy())

    expected = _original(torch, planes, TAPS[tap]).numpy()
    found = features_of(efficientnet_lite0.trunk(), rgb)[tap]

    middle = slice(found.shape[2] * 3 // 8, found.shape[2] * 5 // 8)
    difference = np.abs(found - expected)[..., middle, middle].max()
    assert difference < 1e-4 * np.abs(expected).max()


def _original(torch: Any, x: Any, last: int) -> Any:
    """The network in torch's own operations, from the package's file as torch reads it."""
    f = torch.nn.functional
    file = next(one for one in distribution(PACKAGE).files or () if one.name == FILE)
    state = torch.load(file.locate(), weights_only=True)

    def conv(x: Any, name: str, norm: str, stride: int, group: int) -> Any:
        weight = state[f"{name}.weight"]
        most = max((x.shape[2] - 1) // stride * stride + weight.shape[2] - x.shape[2], 0)
        y = f.conv2d(
            f.pad(x, [most // 2, most - most // 2] * 2), weight, stride=stride, groups=group
        )  # TensorFlow's SAME
        parts = [state[f"{norm}.{part}"] for part in ("running_mean", "running_var", "weight", "bias")]
        return f.batch_norm(y, *parts, eps=NORM_EPS)

    def block(x: Any, block: MBConv, name: str) -> Any:
        y = x
        if block.factor != 1:
            y = f.relu6(conv(y, f"{name}._expand_conv", f"{name}._bn0", 1, 1))
        y = f.relu6(conv(y, f"{name}._depthwise_conv", f"{name}._bn1", block.stride, y.shape[1]))
        y = conv(y, f"{name}._project_conv", f"{name}._bn2", 1, 1)
        return y + x if y.shape == x.shape else y

    x = f.relu6(conv(x, "_conv_stem", "_bn0", 2, 1))
    for index in range(last + 1):
        x = block(x, BLOCKS[index], f"_blocks.{index}")
    return x


@pytest.mark.train
def test_the_file_is_read_as_torch_reads_it(package: None) -> None:
    import torch

    file = next(one for one in distribution(PACKAGE).files or () if one.name == FILE)
    expected = torch.load(file.locate(), weights_only=True)

    found = installed_weights()

    assert found.keys() == expected.keys()
    assert all(np.array_equal(found[name], value.numpy()) for name, value in expected.items())


def test_without_the_package_the_extra_is_named() -> None:
    """One sentence with the file, the package and the command that installs it."""
    with pytest.raises(ConfigError, match=rf"{FILE} of the package no-such-package.*gelgate\[comparison\]"):
        installed_weights("no-such-package")


def test_another_file_of_the_same_name_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "other_weights-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other-weights\nVersion: 1\n")
    (info / "RECORD").write_text(f"{FILE},,\n")
    (tmp_path / FILE).write_bytes(b"other weights")
    monkeypatch.syspath_prepend(tmp_path)

    with pytest.raises(ConfigError, match=r"has the SHA-256 .*, expected 579344248a93e230"):
        installed_weights("other-weights")


def test_random_weights_say_that_they_are_random() -> None:
    """In the facts that rows and manifests record; the seed fixes them."""
    assert wide_resnet50_2_random.facts()["weights"] == "random weights, seed 0"
    first, again, other = (RandomBackbone("r", "resnet18", seed).trunk(("relu",)) for seed in (0, 0, 1))
    assert first == again != other
