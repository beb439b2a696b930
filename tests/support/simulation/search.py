"""Plays seeds in one process or several, and keeps each that fails."""

import gc
import multiprocessing
import shutil
import signal
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing.synchronize import Event
from pathlib import Path
from types import FrameType

import cv2

from simulation.kept import KEPT, describe, keep
from simulation.schedule import Run, Simulation
from simulation.shrinking import Failure, kind_of, shrink
from simulation.surroundings import install_plugins


@dataclass
class Player:
    """Plays seeds in this process. stop: set when nothing new may be begun."""

    presses: int
    bundles: Sequence[Path]
    folder: Path
    stop: Event
    is_shrinking: bool = True
    is_telling: bool = False
    """Every run is printed, and not only one that fails."""
    kept: Path = KEPT
    """The folder of the files of what has failed."""
    _kinds: set[str] = field(default_factory=set)
    """Of failures that were shrunk here; others of a kind are kept as they are."""

    def begin(self) -> None:
        """Prepare this process."""
        cv2.setNumThreads(1)
        gc.collect()
        gc.freeze()  # each run asks what is in memory, which is not what was there before

    def play(self, seed: int) -> tuple[Run, Path | None]:
        """Play one; returns the file too where it has failed."""
        own = self.folder / f"run{seed}"
        run = Simulation(seed, self.presses, self.bundles, own).play()
        shutil.rmtree(own)
        path = keep(run, None, self.kept) if run.faults else None
        if path:
            print("\n".join([*describe(run), f"kept in {path}"]), flush=True)
        elif self.is_telling:
            print("\n".join([f"seed {seed}: {run.chosen}", *run.events]), flush=True)
        if path and self.is_shrinking and kind_of(run.faults[0]) not in self._kinds:
            self._kinds.add(kind_of(run.faults[0]))
            keep(run, self._shrink(run), self.kept)
        return run, path

    def _shrink(self, run: Run) -> Failure:
        """Print the shortest schedule that fails alike; of a search that is stopped, the shortest so far."""

        def play(tried: Failure) -> Sequence[str]:
            return () if self.stop.is_set() else tried.play(self.bundles, self.folder).faults

        failure = Failure.of(run)
        print(f"seed {run.seed}: shrinking {len(failure.schedule)} faults, {run.presses} presses", flush=True)
        shortest = shrink(failure, play)
        print(
            f"seed {run.seed}: {len(shortest.schedule)} faults, {shortest.presses} presses; for FAILED in failed.py:\n"
            f"{shortest.text()}",
            flush=True,
        )
        return shortest


def play_all(player: Player, seeds: Iterable[int], jobs: int) -> Iterator[tuple[Run, Path | None]]:
    """Play one seed after the other, until the player is stopped; what was begun then is ended."""
    if jobs == 1:
        player.begin()
        with contextmanager(install_plugins)(player.folder / "packages"):
            for seed in seeds:
                yield player.play(seed)
                if player.stop.is_set():
                    break
        return
    # A fork would not have the threads that OpenCV has begun for the bundles, and would wait for them.
    context, left = multiprocessing.get_context("spawn"), iter(seeds)
    with ProcessPoolExecutor(jobs, context, _begin, (player,)) as pool:
        on = {pool.submit(_play, seed) for seed in islice(left, jobs)}
        while on:
            done, on = wait(on, return_when=FIRST_COMPLETED)
            for one in done:
                yield one.result()
            if not player.stop.is_set():
                on |= {pool.submit(_play, seed) for seed in islice(left, len(done))}


_player: Player


def _begin(player: Player) -> None:
    """Prepare a process of several. It does not hear Ctrl-C, which the first one waits for."""
    global _player
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _player = player
    own = multiprocessing.current_process().name
    next(install_plugins(player.folder / f"packages of {own}"))
    player.begin()


def _play(seed: int) -> tuple[Run, Path | None]:
    return _player.play(seed)


def stop_at_signal(stop: Event) -> None:
    """Let Ctrl-C, or SIGTERM, stop the search after the runs that are on; a second one ends it at once."""

    def hear(number: int, frame: FrameType | None) -> None:
        stop.set()
        signal.signal(number, signal.default_int_handler)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, hear)
