"""The station in a simulated world, a few seeds of it: docs/simulation.md; `make sim` goes on with new ones."""

import multiprocessing
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
from simulation.bundles import both_bundles
from simulation.chosen import Chosen, Fault
from simulation.disk import Disk, hear_audits
from simulation.failed import FAILED
from simulation.planted import ROOT
from simulation.planted_bugs import BUGS, Bug
from simulation.planted_by_others import BY_OTHERS
from simulation.power import listening
from simulation.schedule import Simulation
from simulation.search import Player, play_all
from simulation.shrinking import Failure, kind_of, shrink
from simulation.surroundings import install_plugins

from edge.gateway.commands import Commands
from edge.messaging.sink_worker import SinkWorker


@pytest.fixture(autouse=True)
def plugins(tmp_path: Path) -> Iterator[None]:
    with contextmanager(install_plugins)(tmp_path / "packages"):
        yield


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return both_bundles(tmp_path_factory.mktemp("bundles"))


@pytest.mark.parametrize("seed", range(3))
def test_nothing_that_must_not_be(seed: int, bundles: list[Path], tmp_path: Path) -> None:
    """Killed, unplugged, without room, without a broker, with another clock: each press once, none passed unjudged."""
    run = Simulation(seed, 5, bundles, tmp_path / "run").play()
    assert run.faults == []


@pytest.mark.parametrize("failure", FAILED, ids=lambda failure: f"seed {failure.seed}")
def test_what_has_failed_does_not_fail_again(failure: Failure, bundles: list[Path], tmp_path: Path) -> None:
    run = failure.play(bundles, tmp_path)
    assert run.faults == []


def test_a_seed_gives_the_same_run_again(bundles: list[Path], tmp_path: Path) -> None:
    """What happens, and when, byte for byte; and so do the faults that it has drawn."""
    rates = {"kill": 20.0, "hang up": 6.0, "unplug": 6.0, "request": 10.0, "slow disk": 3.0}
    chosen = Chosen(2, True, rates, 0.02)
    first, second = (
        Simulation(12, 5, bundles, tmp_path / name, chosen).play() for name in ("first", "second")
    )
    assert (first.events, first.reached, first.turns) == (second.events, second.reached, second.turns)
    assert any("killed" in event for event in first.events)
    assert first.schedule


def test_a_seed_leaves_the_same_in_two_processes(bundles: list[Path], tmp_path: Path) -> None:
    """Ids, rows, what subscribers got and each file, byte for byte: seed 8 has all kinds of faults, and a file sink."""
    told = []
    for salt in ("1", "2"):
        (tmp_path / "made").mkdir()
        told.append(
            subprocess.run(
                [sys.executable, "-m", "simulation.left", "8", tmp_path / "made", *bundles],
                env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'tests/support'}", "PYTHONHASHSEED": salt},
                capture_output=True,
                text=True,
                check=True,
            ).stdout.splitlines()
        )
        shutil.rmtree(tmp_path / "made")
    assert told[0] == told[1]
    assert sum(line.startswith("presses (") for line in told[0]) > 5
    assert any(line.startswith("broker0 got ") for line in told[0])


def test_a_loss_of_power_takes_what_a_kernel_takes(tmp_path: Path) -> None:
    """As in the kernel lab: a file that replaced another has the old content, the new one, a part of it, or none."""
    folder, copy = tmp_path / "station", tmp_path / "after"
    folder.mkdir()
    (folder / "file").write_bytes(b"old")
    states = set()
    disk = Disk(folder)
    with listening(folder) as disk.unsynced:
        disk.unsynced.start_again()
        hear_audits(disk)
        (folder / "part").write_bytes(bytes([1]) * 1024)
        os.replace(folder / "part", folder / "file")
        assert not disk.unsynced.synced  # another file may get the inode of what was replaced
        for seed in range(100):
            shutil.copytree(folder, copy)
            disk.unsynced.lose(copy, random.Random(seed))
            states.add(tuple((path.name, path.read_bytes().rstrip(b"\0")) for path in sorted(copy.iterdir())))
            shutil.rmtree(copy)
        hear_audits(None)
    new = bytes([1]) * 1024
    contents = (new, new[:512], bytes(512) + new[:512], b"")
    renamed = {(("file", content),) for content in contents}
    unnamed = {(("file", b"old"), ("part", content)) for content in contents}
    assert states == renamed | unnamed | {(("file", b"old"),)}


def plant(monkeypatch: pytest.MonkeyPatch) -> None:
    """A message is acknowledged before it is sent."""
    send = SinkWorker._send

    def acknowledge_first(worker: SinkWorker, row: object) -> None:
        worker._outbox.acknowledge([row.row_id], worker.name)  # type: ignore[attr-defined]
        send(worker, row)  # type: ignore[arg-type]

    monkeypatch.setattr(SinkWorker, "_send", acknowledge_first)


def test_a_planted_fault_is_named_and_its_schedule_plays_again(
    bundles: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a broker that is away a subscriber lacks results. What is pasted fails again, and passes without the bug."""
    with monkeypatch.context() as planted:
        plant(planted)
        run = Simulation(
            11, 6, bundles, tmp_path / "run", Chosen(1, False, {"hang up": 20.0}, fps=7.0)
        ).play()
        failure = Failure.of(run)
        assert "results lack" in failure.says
        pasted = eval(failure.text(), {"Failure": Failure, "Chosen": Chosen, "Fault": Fault})
        assert pasted == failure
        assert failure.says in map(kind_of, pasted.play(bundles, tmp_path).faults)
    assert pasted.play(bundles, tmp_path).faults == []


def end(*given: object) -> float:
    raise ZeroDivisionError("planted")


@pytest.mark.parametrize(
    ("kind", "function", "says"),
    [
        (SinkWorker, "step", "end of test_simulation.py ended it: ZeroDivisionError('planted')"),
        (Commands, "_do_once", "it logged an error that nobody foresaw: command "),
    ],
)
def test_an_error_that_nobody_foresaw_is_a_failure_with_a_name(
    kind: type, function: str, says: str, bundles: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends the run, or is logged where the program goes on; so it is shrunk and pasted, and other seeds follow."""
    monkeypatch.setattr(kind, function, end)
    run = Simulation(7, 3, bundles, tmp_path / "run", Chosen(rates={"request": 60.0})).play()
    assert run.faults[0].startswith(says)


def test_a_schedule_shrinks_to_what_fails_alike() -> None:
    """Of 9 faults and 12 presses a hang-up after a stop is left, and three presses; another fault is no proof."""

    def play(tried: Failure) -> list[str]:
        names = [fault.name for fault in tried.schedule]
        is_late = "stop" in names and "hang up" in names[names.index("stop") :]
        return ["broker0: 7 results lack"] if is_late and tried.presses >= 3 else ["a press was lost"]

    names = ("unplug", "hang up", "stop", "unplug", "relay", "hang up", "hang up", "step clock", "relay")
    schedule = tuple(Fault(20.0 + number, name, number) for number, name in enumerate(names))
    failure = Failure(8, 12, Chosen(), schedule, kind_of("broker0: 1 results lack"))
    shortest = shrink(failure, play)
    assert [(fault.at_s, fault.name) for fault in shortest.schedule] == [(4.0, "stop"), (8.0, "hang up")]
    assert (shortest.seed, shortest.presses) == (8, 3)
    assert shrink(failure, play, most=0) == failure


def test_a_schedule_is_played_in_place_of_what_a_seed_draws(bundles: list[Path], tmp_path: Path) -> None:
    schedule = (Fault(4.5, "unplug", 1), Fault(6.25, "step clock", 5))
    run = Simulation(1, 4, bundles, tmp_path / "run", Chosen(fps=7.0), schedule).play()
    assert run.faults == []
    assert [replace(fault, at_s=round(fault.at_s, 2)) for fault in run.schedule] == list(schedule)


@pytest.mark.parametrize("bug", [*BUGS, *BY_OTHERS], ids=lambda bug: bug.name)
def test_a_bug_can_be_planted(bug: Bug) -> None:
    """Its text is in the program, once; `make sim-planted` finds it."""
    assert (ROOT / bug.file).read_text(encoding="utf-8").count(bug.old) == 1
    assert bug.new != bug.old


@pytest.fixture
def player(bundles: list[Path], tmp_path: Path) -> Player:
    stop = multiprocessing.get_context("spawn").Event()
    return Player(1, bundles, tmp_path, stop, is_shrinking=False, kept=tmp_path / "kept")


def test_what_fails_is_kept_in_a_file(player: Player, monkeypatch: pytest.MonkeyPatch) -> None:
    """What happened, what must not be, and what is pasted; also of a search that nobody sees."""
    monkeypatch.setattr(SinkWorker, "step", end)
    run, path = player.play(7)
    assert path is not None
    text = path.read_text()
    assert all(line in text for line in [*run.events, *run.faults, Failure.of(run).text()])
    assert "--seed 7 --runs 1 --presses 1" in text


def test_a_search_in_two_processes_ends_when_it_is_stopped(player: Player) -> None:
    """The runs that are on are ended, and no other is begun."""
    runs = play_all(player, count(1), 2)
    assert next(runs)[0].faults == []
    player.stop.set()
    assert len(list(runs)) <= 2
    assert not any(player.folder.glob("run*"))
