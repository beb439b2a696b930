"""Pictures of the free gel that cannot be used are learnt again."""

from pathlib import Path

import numpy as np
import pytest

from edge.core.contact.reference import Reference
from edge.store.reference_files import ReferenceFolder


def test_a_picture_comes_back(tmp_path: Path) -> None:
    """The first of a gel stays the first, the last is the newest."""
    folder = ReferenceFolder(tmp_path)
    for level in (1.0, 2.0):
        folder.save("S1", "gel/1", Reference(np.full((120, 160, 3), level, np.float32), 10, 0))
    first, last = (folder.load("S1", "gel/1", which) for which in ("first", "last"))

    assert first is not None
    assert last is not None
    assert (first.view[0, 0, 0], last.view[0, 0, 0]) == (1.0, 2.0)


@pytest.mark.parametrize("content", [b"", b"not an array", b"\x93NUMPY\x01\x00"])
def test_a_damaged_picture_is_none(tmp_path: Path, content: bytes) -> None:
    """A power failure leaves an empty file."""
    path = tmp_path / "S1" / "g.last.npy"
    path.parent.mkdir()
    path.write_bytes(content)

    assert ReferenceFolder(tmp_path).load("S1", "g", "last") is None


def test_a_picture_of_another_size_is_none(tmp_path: Path) -> None:
    """Kept by a program whose views had another size; compared with today's it would end the gateway."""
    folder = ReferenceFolder(tmp_path)
    folder.save("S1", "g", Reference(np.zeros((60, 80, 3), np.float32), 10, 0))

    assert folder.load("S1", "g", "last") is None
