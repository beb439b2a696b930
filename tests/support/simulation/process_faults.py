"""Faults of the process: it ends, gets no time, or its loop hangs (`faults.py`)."""

import random
from collections.abc import Callable
from typing import TYPE_CHECKING

from edge.core.errors import StoreError
from simulation.moments import is_unjudged
from simulation.sensor_faults import let_lie, until_next_part

if TYPE_CHECKING:
    from pathlib import Path

    from simulation.power import Unsynced
    from simulation.schedule import Simulation


def stop(run: "Simulation", rng: random.Random, meanwhile: Callable[[], object] = lambda: None) -> float:
    """The service is restarted: SIGTERM."""
    run.note("stopped in order")
    run.world.sensor.disturb("the gateway was restarted")
    run.reach_here("restarted")
    if run.station.disk.is_full:
        run.reach("restarted while the disk was full")
        run.note_uncounted()
    try:
        run.station.stop()
    except StoreError as error:
        run.note(f"it did not end well: {error}")
    meanwhile()
    run.open_again()
    return 0.0


def lose_database(run: "Simulation", rng: random.Random) -> float:
    """Somebody removes the database while the service is stopped."""
    # The second record of the count, that may be one press behind after a power cut, is mended with the first frame.
    if run.station.is_disk_disturbed or run.station.loop.session is None:
        return -0.5
    stop(run, rng, run.station.lose_database)
    run.world.parts.forget(run.world.clock.now_ns)
    run.reach("the database was removed")
    return 0.0


def kill(run: "Simulation", rng: random.Random) -> float:
    """The process is killed at one of its next writes."""
    run.station.disk.kill_in = _next_writes(run, rng)
    return 0.0


def lose_power(run: "Simulation", rng: random.Random) -> float:
    """The power is lost at one of the next writes: what was not synced is lost in part."""

    def lose(unsynced: "Unsynced", copy: "Path") -> None:
        if unsynced.lose(copy, rng):
            run.reach("writes were lost with the power")

    run.station.disk.kill_in, run.station.disk.lost = _next_writes(run, rng), lose
    return 0.0


def _next_writes(run: "Simulation", rng: random.Random) -> int:
    """One press and its answers take some 25; of a verdict that comes next, and of a full disk, the first are meant."""
    return rng.randint(1, 4 if run.station.disk.is_full or is_unjudged(run) else 25)


def freeze(run: "Simulation", rng: random.Random) -> float:
    """The process gets no time for a while: the machine is suspended, or short of memory."""
    lasts_s, began_ns = rng.choice((0.3, 0.9, 1.3, 3.0, 8.0)), run.world.clock.now_ns

    def go_on() -> None:
        run.freeze(0)
        # Nobody could open a board that was plugged in meanwhile.
        if run.world.relay.well_since_ns > began_ns:
            run.world.relay.well_since_ns = run.world.clock.now_ns

    lasts_s = until_next_part(run, rng, lasts_s)
    let_lie(run, rng, lasts_s)
    run.freeze(lasts_s)
    return run.for_a_while("process frozen", lasts_s, go_on, is_sensors=True)


def hang(run: "Simulation", rng: random.Random) -> float:
    """The loop alone gets no time, between two frames or when it judges or records a press: its detector, or its disk,
    is slow. Other threads go on with what it said last."""
    station, lasts_s = run.station, rng.choice((0.9, 2.5, 4.0, 9.0))

    def go_on() -> None:
        station.is_hanging = False

    def begin() -> None:
        station.is_hanging = True
        run.for_a_while("loop hangs", until_next_part(run, rng, lasts_s), go_on, is_sensors=True)

    station.hangs_in, station.on_hang = rng.choice(("a turn", "a verdict", "a commit")), begin
    return lasts_s


def kill_start(run: "Simulation", rng: random.Random) -> float:
    """The service is restarted, and killed at a write of its start."""

    def kill_soon() -> None:
        run.station.disk.kill_in = rng.randint(1, 4)

    stop(run, rng, kill_soon)
    if run.station.disk.is_dead:
        run.reach("killed while it started")
    return 0.0


def stop_hanging(run: "Simulation", rng: random.Random) -> float:
    """SIGTERM comes while the loop hangs, which ends with its turn."""
    lasts_s, number = hang(run, rng), len(run.station.hung)

    def end() -> None:
        if (
            "loop hangs" in run.ending
            or run.station.hangs_in
            or run.world.connections.turns["loop"].is_waiting
        ):
            run.later(0.02, end)
        elif len(run.station.hung) > number:
            run.reach("restarted as soon as the loop did not hang any more")
            stop(run, rng)

    run.later(0.02, end)
    return lasts_s
