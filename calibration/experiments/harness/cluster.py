"""Cells on a Dask cluster: one task per cell, results as they come."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from queue import Empty, SimpleQueue
from typing import Any

from calibration.experiments.harness.cells import Cell, Result
from edge.core.errors import ConfigError, StoreError

__all__ = ["check_address", "on_cluster"]

ANSWER_WITHIN_S = 10.0
"""How long a scheduler may take to answer, and to show its first worker."""

_LOOK_EVERY_S = 0.5
"""How often to look whether the scheduler is still there, while no cell is done."""


def on_cluster(
    cells: Sequence[Cell],
    evaluate_cell: Callable[[Callable[[Cell], Mapping[str, Any]], Cell], Result],
    evaluate: Callable[[Cell], Mapping[str, Any]],
    address: str,
) -> Iterator[Result]:
    """The results of the cells in the order in which they come. Dask runs the cells of a dead worker on another one.

    Errors: ConfigError where no scheduler answers, it has no worker, or a worker has another version of this program;
    StoreError where the cluster is lost.
    """
    from distributed import CancelledError, KilledWorker

    with _client(address) as client:
        _check_versions(client, address)
        keys = [f"gelgate-{cell.key}" for cell in cells]
        futures = client.map(partial(evaluate_cell, evaluate), list(cells), key=keys, pure=False)
        try:
            done: SimpleQueue[Any] = SimpleQueue()
            for future in futures:
                future.add_done_callback(done.put)
            for _ in futures:
                future = _wait(client, lambda timeout: done.get(timeout=timeout))
                yield _wait(client, future.result, future)
        except (CancelledError, OSError, TimeoutError) as error:
            raise StoreError(
                f"the Dask scheduler at '{address}' is lost; the rows so far are kept; "
                "start it and give the same command again to continue"
            ) from error
        except KilledWorker as error:
            raise StoreError(
                f"a cell kills its workers on the cluster at {address}, perhaps for lack of memory ({error!s:.200}); "
                "the rows so far are kept; give the same command again with larger workers"
            ) from error


def check_address(address: str) -> None:
    """Check an address. Errors: ConfigError: a client made with a wrong one would try to close for half a minute."""
    from distributed.comm import get_address_host_port, normalize_address

    try:
        get_address_host_port(normalize_address(address))
    except ValueError as error:
        raise ConfigError(
            f"'{address}' is no address of a Dask scheduler ({error}); give --dask tcp://HOST:PORT, as "
            "`dask scheduler` prints it"
        ) from error


def _wait(client: Any, look: Callable[[float], Any], future: Any = None) -> Any:
    """Return what a look gives, which waits some seconds for it, as long as the cluster runs.

    future: whose result it is; a worker that dies with a result has it computed again, which may take as long. Errors:
    those of the look; TimeoutError where the scheduler is lost: Dask alone waits without end.
    """
    silent = 0
    while True:
        try:
            return look(_LOOK_EVERY_S)
        except (Empty, TimeoutError):
            silent = 0 if client.status == "running" else silent + 1
            if getattr(future, "status", "") == "error" or silent * _LOOK_EVERY_S >= ANSWER_WITHIN_S:
                raise TimeoutError(client.status) from None


def _client(address: str) -> Any:
    """A connected client with at least one worker. Errors: ConfigError."""
    from distributed import Client

    check_address(address)
    try:
        client = Client(address, timeout=ANSWER_WITHIN_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigError(
            f"no Dask scheduler answers at '{address}' within {ANSWER_WITHIN_S:g} s; start one with "
            "`dask scheduler` and name its address, such as tcp://127.0.0.1:8786"
        ) from error
    try:
        client.wait_for_workers(1, timeout=ANSWER_WITHIN_S)
    except TimeoutError as error:
        client.close()
        raise ConfigError(
            f"the Dask scheduler at '{address}' has no worker; start one with `dask worker {address}`"
        ) from error
    return client


def _check_versions(client: Any, address: str) -> None:
    """Compare versions. Errors: ConfigError where scheduler or worker lack this program, or have another version."""
    own = version("gelgate")
    versions = {"scheduler": _of_scheduler(client), **client.run(version, "gelgate", on_error="return")}
    wrong = sorted(f"{who}: {has}" for who, has in versions.items() if has != own)
    if wrong:
        raise ConfigError(
            f"{len(wrong)} processes of the cluster at '{address}' do not have gelgate {own} ({wrong[0]}); install "
            "gelgate[cluster] of this version in the environment of the scheduler and of every worker"
        )


def _of_scheduler(client: Any) -> str:
    try:
        return str(client.run_on_scheduler(version, "gelgate"))
    except PackageNotFoundError as error:
        return str(error)
