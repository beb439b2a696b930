"""Faults of the disk, and another program at the database (`faults.py`)."""

import random
from typing import TYPE_CHECKING

from simulation.disk import ROOM_BYTES
from simulation.process_faults import stop

if TYPE_CHECKING:
    from simulation.schedule import Simulation

LITTLE_BYTES = 10**6
"""Free, and less than `store.free_mb`."""


def fill_disk(run: "Simulation", rng: random.Random) -> float:
    """No room on the disk, then room again, sometimes little at first."""
    disk = run.station.disk
    lasts_s, room = rng.uniform(8 if run.is_full_and_away else 1, 14), rng.choice((0, 0, 30_000))
    if "replace gel" in run.meeting:
        room = max(
            room, 200_000
        )  # a gel and some presses are recorded, and no file of the archive is written
    disk.fill(room)
    disk.full_since_ns = run.world.clock.now_ns
    if run.station.loop.parts.selection.is_waiting:
        run.world.parts.forget(run.world.clock.now_ns)

    is_little = room == 0 and rng.random() < 0.5

    def make_room() -> None:
        disk.fill(None)
        run.world.may_lack_files(run.world.clock.now_ns)
        if is_little and not run.world.hand.is_done:
            disk.free_bytes = LITTLE_BYTES
            run.for_a_while("disk nearly full", 14.0, make_more)

    def make_more() -> None:
        disk.free_bytes = ROOM_BYTES
        run.world.may_lack_files(run.world.clock.now_ns)

    return run.for_a_while("disk full", lasts_s, make_room)


def slow_disk(run: "Simulation", rng: random.Random) -> float:
    """Each flush takes its time."""
    unsynced = run.station.disk.unsynced
    assert unsynced is not None
    takes_s = rng.choice((0.02, 0.1, 0.4))
    unsynced.at_sync = lambda: run.world.clock.sleep(takes_s)

    def mend() -> None:
        unsynced.at_sync = None

    return run.for_a_while("disk slow", rng.uniform(1, 8), mend, is_sensors=True)


def bad_disk(run: "Simulation", rng: random.Random) -> float:
    """Some reads, writes or flushes of the database end in an error."""
    unsynced = run.station.disk.unsynced
    assert unsynced is not None
    what, share, own = (
        rng.choice(("read", "write", "sync")),
        rng.choice((0.1, 0.5)),
        random.Random(rng.random()),
    )
    unsynced.fails = lambda call: call == what and own.random() < share
    run.station.disk_faults += 1
    run.world.parts.forget(run.world.clock.now_ns)
    run.world.gels.forget(run.world.clock.now_ns)
    run.reach(f"the disk failed to {what}")

    def mend() -> None:
        unsynced.fails = None
        run.station.disk_faults += 1
        run.world.parts.forget(run.world.clock.now_ns)
        run.world.gels.forget(run.world.clock.now_ns)

    return run.for_a_while("disk errs", rng.uniform(0.5, 5), mend, is_sensors=True)


def lock_database(run: "Simulation", rng: random.Random) -> float:
    """Another program locks the database: a shell, a check or a backup; or it is alone while the station starts."""
    locker, kind = run.station.disk.locker, rng.choice(("writes", "writes", "writes", "reads", "is alone"))
    if kind == "is alone" and not run.world.hand.presses:
        return -1.0
    lasts_s = rng.choice((0.05, 0.6, 2.0, 4.0, 8.0, 15.0, 30.0))
    lasts_s = min(lasts_s, 8.0) if kind == "reads" else lasts_s

    def leave() -> None:
        locker.leave()
        locker.left_ns = run.world.clock.now_ns

    def lock() -> bool:
        is_taken = locker.take(kind)
        if is_taken:
            if run.station.loop.parts.selection.is_waiting:
                run.world.parts.forget(run.world.clock.now_ns)
            run.reach(f"another program {kind} at the database")
            run.for_a_while("database locked", lasts_s, leave, is_sensors=True)
        return is_taken

    if kind == "is alone" and not run.ending.keys() & {"database locked", "disk full", "disk errs"}:
        stop(run, rng, lock)
        return lasts_s
    return lasts_s if lock() else -0.1
