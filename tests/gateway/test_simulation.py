"""The station in a simulated world, a few seeds of it: docs/simulation.md; `make sim` goes on with new ones."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from simulation.bundles import both_bundles
from simulation.faults import FAULTS
from simulation.schedule import Chosen, Simulation
from simulation.surroundings import install_plugins

from edge.messaging.sink_worker import SinkWorker


@pytest.fixture(autouse=True)
def plugins(tmp_path: Path) -> Iterator[None]:
    with contextmanager(install_plugins)(tmp_path / "packages"):
        yield


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return both_bundles(tmp_path_factory.mktemp("bundles"))


@pytest.mark.parametrize("seed", range(1, 5))
def test_nothing_that_must_not_be(seed: int, bundles: list[Path], tmp_path: Path) -> None:
    """Killed, unplugged, without room, without a broker, with another clock: each press once, none passed unjudged."""
    run = Simulation(seed, 15, bundles, tmp_path / "run").play()
    assert run.faults == []


def test_a_seed_gives_the_same_run_again(bundles: list[Path], tmp_path: Path) -> None:
    """What happens, and when, byte for byte."""
    chosen = Chosen(2, True, dict.fromkeys(FAULTS, 0.0) | {"kill": 20.0, "hang up": 6.0, "unplug": 6.0}, 0.02)
    first, second = (
        Simulation(12, 8, bundles, tmp_path / name, chosen).play() for name in ("first", "second")
    )
    assert (first.events, first.reached, first.turns) == (second.events, second.reached, second.turns)
    assert any("killed" in event for event in first.events)


def test_a_fault_that_was_planted_is_named(
    bundles: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A message is acknowledged before it is sent: with a broker that is away, a subscriber lacks results."""
    send = SinkWorker._send

    def acknowledge_first(worker: SinkWorker, row: object) -> None:
        worker._outbox.acknowledge(row.row_id, worker.name)  # type: ignore[attr-defined]
        send(worker, row)  # type: ignore[arg-type]

    monkeypatch.setattr(SinkWorker, "_send", acknowledge_first)
    chosen = Chosen(1, False, dict.fromkeys(FAULTS, 0.0) | {"hang up": 6.0, "stop": 6.0}, 0.0)
    run = Simulation(3, 15, bundles, tmp_path / "run", chosen).play()
    assert any("results lack" in fault for fault in run.faults)
