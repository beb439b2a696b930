"""The rows of a faiss flat index, without faiss.

Ref: faiss/impl/index_write.cpp: four letters of the kind (`IxF2` Euclidean, `IxFI` inner product), then d int32, rows
int64, two unused int64, is_trained one byte, metric int32, the number of floats (or of their bytes) int64, the floats.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["is_faiss", "read_flat_index"]

HEADER = struct.Struct("<4siqqqBi")
KINDS = {b"IxF2": 1, b"IxFI": 0}
MOST_WIDTH = 65_536


def is_faiss(start: bytes) -> bool:
    """Tell whether a file begins as an index of faiss."""
    return start[:2] in (b"Ix", b"Iv", b"IH", b"IB")


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
