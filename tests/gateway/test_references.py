"""Pictures of the free gel that outlive the process."""

from pathlib import Path

import numpy as np
import pytest

from edge.core.reference import Reference
from edge.references import ReferenceFolder


def picture(value: float) -> Reference:
    return Reference(np.full((60, 80, 3), value, np.float32), 5, 0)


def test_the_first_stays_and_the_last_changes(tmp_path: Path) -> None:
    """Wear is measured from the first picture of a gel to its last."""
    folder = ReferenceFolder(tmp_path)
    for value in (10.0, 20.0):
        folder.save("2BNN4ZE7", "gel/1", picture(value))
    first, last = (folder.load("2BNN4ZE7", "gel/1", which) for which in ("first", "last"))

    assert first is not None
    assert last is not None
    assert (first.view[0, 0, 0], last.view[0, 0, 0]) == (10, 20)
    assert folder.load("2BNN4ZE7", "gel/2", "first") is None


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY\x01\x00", b"not a picture", b"\x80\x04."])
def test_a_picture_that_a_power_cut_spoilt_is_learnt_again(tmp_path: Path, content: bytes) -> None:
    """Empty, cut or foreign: there is none, and the start goes on."""
    folder = ReferenceFolder(tmp_path)
    folder.save("2BNN4ZE7", "gel", picture(1))
    for path in tmp_path.rglob("*.npy"):
        path.write_bytes(content)

    assert folder.load("2BNN4ZE7", "gel", "last") is None
