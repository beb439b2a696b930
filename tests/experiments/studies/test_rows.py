"""Rows: results that survive interrupts, full disks and other versions."""

import json
from pathlib import Path

import pytest
from full_disk import room_for

from calibration.experiments.harness.rows import ROW_FORMAT, Rows, frame, read_rows
from edge.core.errors import ConfigError, StoreError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out" / "rows.jsonl"


def test_rows_are_read_back_in_order(path: Path) -> None:
    """Each is one line with the format's number; the folder is made with the first."""
    rows = Rows(path)
    rows.append({"key": "b", "aupro_001": 0.5, "presses": 3})
    rows.append({"key": "a", "aupro_001": None})

    assert [row["key"] for row in rows.read()] == ["b", "a"]
    assert Rows(path).done() == {"a", "b"}
    assert json.loads(path.read_text().splitlines()[0])["format"] == ROW_FORMAT


def test_an_incomplete_last_line_is_dropped_with_a_sentence(path: Path) -> None:
    """The row of an interrupted write does not count, and the next row is not joined to it."""
    rows = Rows(path)
    rows.append({"key": "a"})
    with path.open("a") as file:
        file.write('{"format": 1, "key": "b", "aup')
    said: list[str] = []

    again = Rows(path, said.append)
    assert again.done() == {"a"}
    assert "is incomplete, because a run was interrupted; its cell is done again" in said[0]
    again.append({"key": "c"})
    assert [row["key"] for row in read_rows(path)] == ["a", "c"]


def test_a_file_of_one_incomplete_line_has_no_row(path: Path) -> None:
    """The first write may be the interrupted one."""
    path.parent.mkdir()
    path.write_text('{"format": 1')
    rows = Rows(path)
    rows.append({"key": "a"})

    assert [row["key"] for row in rows.read()] == ["a"]


def test_a_full_disk_keeps_the_rows_so_far_and_says_so(path: Path) -> None:
    """The row that does not fit is not there in part, and the study can continue when there is room."""
    rows = Rows(path)
    rows.append({"key": "a"})
    rows.append({"key": "b"})
    with room_for(path.stat().st_size + 10), pytest.raises(StoreError) as refused:
        rows.append({"key": "c", "text": "x" * 100})

    assert str(refused.value) == (
        f"the disk is full: the 2 rows so far are kept in '{path}'; free some space and give the same command "
        "again to continue"
    )
    said: list[str] = []
    assert [row["key"] for row in read_rows(path, said.append)] == ["a", "b"]
    assert said == []  # nothing of the row that did not fit is left
    rows.append({"key": "c"})
    assert Rows(path).done() == {"a", "b", "c"}


def test_a_device_without_space_is_named_as_full() -> None:
    """The same sentence for the error that a full file system gives."""
    rows = Rows(Path("/dev/full"))

    with pytest.raises(StoreError, match="the disk is full: the 0 rows so far"):
        rows.append({"key": "a"})


def test_rows_of_another_format_are_refused(path: Path) -> None:
    """Their columns mean something else."""
    path.parent.mkdir()
    path.write_text('{"format": 2, "key": "a"}\n')

    with pytest.raises(ConfigError, match="has rows of format 2, this program reads format 1"):
        Rows(path)


@pytest.mark.parametrize(
    "line", ["hello", '{"key": "a"}', "[1]", '{"format": 1}', '{"format": 1, "key": "b", "auprc": NaN}']
)
def test_a_file_of_something_else_is_refused(path: Path, line: str) -> None:
    """With the line's number."""
    path.parent.mkdir()
    path.write_text(f'{{"format": 1, "key": "a"}}\n{line}\n')

    with pytest.raises(ConfigError, match=r"line 2 of .* is not a row of results"):
        read_rows(path)


def test_two_studies_do_not_write_to_one_file(path: Path) -> None:
    """The second one is refused while the first runs, and not afterwards."""
    with (
        Rows(path).hold(),
        pytest.raises(ConfigError, match="another study is writing rows"),
        Rows(path).hold(),
    ):
        pass
    with Rows(path).hold():
        pass


def test_rows_added_since_the_file_was_opened_count(path: Path) -> None:
    """Another study may have ended in between."""
    mine = Rows(path)
    Rows(path).append({"key": "a"})
    with mine.hold():
        assert mine.done() == {"a"}


def test_a_number_that_is_not_finite_is_no_row(path: Path) -> None:
    """JSON has no such number."""
    with pytest.raises(ValueError, match="Out of range"):
        Rows(path).append({"key": "a", "aupro_001": float("nan")})


def test_rows_as_a_frame(path: Path) -> None:
    """One column per name; a row without a column has no value there."""
    rows = Rows(path)
    rows.append({"key": "a", "shots": 1})
    rows.append({"key": "b", "fraction": 0.5})

    assert list(frame(path)["shots"].isna()) == [False, True]
    assert frame(path.with_name("none.jsonl")).empty
