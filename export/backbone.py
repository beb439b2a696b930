"""`gelgate export backbone`: a PyTorch checkpoint of weights becomes an ONNX trunk, without torchvision.

A checkpoint is a pickle, and an unrestricted pickle runs any code of its author. Only PyTorch's weights-only loader is
used here: it builds tensors and plain containers and refuses everything else. There is no fallback.
"""

import hashlib
import importlib
import os
import pickle
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from plugins.backbones.resnet import IMAGENET_MEAN, IMAGENET_STD, TAPS, build_trunk
from plugins.backbones.topology import State, check_state, expected_shapes, topology

__all__ = ["export_backbone", "read_checkpoint", "weights_sha256"]

# Keys under which training scripts store the weights, and prefixes that wrappers add to every name.
CONTAINERS = ("state_dict", "model", "model_state_dict")
WRAPPERS = ("module.", "_orig_mod.")


def export_backbone(
    checkpoint: Path,
    output: Path,
    topology_name: str,
    taps: Sequence[str] = TAPS,
    *,
    mean: Sequence[float] = IMAGENET_MEAN,
    std: Sequence[float] = IMAGENET_STD,
    weights: Literal["float32", "float16"] = "float32",
) -> dict[str, str]:
    """Write the trunk, completely or not at all; returns its facts, which are also in the file's metadata.

    Errors: ConfigError for a file that is not a checkpoint of this topology, OSError when the output cannot be written.
    """
    net = topology(topology_name)
    state = read_checkpoint(checkpoint)
    check_state(state, net, f"the weights in {checkpoint}")
    facts = {"weights": checkpoint.name, "weights_sha256": weights_sha256(state, topology_name)}
    trunk = build_trunk(state, topology_name, taps, mean=mean, std=std, weights=weights, facts=facts)
    part = output.with_name(f".{output.name}.part")
    try:
        part.write_bytes(trunk)
        os.replace(part, output)
    finally:
        part.unlink(missing_ok=True)
    return {**facts, "trunk_sha256": hashlib.sha256(trunk).hexdigest(), "bytes": str(len(trunk))}


def read_checkpoint(path: Path) -> State:
    """The weights in a `.pth` file, by name, float32. Errors: ConfigError with what the file is instead."""
    if not path.is_file():
        raise ConfigError(f"checkpoint {path} does not exist; give the path of a .pth file")
    if _is_onnx(path):
        raise ConfigError(f"{path} is already an ONNX graph; use it directly: gelgate fit --backbone {path}")
    loaded = _load(path)
    for name in CONTAINERS:
        if isinstance(loaded, Mapping) and isinstance(loaded.get(name), Mapping):
            loaded = loaded[name]
    tensors = (
        {name: value for name, value in loaded.items() if hasattr(value, "numpy")}
        if isinstance(loaded, Mapping)
        else {}
    )
    if not tensors:
        raise ConfigError(
            f"{path} holds {_described(loaded)} and no weights by name; save model.state_dict() with torch.save"
        )
    return {_unwrapped(str(name)): _as_numpy(value) for name, value in tensors.items()}


def weights_sha256(state: State, topology_name: str) -> str:
    """SHA-256 over the weights that the topology uses, sorted by name: the same for every file that holds them."""
    digest = hashlib.sha256()
    for name in sorted(expected_shapes(topology(topology_name))):
        digest.update(name.encode() + b"\0")
        digest.update(np.ascontiguousarray(state[name], "<f4").tobytes())
    return digest.hexdigest()


def _load(path: Path) -> Any:
    try:
        torch = importlib.import_module("torch")
    except ImportError as error:
        raise ConfigError(
            f"reading {path} needs PyTorch, which is not installed; pip install 'gelgate[train]', "
            "or export on another machine and copy the .onnx file"
        ) from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about old pickle protocols; real faults are raised
        try:
            return torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # on foreign bytes the loader raises any error
            raise ConfigError(f"{path} {_complaint(path, error)}") from error


def _complaint(path: Path, error: Exception) -> str:
    if "TorchScript" in str(error):
        return (
            "is a TorchScript archive, not a checkpoint of weights; save model.state_dict() with torch.save"
        )
    if isinstance(error, pickle.UnpicklingError) and zipfile.is_zipfile(path):
        return "holds more than weights and was not loaded; save model.state_dict() alone with torch.save"
    return (
        f"is not a PyTorch checkpoint of weights ({type(error).__name__}); give a file written by torch.save"
    )


def _is_onnx(path: Path) -> bool:
    """Whether a file parses as an ONNX model with a graph. It starts with its format's version, field 1."""
    with path.open("rb") as file:
        if file.read(1) != b"\x08":
            return False
    import onnx

    try:
        return bool(onnx.load(path, load_external_data=False).graph.node)
    except Exception:  # noqa: BLE001 (protobuf raises its own classes; then it is not ONNX)
        return False


def _unwrapped(name: str) -> str:
    while name.startswith(WRAPPERS):
        name = name.partition(".")[2]
    return name


def _as_numpy(value: Any) -> NDArray[np.float32]:
    array: NDArray[np.float32] = value.detach().float().numpy()
    return array


def _described(value: object) -> str:
    if isinstance(value, Mapping):
        return f"a table of {', '.join(map(str, list(value)[:4])) or 'nothing'}"
    return f"a {type(value).__name__}"
