"""Pictures of the free gel that cannot be used are learnt again."""

import os
from pathlib import Path

import numpy as np
import pytest

from edge.core.contact.reference import Reference
from edge.store.reference_files import KEPT_GELS, ReferenceFolder


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


def test_pictures_of_gels_of_long_ago_are_removed(tmp_path: Path) -> None:
    """The newest are kept, with the first picture of each; another sensor's are not touched."""
    folder = ReferenceFolder(tmp_path)
    view = Reference(np.zeros((120, 160, 3), np.float32), 10, 0)
    folder.save("S2", "g0", view)
    for number in range(KEPT_GELS + 2):
        folder.save("S1", f"g{number}", view)
        for which in ("first", "last"):  # an order that the clock of the test's disk cannot blur
            os.utime(tmp_path / "S1" / f"g{number}.{which}.npy", ns=(number, number))
    folder.save("S1", f"g{KEPT_GELS + 1}", view)

    assert len(list((tmp_path / "S1").iterdir())) == 2 * KEPT_GELS
    assert folder.load("S1", "g0", "first") is None
    assert folder.load("S1", "g1", "last") is None
    assert folder.load("S1", "g2", "first") is not None
    assert folder.load("S2", "g0", "first") is not None
