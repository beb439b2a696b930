"""Tells what a foreign file is by its first bytes, and reads it in the process that calls."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from export.reading.faiss_index import is_faiss, read_flat_index
from export.reading.foreign import Content
from export.reading.torch_files import is_archive, is_stream, read_archive, read_pickle, read_stream

__all__ = ["MOST_BYTES", "OPENVINO", "OTHERS", "form_of", "read_here"]

OPENVINO = "OpenVINO model"

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
    if is_faiss(start):
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


def _read_npy(file: Any) -> Content:
    return np.load(file, allow_pickle=False)


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
    "NumPy array": _read_npy,
    "NumPy archive": _read_npz,
    "faiss index": lambda file: {"rows": read_flat_index(io.BufferedReader(file).read())},
}
