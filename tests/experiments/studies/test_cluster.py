"""Cells on a Dask cluster: a real scheduler and real workers on this machine."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from study_cells import Counted, DiesOnce, KillsScheduler, cells, quiet, seeds_of

from calibration.experiments.harness import cluster
from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.runner import run
from calibration.experiments.harness.study import Options
from calibration.progress import Advance
from edge.core.errors import ConfigError, StoreError

SUPPORT = Path(__file__).resolve().parents[2] / "support"


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scheduler and workers of a busy machine answer late."""
    monkeypatch.setattr(cluster, "ANSWER_WITHIN_S", 60.0)


@contextmanager
def process(kind: str, folder: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A program of Dask with its output in a pipe; workers find the evaluations of `study_cells`."""
    started = subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": f"{SUPPORT}{os.pathsep}{SUPPORT.parents[1]}",
            "PYTHONUNBUFFERED": "1",
        },
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield started
    finally:
        started.kill()
        started.communicate()


def said(started: subprocess.Popen[str], words: str) -> str:
    """The first line on stderr with these words."""
    assert started.stderr is not None
    for line in started.stderr:
        if words in line:
            return line
    raise AssertionError(f"the process ended without saying '{words}'")


@contextmanager
def scheduler(folder: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The address of a scheduler, and its process."""
    options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-jupyter")
    with process("scheduler", folder, *options) as started:
        yield said(started, "Scheduler at:").split()[-1], started


@contextmanager
def workers(folder: Path, address: str, count: int) -> Iterator[None]:
    """Workers of one thread, without a nanny that starts them again."""
    options = (address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
    with ExitStack() as stack:
        started = [stack.enter_context(process("worker", folder, *options)) for _ in range(count)]
        for worker in started:
            said(worker, "Registered to:")
        yield


def test_cells_of_a_dead_worker_are_run_by_the_other(tmp_path: Path, rows: Rows, counted: Counted) -> None:
    """Two workers, one killed in the middle of a cell: every cell has one row."""
    with scheduler(tmp_path) as (address, _), workers(tmp_path, address, 2):
        run(cells(8), DiesOnce(counted, 3), rows, dask=address, progress=quiet)

    assert seeds_of(rows.read()) == list(range(8))
    assert counted.times(3) == 2


def test_a_refusal_on_a_cluster_is_a_row(tmp_path: Path, rows: Rows, counted: Counted) -> None:
    """As in a process of this machine; and a study on a cluster continues."""
    refusing = Counted(counted.folder, refused=(1,))
    with scheduler(tmp_path) as (address, _), workers(tmp_path, address, 1):
        run(cells(2), refusing, rows, dask=address, progress=quiet)
        run(cells(3), refusing, rows, dask=address, progress=quiet)

    assert {row["seed"]: row.get("error") for row in rows.read()} == {0: None, 1: "too few presses", 2: None}
    assert counted.times(1) == 1


def test_a_scheduler_that_is_lost_ends_the_study_with_a_sentence(
    tmp_path: Path, rows: Rows, counted: Counted, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rows so far are kept. The client alone would wait for the scheduler without end."""
    with scheduler(tmp_path) as (address, started), workers(tmp_path, address, 1):
        killing = KillsScheduler(counted, started.pid)

        @contextmanager
        def hurried(what: str, total: int) -> Iterator[Advance]:
            """From the first row on the silence is short."""
            yield lambda done: monkeypatch.setattr(cluster, "ANSWER_WITHIN_S", 3.0 if done else 20.0)

        with pytest.raises(StoreError, match=f"the Dask scheduler at '{address}' is lost; the rows so far"):
            run(cells(40), killing, rows, dask=address, progress=hurried)

    run(cells(3), counted, rows, progress=quiet)
    assert {0, 1, 2} <= set(seeds_of(rows.read()))


def test_a_scheduler_that_is_not_there_is_a_sentence_in_bounded_time(
    rows: Rows, counted: Counted, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not a wait without end; the sentence says how to start one."""
    monkeypatch.setattr(cluster, "ANSWER_WITHIN_S", 0.5)

    with pytest.raises(
        ConfigError, match=r"no Dask scheduler answers at 'tcp://127\.0\.0\.1:1' within 0\.5 s"
    ):
        run(cells(1), counted, rows, dask="tcp://127.0.0.1:1", progress=quiet)


@pytest.mark.parametrize("address", ["nonsense://x", "not an address", "127.0.0.1", "tcp://host:port"])
def test_what_is_no_address_is_a_sentence(rows: Rows, counted: Counted, tmp_path: Path, address: str) -> None:
    """With the form that an address has. No client is made: it could not be closed. The options refuse it at once."""
    said = re.escape(f"'{address}' is no address of a Dask scheduler")
    with pytest.raises(ConfigError, match=said):
        run(cells(1), counted, rows, dask=address, progress=quiet)
    with pytest.raises(ConfigError, match=said):
        Options(dataset=tmp_path, output=tmp_path / "out", dask=address)


def test_a_cluster_with_another_version_is_refused() -> None:
    """Its rows would be from another program; the process and its version are named."""

    class Cluster:
        def run_on_scheduler(self, function: object, *args: object) -> str:
            raise PackageNotFoundError("gelgate")

        def run(self, function: object, *args: object, on_error: str) -> dict[str, object]:
            return {"tcp://a": version("gelgate"), "tcp://b": "0.0.1"}

    with pytest.raises(ConfigError, match="2 processes of the cluster at 'x' do not have gelgate"):
        cluster._check_versions(Cluster(), "x")
