"""Pictures of the free gel and its scars in files: kept, read, and learnt again when damaged."""

import os
from pathlib import Path

import numpy as np
import pytest

from edge.core.contact.reference import Reference
from edge.core.gel_scars.record import PLANES, ScarRecord
from edge.store.gel_files import KEPT_GELS, GelFiles


def test_a_picture_comes_back(tmp_path: Path) -> None:
    """The first of a gel stays the first, the last is the newest."""
    folder = GelFiles(tmp_path)
    for level in (1.0, 2.0):
        folder.save_picture("S1", "gel/1", Reference(np.full((120, 160, 3), level, np.float32)))
    first, last = (folder.load_picture("S1", "gel/1", which) for which in ("first", "last"))

    assert first is not None
    assert last is not None
    assert (first.view[0, 0, 0], last.view[0, 0, 0]) == (1.0, 2.0)
    assert not folder.has_others("S1", "gel/1")
    assert folder.has_others("S1", "gel/2")


def with_header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(64)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not an array",
        b"\x93NUMPY\x01\x00",
        with_header("{'descr': '<f4', 'fortran_order': False, 'shape': (4, 4\n"),
        with_header("{'descr': '<f4', b'fortran_order': False, 'shape': (4, 4)}\n"),
        with_header("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, 1000000)}\n"),
        with_header("{'descr': ((), ()), 'fortran_order': False, 'shape': (4, 4)}\n"),
        with_header("{'descr': ',f4', 'fortran_order': False, 'shape': (4, 4)}\n"),
        with_header("if 1:\n   a\n  b\n"),
        np.zeros((60, 80, 3), np.float32),
    ],
)
def test_a_picture_damaged_or_of_another_size_is_none(tmp_path: Path, content: bytes | np.ndarray) -> None:
    """A power failure leaves an empty file, a worn disk a header that is none; compared with today's, another size
    would end the gateway."""
    path = tmp_path / "S1" / "g.last.npy"
    path.parent.mkdir()
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content)

    assert GelFiles(tmp_path).load_picture("S1", "g", "last") is None


@pytest.mark.parametrize("sector", [0, 1, 200, -1])
def test_a_file_that_a_power_cut_has_torn_is_none(tmp_path: Path, sector: int) -> None:
    """512 bytes of it were not written; what is left could be read as a picture."""
    folder, path = GelFiles(tmp_path), tmp_path / "S1" / "g.last.npy"
    view = np.random.default_rng(3).random((120, 160, 3), np.float32)
    folder.save_picture("S1", "g", Reference(view))
    content = bytearray(path.read_bytes())
    start = range(0, len(content), 512)[sector]
    content[start : start + 512] = bytes(len(content[start : start + 512]))
    path.write_bytes(content)

    assert folder.load_picture("S1", "g", "last") is None


def test_a_file_of_an_earlier_version_has_no_checksum(tmp_path: Path) -> None:
    path = tmp_path / "S1" / "g.last.npy"
    path.parent.mkdir()
    np.save(path, np.ones((120, 160, 3), np.float32))

    picture = GelFiles(tmp_path).load_picture("S1", "g", "last")
    assert picture is not None
    assert picture.view.min() == 1.0


def test_a_file_that_cannot_be_written_or_removed_is_in_the_log_and_ends_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A file is in the place of the folder."""
    (tmp_path / "S1").write_text("")
    GelFiles(tmp_path).save_picture("S1", "g", Reference(np.zeros((120, 160, 3), np.float32)))
    GelFiles(tmp_path).forget("S1", "g", "last")

    assert [word in caplog.text for word in ("was not kept", "was not removed")] == [True, True]


def test_pictures_of_gels_of_long_ago_are_removed(tmp_path: Path) -> None:
    """The newest are kept, with the first picture of each; another sensor's are not touched."""
    folder = GelFiles(tmp_path)
    view = Reference(np.zeros((120, 160, 3), np.float32))
    folder.save_picture("S2", "g0", view)
    for number in range(KEPT_GELS + 2):
        folder.save_picture("S1", f"g{number}", view)
        for which in ("first", "last"):  # an order that the clock of the test's disk cannot blur
            os.utime(tmp_path / "S1" / f"g{number}.{which}.npy", ns=(number, number))
    folder.save_picture("S1", f"g{KEPT_GELS + 1}", view)

    assert len(list((tmp_path / "S1").iterdir())) == 2 * KEPT_GELS
    assert folder.load_picture("S1", "g0", "first") is None
    assert folder.load_picture("S1", "g1", "last") is None
    assert folder.load_picture("S1", "g2", "first") is not None
    assert folder.load_picture("S2", "g0", "first") is not None


def record() -> ScarRecord:
    planes = np.random.default_rng(3).random((PLANES, 120, 160), np.float32)
    return ScarRecord(planes)


def test_a_record_is_read_as_it_was_kept(tmp_path: Path) -> None:
    """Of its sensor and gel, and of no other."""
    GelFiles(tmp_path).save("28J3", "gel-1", "scars", record().planes)
    found = GelFiles(tmp_path).load("28J3", "gel-1", "scars", ScarRecord.from_file)

    assert found is not None
    assert np.array_equal(found.planes, record().planes)
    assert GelFiles(tmp_path).load("28J3", "gel-2", "scars", ScarRecord.from_file) is None


@pytest.mark.parametrize(
    "damaged",
    [b"", b"no array", np.zeros((PLANES, 60, 80), np.float32), np.zeros((3, 120, 160), np.float32)],
    ids=["empty", "text", "another size", "too few planes"],
)
def test_a_damaged_record_is_learnt_again_and_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damaged: bytes | np.ndarray
) -> None:
    """As after a power cut."""
    GelFiles(tmp_path).save("28J3", "gel-1", "scars", record().planes)
    path = next(tmp_path.rglob("*.scars.npy"))
    if isinstance(damaged, bytes):
        path.write_bytes(damaged)
    else:
        np.save(path, damaged)

    assert GelFiles(tmp_path).load("28J3", "gel-1", "scars", ScarRecord.from_file) is None
    assert "learnt again" in caplog.text
