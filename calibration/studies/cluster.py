"""Cells on a Dask cluster: one task per cell, results as they come."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from calibration.studies.cells import Cell
from edge.core.errors import ConfigError, StoreError

__all__ = ["ANSWER_WITHIN_S", "on_cluster"]

ANSWER_WITHIN_S = 10.0
"""How long a scheduler may take to answer, and to show its first worker."""

_RETRIES = 2  # of a cell whose worker died twice: Dask gives a task to another worker itself

Result = tuple[Cell, Mapping[str, Any]]


def on_cluster(
    cells: Sequence[Cell],
    evaluated: Callable[[Callable[[Cell], Mapping[str, Any]], Cell], Result],
    evaluate: Callable[[Cell], Mapping[str, Any]],
    address: str,
) -> Iterator[Result]:
    """The results of the cells in the order in which they come. Dask runs the cells of a dead worker on another one.

    Errors: ConfigError where no scheduler answers, or it has no worker; StoreError where the cluster is lost.
    """
    from distributed import CancelledError, Client, KilledWorker, as_completed

    with _client(Client, address) as client:
        futures = client.map(
            lambda cell: evaluated(evaluate, cell),
            list(cells),
            key=[f"gelgate-{c.key}" for c in cells],
            retries=_RETRIES,
            pure=False,
        )
        try:
            for _, result in as_completed(futures, with_results=True):
                yield result
        except (CancelledError, OSError, TimeoutError) as error:
            raise StoreError(_lost(address)) from error
        except KilledWorker as error:
            raise StoreError(
                f"a cell kills its workers on the cluster at {address}, perhaps for lack of memory ({error!s:.200}); "
                "the rows so far are kept; give the same command again with larger workers"
            ) from error


def _client(client: Any, address: str) -> Any:
    try:
        found = client(address, timeout=ANSWER_WITHIN_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigError(
            f"no Dask scheduler answers at '{address}' within {ANSWER_WITHIN_S:g} s; start one with "
            "`dask scheduler` and name its address, such as tcp://127.0.0.1:8786"
        ) from error
    try:
        found.wait_for_workers(1, timeout=ANSWER_WITHIN_S)
    except TimeoutError as error:
        found.close()
        raise ConfigError(
            f"the Dask scheduler at '{address}' has no worker; start one with `dask worker {address}`"
        ) from error
    return found


def _lost(address: str) -> str:
    return (
        f"the Dask scheduler at '{address}' is lost; the rows so far are kept; "
        "start it and give the same command again to continue"
    )
