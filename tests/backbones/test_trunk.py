"""Trunks: the same feature maps as an unfolded float64 network, for every topology and tap."""

from functools import cache

import numpy as np
import onnx
import pytest
from toy_trunk import features_of

from edge.core.errors import ConfigError
from plugins.backbones.input_steps import IMAGENET, apply_steps
from plugins.backbones.random import random_state
from plugins.backbones.reference import forward
from plugins.backbones.resnet import build_trunk
from plugins.backbones.topology import State, list_shapes, list_taps, topology

TAPS = ("layer1", "layer2")


@cache
def resnet18() -> State:
    return random_state("resnet18", 3)


def frames(n: int, h: int, w: int) -> np.ndarray:
    """Random uint8 RGB (n, h, w, 3), with 0 and 255 among them."""
    return np.random.default_rng(5).integers(0, 256, (n, h, w, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    "name", ["resnet18", "resnet50", pytest.param("wide_resnet50_2", marks=pytest.mark.lab)]
)
def test_a_trunk_is_the_network(name: str) -> None:
    """Every tap, down to single blocks and avgpool, is within 1e-4 relative of float64 without folding."""
    taps = ("relu", "maxpool", "layer1.0", "layer1", "layer2", "layer3.1", "layer3", "layer4.0", "avgpool")
    state = random_state(name)
    rgb = frames(2, 32, 48)
    found = features_of(build_trunk(state, name, taps), rgb)
    expected = forward(state, name, apply_steps(IMAGENET, rgb), taps)
    assert list(found) == list(taps)
    for tap in taps:
        assert found[tap].shape == expected[tap].shape
        np.testing.assert_allclose(found[tap], expected[tap], rtol=0, atol=1e-4 * np.abs(expected[tap]).max())


@pytest.mark.train
def test_the_oracle_is_the_frameworks_network() -> None:
    """The float64 reference equals torch's own layers, composed by hand for a strided block with a shortcut."""
    import torch

    f = torch.nn.functional
    state = {key: torch.from_numpy(np.asarray(value, np.float64)) for key, value in resnet18().items()}

    def conv(x, conv, norm, stride, padding):  # type: ignore[no-untyped-def]
        y = f.conv2d(x, state[f"{conv}.weight"], stride=stride, padding=padding)
        parts = [state[f"{norm}.{part}"] for part in ("running_mean", "running_var", "weight", "bias")]
        return f.batch_norm(y, *parts)

    def block(x, name, stride):  # type: ignore[no-untyped-def]
        y = f.relu(conv(x, f"{name}.conv1", f"{name}.bn1", stride, 1))
        y = conv(y, f"{name}.conv2", f"{name}.bn2", 1, 1)
        return f.relu(
            y + (conv(x, f"{name}.downsample.0", f"{name}.downsample.1", stride, 0) if stride > 1 else x)
        )

    planes = apply_steps(IMAGENET, frames(1, 40, 36))
    x = f.max_pool2d(f.relu(conv(torch.from_numpy(planes), "conv1", "bn1", 2, 3)), 3, 2, 1)
    for name, stride in (("layer1.0", 1), ("layer1.1", 1), ("layer2.0", 2), ("layer2.1", 1)):
        x = block(x, name, stride)
    np.testing.assert_allclose(
        forward(resnet18(), "resnet18", planes, ("layer2",))["layer2"], x.numpy(), rtol=1e-10
    )


@pytest.mark.parametrize(
    ("change", "frame"),
    [
        ({}, np.zeros((1, 64, 64, 3), np.uint8)),
        ({"bn1.running_var": np.zeros(64, np.float32)}, frames(1, 32, 32)),
    ],
    ids=["black frame", "dead channel"],
)
def test_borders_and_dead_channels_are_the_oracles(change: dict[str, np.ndarray], frame: np.ndarray) -> None:
    """Padding is zero after normalising, not before, which a black frame's corner shows; variance 0 is legal, because
    the norm adds its epsilon."""
    state = {**resnet18(), **change}
    found = features_of(build_trunk(state, "resnet18", ("relu",)), frame)["relu"]
    expected = forward(state, "resnet18", apply_steps(IMAGENET, frame), ("relu",))["relu"]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * expected.max())
    assert change or np.abs(expected[..., 0, 0] - expected[..., 5, 5]).max() > 0.01


def test_one_graph_serves_every_size_and_batch() -> None:
    """n, h and w are free; a frame alone and a frame in a batch have the same features."""
    trunk = build_trunk(resnet18(), "resnet18", ("layer1", "layer3"))
    batch = frames(3, 64, 96)
    together, alone = features_of(trunk, batch), features_of(trunk, batch[1:2])
    assert together["layer3"].shape == (3, 256, 4, 6)
    np.testing.assert_allclose(together["layer3"][1:2], alone["layer3"], rtol=1e-5, atol=1e-5)
    assert features_of(trunk, frames(1, 33, 47))["layer1"].shape == (1, 64, 9, 12)


def test_the_graph_ends_at_the_last_tap() -> None:
    """A trunk for layer2 has no weight of layer3; one for avgpool has all."""
    short, full = (
        len(build_trunk(resnet18(), "resnet18", taps)) for taps in (("layer2",), ("layer2", "avgpool"))
    )
    assert short < 0.7e6 * 4 < 11e6 * 4 < full


def test_a_trunk_is_one_file_in_the_standard_domain() -> None:
    """No external data, no custom operators, and the same bytes every time."""
    trunk = build_trunk(resnet18(), "resnet18")
    model = onnx.load_from_string(trunk)
    assert {node.domain for node in model.graph.node} == {""}
    assert [opset.domain for opset in model.opset_import] == [""]
    assert not any(tensor.external_data for tensor in model.graph.initializer)
    assert trunk == build_trunk(resnet18(), "resnet18")


def test_half_precision_storage_halves_the_file() -> None:
    """Weights kept as float16 are widened at load: features within 0.5 % of the float32 trunk."""
    wide = build_trunk(resnet18(), "resnet18")
    narrow = build_trunk(resnet18(), "resnet18", weights="float16")
    assert len(narrow) < 0.52 * len(wide)
    rgb = frames(1, 64, 64)
    a, b = features_of(wide, rgb)["layer3"], features_of(narrow, rgb)["layer3"]
    assert np.abs(a - b).max() < 5e-3 * np.abs(a).max()


@pytest.mark.parametrize(
    ("change", "name", "taps", "says"),
    [
        ({"layer2.0.conv1.weight": None}, "resnet18", TAPS, "1 missing .layer2.0.conv1.weight."),
        ({"head.weight": np.zeros(3, np.float32)}, "resnet18", TAPS, "1 unexpected .head.weight."),
        (
            {"conv1.weight": np.zeros((5, 3, 7, 7), np.float32)},
            "resnet18",
            TAPS,
            "1 wrongly shaped .conv1.weight",
        ),
        ({"bn1.bias": np.full(64, np.nan, np.float32)}, "resnet18", TAPS, "not finite, in bn1.bias"),
        ({"bn1.weight": np.full(64, 1e7, np.float32)}, "resnet18", ("relu",), "exceeds float16"),
        ({}, "resnet50", TAPS, r"not a resnet50 .* missing"),
        ({}, "resnet34", TAPS, "wide_resnet50_2"),
        *(({}, "resnet18", taps, "tap") for taps in ((), ("layer1", "layer1"), ("layer9",), ("layer1.7",))),
    ],
)
def test_what_is_no_trunk_is_refused(
    change: dict[str, np.ndarray | None], name: str, taps: tuple[str, ...], says: str
) -> None:
    """Foreign, missing and wrong weights by name; those of another network; what half precision cannot hold; no tap, a
    repeated or an unknown one."""
    state = {key: value for key, value in {**resnet18(), **change}.items() if value is not None}
    with pytest.raises(ConfigError, match=says):
        build_trunk(state, name, taps, weights="float16")


def test_wide_resnet_has_the_published_size() -> None:
    """wide_resnet50_2 to avgpool: 66.83 million weights, 24.86 million to layer3 (batch statistics not counted)."""
    shapes = list_shapes(topology("wide_resnet50_2"))
    counted = {key: int(np.prod(shape)) for key, shape in shapes.items() if "running" not in key}
    assert round(sum(counted.values()) / 1e6, 2) == 66.83
    assert round(sum(n for key, n in counted.items() if not key.startswith("layer4")) / 1e6, 2) == 24.86


def test_taps_are_named_in_the_order_of_computation() -> None:
    """Blocks precede the stage that they end."""
    taps = list_taps(topology("resnet18"))
    assert taps[2:5] == ("layer1.0", "layer1.1", "layer1")
    assert taps[-1] == "avgpool"


def test_random_weights_keep_their_scale() -> None:
    """Through all stages the activations neither vanish nor explode, and the seed determines the weights."""
    features = forward(
        resnet18(),
        "resnet18",
        apply_steps(IMAGENET, frames(1, 64, 64)),
        ("layer1", "layer2", "layer3", "layer4"),
    )
    assert all(0.3 < value.std() < 30 for value in features.values())
    again = random_state("resnet18", 3)
    assert all(np.array_equal(resnet18()[key], again[key]) for key in resnet18())
    assert not np.array_equal(resnet18()["conv1.weight"], random_state("resnet18", 4)["conv1.weight"])
