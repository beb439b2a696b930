"""Runs the cells of a study that have no row yet: here, in processes, or on a Dask cluster."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from calibration.experiments.harness.cells import Cell, Result
from calibration.experiments.harness.rows import Rows
from calibration.progress import Show
from edge.core.errors import DatasetError, FitError, NotScorable, StoreError

__all__ = ["run"]

Evaluate = Callable[[Cell], Mapping[str, Any]]
"""What a cell measures: the columns of its row without those that name the cell. It must be picklable: a function of a
module, or a frozen value with `__call__`."""

MOST_DEATHS = 3
"""Rounds in which workers die and no cell is finished, before the study gives up."""


def run(
    cells: Sequence[Cell],
    evaluate: Evaluate,
    rows: Rows,
    *,
    jobs: int = 1,
    dask: str | None = None,
    progress: Show,
) -> None:
    """Evaluate every cell without a row, and add its row as soon as it is done.

    jobs: processes on this machine. dask: the address of a scheduler, such as `tcp://host:8786`, whose workers run the
    cells instead. A worker that dies has its cells run again. A cell that cannot be fitted or scored (FitError,
    DatasetError, NotScorable) has a row with the sentence in `error` and no measures. Errors: StoreError for a full
    disk, or for workers that die again and again; ConfigError for a scheduler that does not answer; else what evaluate
    raises.
    """
    with rows.hold():
        known = rows.done()
        left = [cell for cell in dict.fromkeys(cells) if cell.key not in known]
        done = len(cells) - len(left)
        with progress("cells", len(cells)) as advance:
            advance(done)
            for cell, result in _results(left, evaluate, jobs, dask):
                rows.append({**cell.columns(), **result})
                done += 1
                advance(done)


def _results(cells: list[Cell], evaluate: Evaluate, jobs: int, dask: str | None) -> Iterator[Result]:
    if dask is not None:
        from calibration.experiments.harness.cluster import on_cluster

        return on_cluster(cells, evaluate_cell, evaluate, dask)
    if jobs == 1:
        return (evaluate_cell(evaluate, cell) for cell in cells)
    return _in_processes(cells, evaluate, jobs)


def evaluate_cell(evaluate: Evaluate, cell: Cell) -> Result:
    """Return one cell's result, or its refusal."""
    try:
        return cell, evaluate(cell)
    except (FitError, DatasetError, NotScorable) as error:
        return cell, {"error": str(error)}


def _in_processes(cells: list[Cell], evaluate: Evaluate, jobs: int) -> Iterator[Result]:
    """Results as they come. Where a process dies, the cells without a result are given to new processes."""
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import BrokenProcessPool

    waiting, deaths = dict.fromkeys(cells), 0
    while waiting:
        work = (delayed(evaluate_cell)(evaluate, cell) for cell in tuple(waiting))
        pool = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs")
        try:
            for cell, result in pool(work):
                del waiting[cell]
                deaths = 0
                yield cell, result
        except BrokenProcessPool as error:
            deaths += 1
            if deaths == MOST_DEATHS:
                raise StoreError(died(len(cells) - len(waiting), next(iter(waiting)))) from error


def died(finished: int, cell: Cell) -> str:
    """The sentence for workers that die again and again."""
    return (
        f"the workers died {MOST_DEATHS} times without finishing a cell, perhaps for lack of memory; the rows so far, "
        f"{finished} of them new, are kept; the next cell is {cell.part}/{cell.position} {cell.method} "
        f"{dict(cell.settings)}; give the same command again with fewer --jobs"
    )
