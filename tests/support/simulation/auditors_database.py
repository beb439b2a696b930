"""What holds while another program locks the database (docs/operations.md, What happens when)."""

from collections.abc import Iterator

from simulation.lives import Station
from simulation.sensor import S
from simulation.surroundings import World

WAITED_S = 4.5
"""A shorter lock is waited for."""

SAID_S = 12.0
"""By then the thread that records has waited, after another one that did."""

LOCKED = {"database locked"}


def audit_locked(world: World, station: Station) -> Iterator[str]:
    """A short lock is no alarm; one that keeps a press from being recorded is."""
    now_ns, locker = world.clock.now_ns, station.disk.locker
    is_raised = "store" in station.loop.parts.status.view().alarms
    raised_ns = station.so_since("store is raised", is_raised)
    locked_ns = station.so_since("locked", locker.is_refusing)
    only_ns = station.so_since("only locked", locker.is_refusing and world.sensor.troubles == LOCKED)
    if locked_ns is None or only_ns != locked_ns:
        return
    is_alone = (
        locked_ns - max(locker.left_ns, station.began_ns) > S
    )  # nobody waits any more since the one before
    if raised_ns is not None and is_alone and locked_ns < raised_ns < locked_ns + WAITED_S * S:
        yield f"the database is locked for {(raised_ns - locked_ns) / S:.1f} s, and the alarm store is raised"
    for press in world.hand.presses:
        is_over = locked_ns < press.end_ns < now_ns - SAID_S * S
        is_sure = all(why in LOCKED or why.startswith("the station said") for why in press.why)
        has_row = any(seen.noted_ns > press.begin_ns for seen in station.seen)
        if is_over and is_sure and press.is_asked and not (is_raised or has_row):
            yield f"press {press.number} waits for a locked database, and the alarm store is not raised"
