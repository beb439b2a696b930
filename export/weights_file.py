"""Weights by name from a file: `.pth` and `.ckpt` by `plugins.reading`, which runs nothing in them."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from edge.core.arrays import F32
from edge.core.errors import ConfigError
from plugins.backbones.topology import State
from plugins.reading.foreign import describe, float32
from plugins.reading.isolated import read_foreign
from plugins.reading.tensors import widen

__all__ = ["file_sha256", "is_onnx", "read_checkpoint", "read_weights"]

MOST_BYTES = 4 << 30
"""The largest file of weights: a ViT-L in float32 has 1.2 GB; a gateway runs nothing of this size."""

# Keys under which training scripts store the weights, and prefixes that wrappers add to every name.
CONTAINERS = ("state_dict", "model", "model_state_dict")
WRAPPERS = ("module.", "_orig_mod.")

# safetensors' names of dtypes that numpy has; BF16 is widened by hand.
_DTYPES = {
    "F64": "<f8",
    "F32": "<f4",
    "F16": "<f2",
    "I64": "<i8",
    "I32": "<i4",
    "I8": "i1",
    "U8": "u1",
    "BOOL": "?",
}


def read_weights(path: Path) -> State:
    """The weights of a `.pth` or `.safetensors` file by name, float32. Errors: ConfigError with what the file is."""
    return read_safetensors(path) if path.suffix == ".safetensors" else read_checkpoint(path)


def read_checkpoint(path: Path) -> State:
    """The weights in a `.pth` file, by name, float32. Errors: ConfigError with what the file is instead."""
    _check_file(path)
    if is_onnx(path):
        raise ConfigError(
            f"{path} is already an ONNX graph; name its taps: gelgate export backbone {path} --taps"
        )
    with read_foreign(path) as foreign:
        loaded = foreign.content
        for name in CONTAINERS:
            if isinstance(loaded, Mapping) and isinstance(loaded.get(name), Mapping):
                loaded = loaded[name]
        table = loaded if isinstance(loaded, Mapping) else {}
        state = {
            _unwrapped(str(name)): float32(value).copy()  # their files go with the reader's folder
            for name, value in table.items()
            if isinstance(value, np.ndarray)
        }
    if not state:
        raise ConfigError(
            f"{path} holds {describe(loaded)} and no weights by name; save model.state_dict() with torch.save"
        )
    return state


def read_safetensors(path: Path) -> State:
    """The weights in a `.safetensors` file, by name, float32. Errors: ConfigError with what is wrong in it."""
    _check_file(path)
    try:
        import safetensors
    except ImportError as error:
        raise ConfigError(
            f"reading {path} needs safetensors, which is not installed; pip install 'gelgate[export]'"
        ) from error
    try:
        entries = safetensors.deserialize(path.read_bytes())  # type: ignore[no-untyped-call]
        state = {_unwrapped(name): _array(entry) for name, entry in entries}
    except (safetensors.SafetensorError, ValueError, KeyError) as error:
        raise ConfigError(
            f"{path} is not a safetensors file of weights ({error!s:.200}); copy it again"
        ) from error
    if not state:
        raise ConfigError(f"{path} holds no weights; save the model's state_dict() with safetensors")
    return state


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, as release pages print it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_onnx(path: Path) -> bool:
    """Tell whether a file parses as an ONNX model with a graph. It starts with its format's version, field 1."""
    with path.open("rb") as file:
        if file.read(1) != b"\x08":
            return False
    import onnx
    from google.protobuf.message import DecodeError

    try:
        return bool(onnx.load(path, load_external_data=False).graph.node)
    except DecodeError:
        return False


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise ConfigError(f"checkpoint {path} does not exist; give the path of a .pth or .safetensors file")
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ConfigError(
            f"{path} has {size / 1e9:.1f} GB, at most {MOST_BYTES / 1e9:.1f} are read; is it the weights?"
        )


def _array(entry: Mapping[str, Any]) -> F32:
    """Read a tensor as float32. Errors: ValueError for a dtype that no weights have."""
    dtype, data, shape = entry["dtype"], bytes(entry["data"]), entry["shape"]
    if dtype == "BF16":
        return float32(widen(np.frombuffer(data, "<u2"), is_bfloat16=True).reshape(shape))
    if dtype not in _DTYPES:
        raise ValueError(f"its dtype {dtype} is not one of {', '.join(_DTYPES)}, BF16")
    return np.frombuffer(data, _DTYPES[dtype]).reshape(shape).astype(np.float32)


def _unwrapped(name: str) -> str:
    while name.startswith(WRAPPERS):
        name = name.partition(".")[2]
    return name
