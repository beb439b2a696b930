"""Which piece a press is of."""

import io
import threading
from pathlib import Path

import pytest

from calibration.acquisition.folder import AcquisitionFolder, KeptPress, Keys, Pieces
from edge.core.errors import ConfigError


def test_names_of_the_source_are_numbered_as_they_come() -> None:
    """A name keeps its number; without one the piece is unknown."""
    pieces = Pieces(())
    assert [pieces.of(name) for name in ("s7", "s7", "s3", "s7")] == [1, 1, 2, 1]
    assert Pieces(()).of(None) is None


def test_counted_presses_change_the_piece() -> None:
    """Two of each; it is known when the next piece is due."""
    pieces = Pieces((), each=2)
    found, waiting = [], []
    for _ in range(5):
        found.append(pieces.of(None))
        waiting.append(pieces.is_waiting)
    assert found == [1, 1, 2, 2, 3]
    assert waiting == [False, True, False, True, False]


def test_an_earlier_run_is_continued() -> None:
    """Piece 2 has one press of its two; a name that comes again keeps its number."""
    kept = [KeptPress(Path("a"), 1), KeptPress(Path("b"), 1), KeptPress(Path("c"), 2)]
    assert Pieces(kept, each=2).of(None) == 2
    named = Pieces(kept)
    named.see_again("s9", 2)
    assert [named.of("s9"), named.of("new")] == [2, 3]


@pytest.mark.parametrize("piece", [None, 3])
def test_a_press_takes_the_place_of_no_other(tmp_path: Path, piece: int | None) -> None:
    """A person removes the second of three, and goes on; a picture of the free gel neither."""
    about = {"part": "PZ1", "position": "pos1"}
    before = AcquisitionFolder(tmp_path, about)
    kept = [before.add(bytes([k]), piece).path for k in range(3)]
    for k in range(3):
        before.add_free(bytes([k]))
    kept[1].unlink()
    before.free[1].unlink()
    before.close()
    again = AcquisitionFolder(tmp_path, about)
    new = again.add(b"new", piece).path
    again.add_free(b"new")
    assert [path.read_bytes() for path in (kept[0], kept[2], new)] == [b"\x00", b"\x02", b"new"]
    assert [path.read_bytes() for path in again.free] == [b"\x00", b"\x02", b"new"]


def test_one_folder_is_filled_by_one_process(tmp_path: Path) -> None:
    """Two would count other presses than there are."""
    about = {"part": "PZ1", "position": "pos1"}
    first = AcquisitionFolder(tmp_path / "new", about)
    with pytest.raises(ConfigError, match="another process takes presses into"):
        AcquisitionFolder(tmp_path / "new", about)
    kept = first.add(b"press", 1)
    first.close()
    assert AcquisitionFolder(tmp_path / "new", about).presses == [kept]


class _Lines:
    """Lines that arrive when the test lets them; `enter` returns when they were counted."""

    def __init__(self) -> None:
        self._more, self._is_waiting = threading.Semaphore(0), threading.Semaphore(0)

    def enter(self, count: int) -> None:
        for _ in range(count):
            assert self._is_waiting.acquire(timeout=60)
            self._more.release()
        assert self._is_waiting.acquire(timeout=60)
        self._is_waiting.release()

    def __iter__(self) -> "_Lines":
        return self

    def __next__(self) -> str:
        self._is_waiting.release()
        self._more.acquire()
        return "\n"


def test_an_operator_says_when_a_piece_is_new() -> None:
    """Lines before the first press, or several for one change, count once."""
    lines = _Lines()
    pieces = Pieces((), keys=Keys(lines))
    lines.enter(2)
    found = [pieces.of(None), pieces.of(None)]
    lines.enter(3)
    found += [pieces.of(None), pieces.of(None)]
    assert found == [1, 1, 2, 2]


def test_an_input_that_ends_changes_nothing() -> None:
    """As from a service without a terminal."""
    pieces = Pieces((), keys=Keys(io.StringIO("")))
    assert [pieces.of(None), pieces.of(None)] == [1, 1]
