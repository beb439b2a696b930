"""A flat index of faiss is read by its header, with every size checked."""

import struct

import numpy as np
import pytest

from plugins.reading.files import HEADER, read_flat_index

ROWS = np.arange(12, dtype=np.float32).reshape(3, 4)


def index(kind: bytes = b"IxF2", d: int = 4, rows: int = 3, count: int = 12, metric: int = 1) -> bytes:
    """An IndexFlatL2 as faiss writes it."""
    head = HEADER.pack(kind, d, rows, 1 << 20, 1 << 20, 1, metric)
    return head + struct.pack("<Q", count) + ROWS.tobytes()


@pytest.mark.parametrize("count", [12, 48])
def test_the_rows_are_read(count: int) -> None:
    """The count is in floats or, in newer files, in bytes."""
    np.testing.assert_array_equal(read_flat_index(index(count=count)), ROWS)


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (index(b"IwFl"), "a flat index"),
        (index(b"IxFI"), "inner products"),
        (index()[:20], "cut short"),
        (index(rows=2**40), "bytes, and has"),
        (index(d=-4), "was expected"),
        (index(count=13), "bytes, and has"),
        (index(metric=0), "was expected"),
        (index() + b"more", "bytes, and has"),
    ],
)
def test_other_indexes_are_refused(data: bytes, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        read_flat_index(data)
