"""The runner: cells are done once, survive interrupts and dead workers, and refusals are rows."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from study_cells import Counted, DiesOnce, Interrupted, cells, quiet, seeds_of

from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.runner import run
from calibration.progress import Advance
from edge.core.errors import StoreError


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_cell_has_a_row(rows: Rows, counted: Counted, jobs: int) -> None:
    run(cells(4), counted, rows, jobs=jobs, progress=quiet)

    assert seeds_of(rows.read()) == [0, 1, 2, 3]
    assert {row["seed"]: row["aupro_001"] for row in rows.read()}[3] == 0.03
    assert rows.done() == {cell.key for cell in cells(4)}


def test_cells_with_a_row_are_not_run_again(rows: Rows, counted: Counted) -> None:
    """Nor is a cell that is given twice."""
    run(cells(2), counted, rows, progress=quiet)
    run([*cells(3), *cells(3)], counted, rows, progress=quiet)

    assert seeds_of(rows.read()) == [0, 1, 2]
    assert [counted.times(seed) for seed in range(3)] == [1, 1, 1]


def test_an_interrupted_run_continues(rows: Rows, counted: Counted) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(cells(4), Interrupted(counted, 2), rows, progress=quiet)
    assert seeds_of(rows.read()) == [0, 1]
    run(cells(4), counted, rows, progress=quiet)

    assert seeds_of(rows.read()) == [0, 1, 2, 3]
    assert [counted.times(seed) for seed in range(4)] == [1, 1, 1, 1]


def test_the_cells_of_a_process_that_dies_are_run_again(rows: Rows, counted: Counted) -> None:
    run(cells(6), DiesOnce(counted, 3), rows, jobs=2, progress=quiet)

    assert seeds_of(rows.read()) == list(range(6))
    assert counted.times(3) == 2


def test_a_cell_that_always_kills_its_process_ends_the_study(rows: Rows, counted: Counted) -> None:
    """After three rounds without any progress, with the rows so far kept and the cell named."""
    with pytest.raises(StoreError, match="the workers died 3 times without finishing a cell") as refused:
        run(cells(3), DiesOnce(counted, 1, always=True), rows, jobs=2, progress=quiet)

    assert "fewer --jobs" in str(refused.value)
    assert set(seeds_of(rows.read())) <= {0, 2}
    assert counted.times(1) >= 3


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_refusal_is_a_row_with_its_sentence(rows: Rows, counted: Counted, jobs: int) -> None:
    """The other cells go on, and the refused one is not tried at every continuation."""
    refusing = Counted(counted.folder, refused=(1,))
    run(cells(3), refusing, rows, jobs=jobs, progress=quiet)
    run(cells(3), refusing, rows, jobs=jobs, progress=quiet)

    found = {row["seed"]: row for row in rows.read()}
    assert found[1]["error"] == "too few presses"
    assert "aupro_001" not in found[1]
    assert "error" not in found[2]
    assert counted.times(1) == 1


def test_progress_counts_the_finished_cells_of_earlier_runs(rows: Rows, counted: Counted) -> None:
    """A continued study starts where it was."""
    seen: list[int] = []

    @contextmanager
    def show(what: str, total: int) -> Iterator[Advance]:
        assert (what, total) == ("cells", 4)
        yield seen.append

    run(cells(2), counted, rows, progress=quiet)
    run(cells(4), counted, rows, progress=show)

    assert seen == [2, 3, 4]
