"""The encoder of a VQGAN, as UniT trains one, becomes a trunk; files that are something else are named."""

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner
from vit_states import save_safetensors
from vqgan_states import random_vqgan

from edge.cli import build
from edge.core.errors import ConfigError
from export.backbone import BackboneOptions, export_backbone
from export.known_weights import ENCODERS
from export.onnx_values import run_values
from plugins.backbones.input_steps import IMAGENET, InputSteps, apply_steps

TAPS = ("level0", "level1", "mid", "latent")
PLAIN = InputSteps((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
OWN = BackboneOptions("own", taps=TAPS, frame=(16, 20), steps=PLAIN)
FRAMES = np.random.default_rng(2).integers(0, 256, (2, 16, 20, 3), dtype=np.uint8)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "unit.safetensors"
    save_safetensors(path, random_vqgan())
    return path


def test_taps_are_levels_and_the_latent(weights: Path) -> None:
    """Every level in its size, then the middle, then what the quantiser reads; all agree with the reference."""
    export = export_backbone(weights, None, OWN)

    found = run_values(export.trunk, TAPS, {"frames": FRAMES}, "the trunk")

    assert [one.shape for one in found] == [(2, 32, 16, 20), (2, 64, 8, 10), (2, 64, 8, 10), (2, 3, 8, 10)]
    assert [result.name for result in export.parity.results] == ["input", *TAPS]


def test_layers_after_the_last_tap_are_not_built(weights: Path) -> None:
    """And the usual taps are the two deepest levels."""
    first = export_backbone(weights, None, dataclasses.replace(OWN, taps=("level0",)))
    usual = export_backbone(weights, None, dataclasses.replace(OWN, taps=()))

    assert len(first.trunk) < 0.3 * len(export_backbone(weights, None, OWN).trunk)
    assert usual.taps == ("level0", "level1")


@pytest.mark.train
def test_it_computes_what_torch_computes(weights: Path) -> None:
    """Group norm, swish, attention and the padding of a halving, by torch's own functions."""
    import torch

    f = torch.nn.functional
    state = {key: torch.from_numpy(value) for key, value in random_vqgan().items()}

    def conv(name: str, x: Any, **options: Any) -> Any:
        return f.conv2d(x, state[f"{name}.weight"], state[f"{name}.bias"], **options)

    def norm(name: str, x: Any) -> Any:
        return f.group_norm(x, 32, state[f"{name}.weight"], state[f"{name}.bias"], 1e-6)

    def block(name: str, x: Any) -> Any:
        y = conv(f"{name}.conv1", f.silu(norm(f"{name}.norm1", x)), padding=1)
        y = conv(f"{name}.conv2", f.silu(norm(f"{name}.norm2", y)), padding=1)
        return y + (conv(f"{name}.nin_shortcut", x) if f"{name}.nin_shortcut.weight" in state else x)

    def attention(name: str, x: Any) -> Any:
        y = norm(f"{name}.norm", x)
        q, k, v = (conv(f"{name}.{part}", y).flatten(2).transpose(1, 2) for part in "qkv")
        mixed = f.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(x.shape)
        return x + conv(f"{name}.proj_out", mixed)

    x = torch.from_numpy(FRAMES.transpose(0, 3, 1, 2) / 255).float()
    level0 = block("encoder.down.0.block.0", conv("encoder.conv_in", x, padding=1))
    x = conv("encoder.down.0.downsample.conv", f.pad(level0, (0, 1, 0, 1)), stride=2)
    level1 = attention("encoder.down.1.attn.0", block("encoder.down.1.block.0", x))
    x = attention("encoder.mid.attn_1", block("encoder.mid.block_1", level1))
    mid = block("encoder.mid.block_2", x)
    latent = conv("quant_conv", conv("encoder.conv_out", f.silu(norm("encoder.norm_out", mid)), padding=1))

    found = run_values(export_backbone(weights, None, OWN).trunk, TAPS, {"frames": FRAMES}, "the trunk")
    for one, expected in zip(found, (level0, level1, mid, latent), strict=True):
        np.testing.assert_allclose(one, expected.numpy(), atol=1e-5 * float(expected.abs().max()))


def test_units_preprocessing_is_opencvs_resize() -> None:
    """Levels in 0..1, 128x160, linear without antialiasing."""
    steps = ENCODERS["unit"].steps
    assert steps is not None
    frames = np.random.default_rng(0).integers(0, 256, (1, 240, 320, 3), dtype=np.uint8)

    expected = cv2.resize(frames[0].astype(np.float32) / 255, (160, 128))

    np.testing.assert_allclose(apply_steps(steps, frames)[0].transpose(1, 2, 0), expected, atol=1e-5)
    assert "resize 128x160 without antialiasing" in steps.words


def test_the_command_takes_a_policys_checkpoint(tmp_path: Path) -> None:
    """Names behind a prefix, as UniT's perception models store them; licence and preprocessing are in the trunk."""
    save_safetensors(tmp_path / "unit.safetensors", random_vqgan("vqgan."))
    arguments = ["export", "backbone", str(tmp_path / "unit.safetensors"), "-o", str(tmp_path / "t.onnx")]
    arguments += ["--encoder", "unit", "--taps", "level1", "--size", "32x40", "--profile", "cropped_lr"]

    done = CliRunner().invoke(build(), [*arguments, "--licence", "MIT"], catch_exceptions=False)

    assert done.exit_code == 0, done.output
    assert "licence of the weights MIT" in done.output
    assert b"without antialiasing" in (tmp_path / "t.onnx").read_bytes()
    with pytest.raises(ConfigError, match="is not stated; its authors state MIT"):
        CliRunner().invoke(build(), [*arguments, "--overwrite"], catch_exceptions=False)


def test_half_precision(weights: Path) -> None:
    """Weights as float16 halve the file."""
    half = export_backbone(weights, None, dataclasses.replace(OWN, weights="float16"))

    assert len(half.trunk) < 0.6 * len(export_backbone(weights, None, OWN).trunk)


def with_value(key: str, value: NDArray[np.float32]) -> Any:
    return lambda state: state.update({key: value})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.pop("encoder.mid.attn_1.q.bias"), r"1 missing \(encoder.mid.attn_1.q.bias\)"),
        (lambda s: s.pop("quant_conv.weight"), r"'quant_conv.weight' is missing"),
        (
            with_value("encoder.norm_out.bias", np.ones(5, np.float32)),
            r"encoder.norm_out.bias \(5,\) instead of \(64,\)",
        ),
        (with_value("quant_conv.bias", np.full(3, np.nan, np.float32)), r"1 not finite \(quant_conv.bias\)"),
        (with_value("encoder.conv_in.weight", np.ones((20, 3, 3, 3), np.float32)), "32 groups do not divide"),
    ],
)
def test_what_is_no_vqgan_is_named(tmp_path: Path, change: Any, words: str) -> None:
    """Missing, wrongly shaped and non-finite weights, each with its name."""
    state = random_vqgan()
    change(state)
    save_safetensors(tmp_path / "odd.safetensors", state)

    with pytest.raises(ConfigError, match=words) as refused:
        export_backbone(tmp_path / "odd.safetensors", None, OWN)
    assert "odd.safetensors" in str(refused.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"taps": ("level2",)}, "distinct taps of level0, level1, mid, latent; found level2"),
        ({"taps": ("mid", "mid")}, "found mid, mid"),
        ({"frame": (15, 20)}, "in multiples of 2 pixels; found 3 channels of 15x20"),
        ({"steps": dataclasses.replace(IMAGENET, copies=2)}, "reads 3 channels .* found 6"),
    ],
)
def test_options_that_do_not_fit(weights: Path, options: Any, words: str) -> None:
    """Taps, sizes and channels, with what is possible."""
    with pytest.raises(ConfigError, match=words):
        export_backbone(weights, None, dataclasses.replace(OWN, **options))
