"""An ONNX file as one piece: weights that the exporter put into a file next to it are read into the graph.

PyTorch's exporter writes `model.onnx` and `model.onnx.data`, so anomalib's exports come as two files. Only a plain file
in the same folder is read; a name that leaves the folder, a link, or a part beyond the file's end is refused.
"""

import math
from pathlib import Path
from typing import Any

from edge.core.errors import ConfigError
from plugins.reading.files import OPENVINO, OTHERS, form_of

__all__ = ["read_graph"]

MOST_BYTES = 1 << 30
"""Of the graph with its weights; a bundle's file has at most this size, and protobuf ends at twice it."""


def read_graph(path: Path) -> bytes:
    """The bytes of a graph with all its weights inside.

    Errors: ConfigError for a file that cannot be read, weights that are missing or somewhere else, or too many bytes.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ConfigError(f"{path} has {path.stat().st_size} bytes, at most {MOST_BYTES} are read")
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read: {error.strerror}; give the detector's ONNX file"
        ) from error
    if form_of(data[:256]) == OPENVINO:
        raise ConfigError(f"{path} cannot be used: {OTHERS[OPENVINO]}")
    return _inlined(data, path) if b"location" in data else data


def _inlined(data: bytes, path: Path) -> bytes:
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load_from_string(data)
    except DecodeError:  # the sentence for that comes where it is opened
        return data
    # Those inside nodes stay where they are, and are refused later if they are outside.
    weights = model.graph.initializer
    outside = [tensor for tensor in weights if tensor.data_location == onnx.TensorProto.EXTERNAL]
    files = {name: _file(path, name) for name in {_facts(tensor).get("location", "") for tensor in outside}}
    if sum(map(len, files.values())) > MOST_BYTES:
        raise ConfigError(
            f"{path} has weights of more than {MOST_BYTES} bytes; a gateway runs no such network"
        )
    for tensor in outside:
        facts = _facts(tensor)
        tensor.raw_data = _part(files[facts.get("location", "")], facts, tensor, path)
        tensor.data_location = onnx.TensorProto.DEFAULT
        del tensor.external_data[:]
    return bytes(model.SerializeToString()) if outside else data


def _facts(tensor: Any) -> dict[str, str]:
    return {str(entry.key): str(entry.value) for entry in tensor.external_data}


def _file(path: Path, name: str) -> bytes:
    """The weights' file next to the graph. Errors: ConfigError."""
    if not name or name in (".", "..") or Path(name).name != name or "\\" in name or "\0" in name:
        raise ConfigError(
            f"{path} keeps its weights in '{name:.100}', outside its own folder; export it again, with the weights "
            "next to it"
        )
    file = path.parent / name
    if file.is_symlink() or not file.is_file():
        raise ConfigError(
            f"{path} keeps its weights in the file {name}, which is not next to it; copy both files"
        )
    if file.stat().st_size > MOST_BYTES:
        raise ConfigError(f"{file} has {file.stat().st_size} bytes, at most {MOST_BYTES} are read")
    return file.read_bytes()


def _part(data: bytes, facts: dict[str, str], tensor: Any, path: Path) -> bytes:
    """A tensor's bytes in the file. Errors: ConfigError where they do not fit its shape or the file."""
    import numpy as np
    from onnx import helper

    try:
        size = math.prod(tensor.dims) * np.dtype(helper.tensor_dtype_to_np_dtype(tensor.data_type)).itemsize
        offset, length = int(facts.get("offset", "0")), int(facts.get("length", str(size)))
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{path}: the weight '{tensor.name:.80}' has no known type, place or size"
        ) from error
    if offset < 0 or length != size or offset + length > len(data):
        raise ConfigError(
            f"{path}: the weight '{tensor.name:.80}' needs {size} bytes, its file gives {length} of {len(data)} from "
            f"{offset}; copy both files again"
        )
    return data[offset : offset + length]
