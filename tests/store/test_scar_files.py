"""The record of a gel's scars in its file: kept, read, read of an earlier version, and learnt again when damaged."""

from pathlib import Path

import numpy as np
import pytest

from edge.core.gel_scars.record import PLANES, ScarRecord
from edge.store.scar_files import ScarFolder


def record() -> ScarRecord:
    planes = np.random.default_rng(3).random((PLANES, 120, 160), np.float32)
    return ScarRecord(planes)


def test_a_record_is_read_as_it_was_kept(tmp_path: Path) -> None:
    """Of its sensor and gel, and of no other."""
    ScarFolder(tmp_path).save("28J3", "gel-1", record())
    found = ScarFolder(tmp_path).load("28J3", "gel-1")

    assert found is not None
    assert np.array_equal(found.planes, record().planes)
    assert ScarFolder(tmp_path).load("28J3", "gel-2") is None


def test_a_record_of_an_earlier_version_keeps_its_scars(tmp_path: Path) -> None:
    """It had one more plane at the end, which is not used any more."""
    ScarFolder(tmp_path).save("28J3", "gel-1", record())
    path = next(tmp_path.rglob("*.scars.npy"))
    np.save(path, np.concatenate([record().planes, np.ones((1, 120, 160), np.float32)]))
    found = ScarFolder(tmp_path).load("28J3", "gel-1")

    assert found is not None
    assert np.array_equal(found.planes, record().planes)


@pytest.mark.parametrize(
    "damaged",
    [b"", b"no array", np.zeros((PLANES, 60, 80), np.float32), np.zeros((3, 120, 160), np.float32)],
    ids=["empty", "text", "another size", "too few planes"],
)
def test_a_damaged_record_is_learnt_again_and_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damaged: bytes | np.ndarray
) -> None:
    """As after a power cut."""
    ScarFolder(tmp_path).save("28J3", "gel-1", record())
    path = next(tmp_path.rglob("*.scars.npy"))
    if isinstance(damaged, bytes):
        path.write_bytes(damaged)
    else:
        np.save(path, damaged)

    assert ScarFolder(tmp_path).load("28J3", "gel-1") is None
    assert "learnt again" in caplog.text
