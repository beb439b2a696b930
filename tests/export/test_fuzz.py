"""Mutated files never give a traceback: each is read, or refused in one sentence of our own.

`make test-fuzz` runs 400 of each kind; a normal run a few.
"""

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx.parser
import pytest
import tiny
from vit_states import random_vit, save_safetensors

from edge.core.errors import GelgateError
from edge.model.bundle import Bundle
from export.backbone import BackboneOptions, export_backbone
from export.bundle_stages import compare_bundle
from export.single_graph import GraphInput, adapt
from export.weights_file import read_weights

MUTATIONS = int(os.environ.get("GELGATE_MUTATIONS", "12"))
"""Of each kind of file."""

FRAMES = np.random.default_rng(0).integers(0, 256, (1, 32, 32, 3), dtype=np.uint8)
Importer = Callable[[Path], object]


def graph() -> bytes:
    model = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        theirs (float[n, 3, 16, 16] image) => (float[n] pred_score, float[n, 1, 16, 16] anomaly_map)
        <float[3, 1, 1] mean = {0.4, 0.5, 0.6}>
        {
            centred = Sub (image, mean)
            strength = Abs (centred)
            anomaly_map = ReduceMean <axes = [1], keepdims = 1> (strength)
            pred_score = ReduceMax <axes = [1, 2, 3], keepdims = 0> (anomaly_map)
        }
    """)
    return bytes(model.SerializeToString())


def write_vit(path: Path) -> None:
    save_safetensors(path, {key: value for key, value in random_vit(1).items() if "mlp" not in key})


def write_stages(path: Path) -> None:
    np.savez(path, frames=FRAMES, map=np.zeros((1, 32, 32)), score=np.zeros(1))


def write_checkpoint(path: Path) -> None:
    path.write_bytes(pickle.dumps({"layer1.0.conv1.weight": np.zeros((4, 4, 3, 3)), "epoch": 3}))


def transformer(path: Path) -> object:
    return export_backbone(path, None, BackboneOptions("own", taps=("block0",), frame=(32, 32)))


def taps(path: Path) -> object:
    return export_backbone(path, None, BackboneOptions("own", taps=("strength",), frame=(32, 32)))


def stages(path: Path) -> object:
    return compare_bundle(Bundle.in_memory(*tiny.tiny_files()), path)


def detector(path: Path) -> object:
    return adapt(path.read_bytes(), FRAMES, GraphInput("0..1"))


KINDS: dict[str, tuple[str, Callable[[Path], object], Importer]] = {
    "transformer": ("w.safetensors", write_vit, transformer),
    "taps of a graph": ("g.onnx", lambda path: path.write_bytes(graph()), taps),
    "single graph": ("d.onnx", lambda path: path.write_bytes(graph()), detector),
    "stages": ("s.npz", write_stages, stages),
    "checkpoint": ("c.pth", write_checkpoint, read_weights),
}


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes changed, a part cut out, doubled or appended; often near the start, where headers are."""
    array = bytearray(data)
    reach = len(array) if rng.random() < 0.5 else min(len(array), 400)
    for _ in range(int(rng.integers(1, 8))):
        at = int(rng.integers(0, max(1, min(reach, len(array)))))
        match int(rng.integers(0, 5)):
            case 0:
                array[at : at + 1] = bytes([int(rng.integers(0, 256))])
            case 1:
                del array[at : at + int(rng.integers(1, 64))]
            case 2:
                array[at:at] = array[at : at + int(rng.integers(1, 64))]
            case 3:
                array[at : at + 8] = int(rng.integers(0, 2**63)).to_bytes(8, "little")
            case _:
                del array[max(1, len(array) - int(rng.integers(1, 200))) :]
    return bytes(array)


@pytest.mark.filterwarnings("ignore")  # numpy and torch warn of odd bytes; a warning is no traceback
@pytest.mark.parametrize("kind", KINDS)
def test_mutated_files_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    """No other exception than gelgate's own, with one line of text; nothing is left next to the file."""
    name, write, read = KINDS[kind]
    path = tmp_path / name
    write(path)
    whole, rng, refusals = path.read_bytes(), np.random.default_rng(len(kind)), []
    for _ in range(MUTATIONS):
        path.write_bytes(mutated(whole, rng))
        try:
            read(path)
        except GelgateError as error:
            refusals.append(str(error).strip())
    assert len(refusals) > MUTATIONS // 4
    assert all(refusals)
    assert [file.name for file in tmp_path.iterdir()] == [name]
