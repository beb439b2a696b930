"""Tells what a foreign file is by its first bytes, and reads it in the process that calls."""

import io
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plugins.reading.foreign import Content
from plugins.reading.torch_files import is_archive, is_stream, read_archive, read_pickle, read_stream

__all__ = ["HEADER", "MOST_BYTES", "OPENVINO", "OTHERS", "form_of", "read_flat_index", "read_here"]

OPENVINO = "OpenVINO model"

# Ref: faiss/impl/index_write.cpp: four letters of the kind (`IxF2` Euclidean, `IxFI` inner product), then d int32, rows
# int64, two unused int64, is_trained one byte, metric int32, the count of floats (or of their bytes) int64, the floats.
HEADER = struct.Struct("<4siqqqBi")
KINDS = {b"IxF2": 1, b"IxFI": 0}
MOST_WIDTH = 65_536

MOST_BYTES = 8 << 30
"""The largest file: PaDiM of 550 channels at 224x224 has 3.8 GB."""


def form_of(start: bytes, name: str = "") -> str:
    """Say what a file is, by its first bytes; empty where they are of no known kind."""
    if is_archive(start):
        return "NumPy archive" if name.endswith(".npz") else "PyTorch archive"
    if is_stream(start):
        return "older PyTorch file"
    if start[:6] == b"\x93NUMPY":
        return "NumPy array"
    if start[:2] in (b"Ix", b"Iv", b"IH", b"IB"):
        return "faiss index"
    if b"<net" in start[:200]:
        return OPENVINO
    if start[:1] == b"\x80" and start[1:2] in (b"\x02", b"\x03", b"\x04", b"\x05"):
        return "pickle"
    return "ONNX model" if start[:1] == b"\x08" else ""


def read_here(path: Path) -> tuple[str, Content]:
    """Read what the file is, and its content. Errors: ValueError in words; any error on foreign bytes."""
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"it has {size >> 20} MiB, {MOST_BYTES >> 20} MiB are allowed")
    with path.open("rb") as file:
        form = form_of(file.read(256), path.name)
        file.seek(0)
        reader = _READERS.get(form)
        if reader is None:
            raise ValueError(OTHERS.get(form, OTHERS[""]))
        return form, reader(file)


def read_flat_index(data: bytes) -> NDArray[Any]:
    """The rows of a flat Euclidean index, float32 (rows, d). Errors: ValueError in words."""
    kind = data[:4]
    if kind not in KINDS:
        raise ValueError(
            f"it is a faiss index of kind {kind!r}; a flat index (IndexFlatL2) was expected, save one with exact search"
        )
    if kind == b"IxFI":
        raise ValueError("it is a faiss index of inner products (IndexFlatIP); IndexFlatL2 was expected")
    if len(data) < HEADER.size + 8:
        raise ValueError("its header is cut short")
    _, d, rows, _, _, is_trained, metric = HEADER.unpack_from(data)
    (count,) = struct.unpack_from("<Q", data, HEADER.size)
    left = len(data) - HEADER.size - 8
    if not (0 < d <= MOST_WIDTH and rows > 0 and is_trained == 1 and metric == 1):
        raise ValueError(
            f"its header states {rows} rows of width {d}, metric {metric}; a filled IndexFlatL2 was expected"
        )
    if rows * d * 4 != left or count not in (rows * d, rows * d * 4):
        raise ValueError(f"it states {rows} rows of width {d}, that is {rows * d * 4} bytes, and has {left}")
    return np.frombuffer(data, "<f4", rows * d, HEADER.size + 8).reshape(rows, d).astype(np.float32)


def _read_npz(file: Any) -> Content:
    with zipfile.ZipFile(file) as archive:
        wide = [member for member in archive.infolist() if member.file_size > MOST_BYTES]
        if wide:
            raise ValueError(f"its member '{wide[0].filename[:40]}' is larger than allowed")
    file.seek(0)
    with np.load(file, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


OTHERS = {
    "ONNX model": "it is an ONNX model, a finished graph: gelgate bundle wrap takes it; the checkpoint of the same "
    "training (.ckpt) gives a smaller bundle here",
    OPENVINO: "it is an OpenVINO model, which cannot become ONNX again: export the same training as ONNX for "
    "gelgate bundle wrap (anomalib: engine.export(model, ExportType.ONNX)), or give its checkpoint (.ckpt) to gelgate "
    "export import",
    "": "it is of no known kind; a PyTorch file (.ckpt, .pt, .pth), a pickle, a NumPy file or a faiss index was "
    "expected",
}
"""Files that are not read here, and where they go."""

_READERS: dict[str, Callable[[Any], Content]] = {
    "PyTorch archive": read_archive,
    "older PyTorch file": read_stream,
    "pickle": read_pickle,
    "NumPy array": partial(np.load, allow_pickle=False),
    "NumPy archive": _read_npz,
    "faiss index": lambda file: {"rows": read_flat_index(io.BufferedReader(file).read())},
}
