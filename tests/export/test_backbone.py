"""`gelgate export backbone`: a checkpoint becomes a trunk, anything else becomes one clear sentence."""

import pickle
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from command_line import gelgate, ran
from graph_session import open_graph
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from export.backbone import BackboneOptions, export_backbone, read_checkpoint, weights_sha256
from plugins.backbones.input_steps import IMAGENET, apply_steps
from plugins.backbones.random import random_state
from plugins.backbones.reference import forward

RESNET18 = BackboneOptions("own", "resnet18")
ANOMALIB = Path(__file__).parent / "importers" / "anomalib_2_7_0" / "padim.ckpt"


@cache
def tensors() -> dict[str, NDArray[np.float32]]:
    return {name: np.array(value, np.float32) for name, value in random_state("resnet18", 1).items()}


def saved(folder: Path, content: Any) -> Path:
    """A pickle of arrays, which the reader treats as one of tensors; tests/plugins/reading has torch's own files."""
    path = folder / "weights.pth"
    path.write_bytes(pickle.dumps(content))
    return path


def test_a_checkpoint_of_pytorch_lightning_becomes_a_trunk(tmp_path: Path) -> None:
    """A file that torch wrote, read without torch: anomalib's backbone, its prefix found, its topology recognised."""
    made = export_backbone(ANOMALIB, tmp_path / "trunk.onnx", BackboneOptions("own", taps=("layer1",)))
    assert made.taps == ("layer1",)
    assert read_checkpoint(ANOMALIB)["model.gaussian.mean"].shape == (12, 64)


def test_a_checkpoint_becomes_its_trunk(tmp_path: Path) -> None:
    """The trunk computes the network whose weights were saved, and names them in its metadata."""
    classifier = {"fc.weight": np.zeros((5, 512)), "bn1.num_batches_tracked": np.array(3)}
    facts = export_backbone(saved(tmp_path, tensors() | classifier), tmp_path / "trunk.onnx", RESNET18).facts
    rgb = np.random.default_rng(0).integers(0, 256, (1, 40, 40, 3), dtype=np.uint8)
    session = open_graph(tmp_path / "trunk.onnx")
    expected = forward(tensors(), "resnet18", apply_steps(IMAGENET, rgb), ("layer3",))["layer3"]
    np.testing.assert_allclose(
        session.run(["layer3"], {"frames": rgb})[0], expected, atol=1e-4 * expected.max()
    )
    metadata = session.get_modelmeta().custom_metadata_map
    assert metadata["topology"] == "resnet18"
    assert metadata["weights_sha256"] == facts["weights_sha256"] == weights_sha256(tensors(), "resnet18")
    assert metadata["mean"] == "0.485,0.456,0.406"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["trunk.onnx", "weights.pth"]


@pytest.mark.parametrize("wrap", ["state_dict", "model", "module.", "_orig_mod.module.", "half"])
def test_wrapped_checkpoints_are_unwrapped(tmp_path: Path, wrap: str) -> None:
    """Weights inside a training checkpoint, behind a wrapper's prefix or in half precision are the same weights."""
    few = {name: value for name, value in tensors().items() if "layer" not in name}
    content: Any = {wrap: few, "epoch": 3}
    if wrap.endswith("."):
        content = {wrap + name: value for name, value in few.items()}
    elif wrap == "half":
        content = {name: value.astype(np.float16) for name, value in few.items()}
    found = read_checkpoint(saved(tmp_path, content))
    assert found.keys() == few.keys()
    np.testing.assert_allclose(found["conv1.weight"], tensors()["conv1.weight"], rtol=1e-3, atol=1e-4)
    assert found["conv1.weight"].dtype == np.float32


class Trap:
    """Unpickling this writes a file."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return (Path.touch, (Path(self.path),))


def test_a_pickle_is_never_run(tmp_path: Path) -> None:
    """A checkpoint that would call a function when loaded is refused, and the function was not called."""
    trap = tmp_path / "sprung"
    with pytest.raises(ConfigError, match="which is not on the list"):
        read_checkpoint(saved(tmp_path, {"weights": Trap(str(trap))}))
    plain = tmp_path / "plain.pth"
    plain.write_bytes(pickle.dumps(Trap(str(trap))))
    with pytest.raises(ConfigError, match=r"plain\.pth"):
        read_checkpoint(plain)
    assert not trap.exists()


def test_what_is_no_checkpoint_is_named(tmp_path: Path) -> None:
    """Missing, empty, text, a picture, an ONNX graph, a pickled model, a list: each one sentence with the path."""
    onnx_file = tmp_path / "x.pth"
    node = onnx.helper.make_node("Relu", ["a"], ["b"])
    value = [onnx.helper.make_tensor_value_info(name, 1, [1]) for name in "ab"]
    onnx.save(onnx.helper.make_model(onnx.helper.make_graph([node], "g", value[:1], value[1:])), onnx_file)
    with pytest.raises(ConfigError, match="is already an ONNX graph"):
        read_checkpoint(onnx_file)
    with pytest.raises(ConfigError, match="does not exist"):
        read_checkpoint(tmp_path / "absent.pth")
    for name, content in (
        ("empty", b""),
        ("text", b"hello\n"),
        ("png", b"\x89PNG\r\n\x1a\n" + bytes(64)),
        ("zip", b"PK\x03\x04" + bytes(40)),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=rf"{name} was not imported"):
            read_checkpoint(path)
    with zipfile.ZipFile(tmp_path / "script", "w") as archive:
        archive.writestr("script/code/__torch__/net.py", "")
    with pytest.raises(ConfigError, match="it is a TorchScript archive"):
        read_checkpoint(tmp_path / "script")
    with pytest.raises(ConfigError, match="no weights by name"):
        read_checkpoint(saved(tmp_path, [1, 2, 3]))
    with pytest.raises(ConfigError, match="a table of epoch"):
        read_checkpoint(saved(tmp_path, {"epoch": 3}))


def test_the_wrong_topology_names_the_right_one(tmp_path: Path) -> None:
    """resnet18's weights as a resnet50: the sentence says which option to give; nothing is written."""
    with pytest.raises(
        ConfigError, match=r"weights\.pth are of a resnet18, not a resnet50: --topology resnet18"
    ):
        export_backbone(
            saved(tmp_path, tensors()), tmp_path / "trunk.onnx", BackboneOptions("own", "resnet50")
        )
    assert not (tmp_path / "trunk.onnx").exists()


def test_a_network_of_another_family_goes_through_onnx(tmp_path: Path) -> None:
    """timm's MobileNet: one sentence with the way that is left, and no list of all names."""
    mobilenet = {
        "conv_stem.weight": np.zeros((16, 3, 3, 3)),
        "blocks.0.0.conv_dw.weight": np.zeros((16, 1, 3, 3)),
    }
    with pytest.raises(
        ConfigError, match=r"write the network with torch.onnx.export and name taps: gelgate export backbone"
    ):
        export_backbone(saved(tmp_path, mobilenet), None, BackboneOptions("own"))


def test_the_command_writes_and_reports(tmp_path: Path) -> None:
    """The verb prints what it wrote with both hashes, and refuses to replace a file unasked."""
    words = ("export", "backbone", saved(tmp_path, tensors()), "-o", tmp_path / "t.onnx", "--licence", "own")
    said = ran(*words, "--taps", "layer1,layer2", "--half")
    for part in ("layer1, layer2, 1.4 MB", "licence of the weights own", "weights sha256"):
        assert part in said
    assert "exists already" in gelgate(*words).sentence()


@pytest.mark.parametrize("bad", ["1,2", "a,b,c", "nan,1,1"])
def test_colours_must_be_three_numbers(tmp_path: Path, bad: str) -> None:
    """--mean with two numbers, words or NaN is refused."""
    words = ("export", "backbone", "x.onnx", "-o", tmp_path / "t.onnx", "--mean", bad)
    assert "--mean" in gelgate(*words).sentence()
