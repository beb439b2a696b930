"""Vision transformers and published touch encoders become trunks; files that are something else are named."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import pytest
from command_line import gelgate, ran
from toy_trunk import features_of
from vit_states import WIDTH, random_vit, save_safetensors

from calibration.fitting.trunks import open_trunk
from edge.core.errors import BundleCorrupt, ConfigError
from export.backbone import BackboneOptions, export_backbone
from export.known_weights import ENCODERS
from plugins.backbones import vit_trunk
from plugins.backbones.input_steps import IMAGENET, InputSteps, apply_steps, cubic_matrix, linear_matrix

OWN = BackboneOptions("own", taps=("block0", "block1"), frame=(32, 32))


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "vit.safetensors"
    save_safetensors(path, random_vit())
    return path


def test_taps_are_patch_grids_and_deeper_blocks_are_not_built(weights: Path, tmp_path: Path) -> None:
    """Tokens become (n, d, rows, columns) for any number of frames; block2 is not in the file."""
    export = export_backbone(weights, tmp_path / "t.onnx", OWN)
    found = features_of((tmp_path / "t.onnx").read_bytes(), np.zeros((3, 32, 32, 3), np.uint8))
    assert {tap: maps.shape for tap, maps in found.items()} == {
        "block0": (3, WIDTH, 4, 4),
        "block1": (3, WIDTH, 4, 4),
    }
    deeper = export_backbone(weights, None, dataclasses.replace(OWN, taps=("block2",)))
    assert len(export.trunk) < 0.8 * len(deeper.trunk)
    assert [result.name for result in export.parity.results] == ["input", "block0", "block1"]


def test_what_differs_is_not_written(weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With another activation in the graph the first tap is named, the report exists, the trunk does not."""
    monkeypatch.setattr(vit_trunk._VitBuilder, "_gelu", lambda self, x: self.graph.op("Relu", x))
    with pytest.raises(
        BundleCorrupt, match=r"stage 'block0': largest difference .* \(equal before it: input\)"
    ):
        export_backbone(weights, tmp_path / "t.onnx", OWN, report=tmp_path / "report")
    assert (tmp_path / "report" / "parity.html").is_file()
    assert not (tmp_path / "t.onnx").exists()


def test_half_precision_and_other_sizes(weights: Path) -> None:
    """float16 halves the file; frames of 48x40 are resized to the 32x32 of training, or have a grid of 6x5."""
    full, half = (
        export_backbone(weights, None, dataclasses.replace(OWN, weights=w)) for w in ("float32", "float16")
    )
    assert len(half.trunk) < 0.6 * len(full.trunk)
    other = dataclasses.replace(OWN, frame=(48, 40))
    resized = dataclasses.replace(other, steps=dataclasses.replace(IMAGENET, size=(32, 32)))
    for options, grid in ((resized, (4, 4)), (other, (6, 5))):
        found = features_of(export_backbone(weights, None, options).trunk, np.zeros((1, 48, 40, 3), np.uint8))
        assert found["block1"].shape == (1, WIDTH, *grid)


def test_resampling_matrices() -> None:
    """Rows sum to 1; the same size changes nothing; halving a slope keeps the slope inside."""
    for matrix in (linear_matrix, cubic_matrix):
        np.testing.assert_allclose(matrix(7, 3).sum(axis=1), 1)
        np.testing.assert_allclose(matrix(5, 5), np.eye(5), atol=1e-12)
        np.testing.assert_allclose((matrix(16, 8) @ np.arange(16))[2:-2], np.arange(8)[2:-2] * 2 + 0.5)


def test_tvl_checkpoints(tmp_path: Path) -> None:
    """The touch part of TVL: its prefix is found, its mean and std are used, and the licence is still asked for."""
    path = tmp_path / "tvl.safetensors"
    state = {f"tactile_encoder.{key}": value for key, value in random_vit(patch=56).items()}
    save_safetensors(path, state | {"logit_scale": np.ones(1, np.float32)})
    options = BackboneOptions("Apache-2.0", encoder="tvl", taps=("block1",), frame=(240, 320))
    export = export_backbone(path, None, options)
    assert export.facts["encoder"] == "tvl (github.com/Max-Fu/tvl)"
    metadata = {p.key: p.value for p in onnx.load_from_string(export.trunk).metadata_props}
    assert "resize 224x224; -(0.291746, 0.297133, 0.29104)" in metadata["preprocessing"]
    assert metadata["licence"] == "Apache-2.0"
    with pytest.raises(ConfigError, match=r"its authors state Apache-2\.0"):
        export_backbone(path, None, dataclasses.replace(options, licence=" "))


def test_t3_is_two_files(tmp_path: Path) -> None:
    """The encoder's blocks come first, then the trunk's; mean and std must be stated."""
    first, second = random_vit(2), random_vit(4)
    del first["norm.weight"], first["norm.bias"]
    save_safetensors(tmp_path / "encoder.safetensors", first)
    save_safetensors(
        tmp_path / "trunk.safetensors", {k: v for k, v in second.items() if k.startswith(("blocks", "norm."))}
    )
    options = BackboneOptions("MIT", encoder="t3", frame=(32, 32), second=tmp_path / "trunk.safetensors")
    with pytest.raises(ConfigError, match="t3 has another mean and std for every sensor"):
        export_backbone(tmp_path / "encoder.safetensors", None, options)
    stated = dataclasses.replace(
        options, steps=InputSteps((0.4,) * 3, (0.2,) * 3), taps=("block1", "block5", "norm")
    )
    assert export_backbone(tmp_path / "encoder.safetensors", None, stated).taps == (
        "block1",
        "block5",
        "norm",
    )
    lone = tmp_path / "lone.safetensors"
    save_safetensors(lone, {"norm.weight": first["cls_token"]})
    with pytest.raises(ConfigError, match="does not continue a transformer"):
        export_backbone(tmp_path / "encoder.safetensors", None, dataclasses.replace(stated, second=lone))


def sparsh(folder: Path) -> Path:
    state = random_vit(patch=56, channels=6, registers=1)
    path = folder / "sparsh.safetensors"
    both = {f"{who}_encoder.backbone.{key}": v for who in ("student", "teacher") for key, v in state.items()}
    save_safetensors(path, both)
    return path


def test_sparsh_reads_two_frames_without_the_free_gel(tmp_path: Path) -> None:
    """Six channels: the settled frame twice, each less the free gel, plus a half. A free gel is asked for."""
    gel = np.full((64, 64, 3), 100, np.uint8)
    options = BackboneOptions(
        "CC-BY-NC-4.0", encoder="sparsh", taps=("block1",), frame=(64, 64), prefix="teacher_encoder.backbone."
    )
    with pytest.raises(ConfigError, match="pass a picture of it with --background"):
        export_backbone(sparsh(tmp_path), None, options)
    with pytest.raises(ConfigError, match="several networks, under student_encoder"):
        export_backbone(sparsh(tmp_path), None, dataclasses.replace(options, prefix=None, background=gel))
    export = export_backbone(sparsh(tmp_path), None, dataclasses.replace(options, background=gel))
    assert export.parity.results[0].expected.shape == (2, 6, 224, 224)
    steps = dataclasses.replace(ENCODERS["sparsh"].steps or IMAGENET, background=gel)
    np.testing.assert_allclose(apply_steps(steps, gel[None]), 0.5)
    with pytest.raises(ConfigError, match=r"the background is \(64, 64\), frames are \(32, 32\)"):
        export_backbone(sparsh(tmp_path), None, dataclasses.replace(options, background=gel, frame=(32, 32)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.pop("blocks.1.attn.qkv.weight"), r"1 missing \(blocks.1.attn.qkv.weight"),
        (lambda s: s.update({"blocks.0.attn.q_norm.weight": np.ones(64, np.float32)}), "unexpected .*q_norm"),
        (
            lambda s: s.update({"norm.weight": np.ones(3, np.float32)}),
            r"norm.weight \(3,\) instead of \(128,\)",
        ),
        (lambda s: s.update({"norm.bias": np.full(WIDTH, np.nan, np.float32)}), "not finite, in norm.bias"),
        (lambda s: s.pop("pos_embed"), "'pos_embed' is missing"),
        (lambda s: s.update({"pos_embed": np.ones((1, 20, WIDTH), np.float32)}), "20 positions for 1 prefix"),
        (
            lambda s: (s.clear(), s.update({"encoder.conv_in.weight": np.ones((8, 3, 3, 3), np.float32)})),
            r"\(1 names, such as encoder.conv_in.weight\) are not of a .* or a vision transformer; .*torch.onnx.export",
        ),
    ],
)
def test_what_is_no_plain_transformer_is_named(tmp_path: Path, change: Any, words: str) -> None:
    """Missing, unexpected, wrongly shaped and non-finite weights, each with its name."""
    state = random_vit()
    change(state)
    save_safetensors(tmp_path / "x.safetensors", state)
    with pytest.raises(ConfigError, match=words):
        export_backbone(tmp_path / "x.safetensors", None, OWN)


def test_taps_sizes_and_heads_are_checked(weights: Path) -> None:
    """An unknown tap lists the known ones; patches cover the frame; heads divide the channels."""
    for change, words in (
        ({"taps": ("layer1",)}, "distinct taps of block0, block1, block2, norm; found layer1"),
        ({"frame": (30, 32)}, "patches of 8 pixels do not cover an input of 30x32"),
        ({"heads": 3}, "3 heads"),
        ({"prefix": "model."}, "no weights under 'model.'; its names begin with blocks, cls_token"),
    ):
        with pytest.raises(ConfigError, match=words):
            export_backbone(weights, None, dataclasses.replace(OWN, **change))


def test_the_command_and_the_fit_know_the_licence(weights: Path, tmp_path: Path) -> None:
    """The verb refuses without a licence; the trunk's facts, which a bundle records, hold it."""
    out = tmp_path / "t.onnx"
    words = ("export", "backbone", weights, "-o", out, "--taps", "block1")
    assert re.search("licence of the weights in .* is not stated", gelgate(*words).sentence())
    said = "licence of the weights CC-BY-NC-4.0; not for commercial use"
    assert said in ran(*words, "--licence", "CC-BY-NC-4.0")
    trunk = open_trunk(str(out), ("block1",))
    assert (trunk.facts["licence"], trunk.facts["file"]) == ("CC-BY-NC-4.0", "t.onnx")


def test_the_free_gel_of_the_command_is_cut_to_the_region(tmp_path: Path) -> None:
    """A picture of the sensor's size is cut as frames are."""
    cv2.imwrite(str(tmp_path / "gel.png"), np.full((240, 320, 3), 100, np.uint8))
    ran(
        *("export", "backbone", sparsh(tmp_path), "-o", tmp_path / "t.onnx", "--encoder", "sparsh"),
        *("--licence", "CC-BY-NC-4.0", "--prefix", "teacher_encoder.backbone.", "--profile", "cropped_lr"),
        *("--taps", "block1", "--background", tmp_path / "gel.png"),
    )
    assert (tmp_path / "t.onnx").is_file()


@pytest.mark.train
def test_timm_computes_the_same(tmp_path: Path) -> None:
    """The blocks and the last norm of a timm network with random weights."""
    timm = pytest.importorskip("timm", reason="SKIPPED, NOT TESTED: transformers are compared with timm")
    import torch

    network = timm.create_model("vit_tiny_patch16_224", pretrained=False, img_size=64, depth=3).eval()
    state = {key: value.numpy() for key, value in network.state_dict().items()}
    save_safetensors(tmp_path / "timm.safetensors", state)
    options = BackboneOptions("own", taps=("block1", "norm"), frame=(64, 64))
    frames = np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)
    found = features_of(export_backbone(tmp_path / "timm.safetensors", None, options).trunk, frames)
    with torch.no_grad():
        planes = torch.from_numpy(apply_steps(IMAGENET, frames)).float()
        (block,) = network.forward_intermediates(planes, indices=[1], norm=False, intermediates_only=True)
        last = network.forward_features(planes)[:, 1:].transpose(1, 2).reshape(found["norm"].shape)
    for tap, expected in (("block1", block), ("norm", last)):
        np.testing.assert_allclose(found[tap], expected, atol=1e-5 * float(expected.abs().max()))


def test_a_detector_is_fitted_on_a_transformer(tmp_path: Path) -> None:
    """From weights to a bundle that verifies: `export backbone`, `fit --set taps`, `verify`; the licence is inside."""
    save_safetensors(tmp_path / "vit.safetensors", random_vit(patch=16, grid=14))
    (tmp_path / "good").mkdir()
    for k in range(5):
        frame = np.random.default_rng(k).integers(90, 160, (240, 320, 3), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / "good" / f"{k}.png"), frame)
    trunk, bundle = tmp_path / "t.onnx", tmp_path / "b"
    source = tmp_path / "vit.safetensors"
    taps = ("--set", 'taps=["block1"]', "--set", "grid_tap=block1", "--set", "channels=32")
    ran("export", "backbone", source, "-o", trunk, "--taps", "block1", "--licence", "MIT")
    ran("fit", tmp_path / "good", "-o", bundle, "--part", "bolt", "--backbone", trunk, *taps)
    ran("bundle", "verify", bundle)
    shown = ran("bundle", "inspect", bundle)
    assert "weights MIT" in shown
    assert "block1 128x14x14" in shown
