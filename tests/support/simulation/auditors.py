"""What must hold, written against docs/ and not against the code. Each auditor gives sentences; none is a good run."""

import json
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from edge.store.integrity import check_database
from simulation.lives import Station
from simulation.surroundings import SERIAL, Broker, S, World

CALM_S = 60
"""So long after the last fault everything has left, and the station is ready (docs/operations.md)."""


LATEST_S = 1.5
"""A press that has no judged frame has the time of its row, so long after its end at most."""


def audit_always(world: World, station: Station) -> Iterator[str]:
    """What holds at every moment: no press is doubled, and none passes that must not."""
    for broker in world.brokers.values():
        for press_id, results in broker.results.items():
            kept = [{key: value for key, value in one.items() if key != "is_replayed"} for one in results]
            if any(one != kept[0] for one in kept):
                yield f"{broker.name}: two results of press {press_id} differ"
            if results[0]["verdict"] is None and not results[0]["error"]:
                yield f"{broker.name}: press {press_id} has neither a verdict nor an error"


def audit_end(world: World, station: Station) -> Iterator[str]:
    """What holds when all is calm again."""
    yield from audit_always(world, station)
    yield from _audit_presses(world, station)
    yield from _audit_ledger(
        station.disk.folder / "gelgate.db", sum(bool(one.why) for one in world.sensor.presses)
    )
    for broker in world.brokers.values():
        yield from _audit_subscriber(broker, station.disk.folder / "gelgate.db")
        state = json.loads(broker.retained.get("state", b"null"))
        if state is None or state["state"] != "ready":
            yield f"{broker.name} retains the state {state and state['state']} {CALM_S} s after the last fault"
    status = station.loop.parts.publisher.outbox_status()
    if status.rows:
        yield f"{status.rows} messages still wait {CALM_S} s after the last fault"


def _audit_presses(world: World, station: Station) -> Iterator[str]:
    """Each press of the hand is one row, in order, with its verdict; where a fault was, it may be lost."""
    rows = read_presses(station.disk.folder / "gelgate.db")
    found: dict[int, list[tuple[str, str, int]]] = {}
    for row in rows:
        seen_ns = station.seen_ns.get(row[0])
        made = [one for one in world.sensor.presses if seen_ns and one.begin_ns <= seen_ns]
        if not made or seen_ns > made[-1].end_ns + LATEST_S * S:
            when = seen_ns and f"{seen_ns / S:.2f} s"
            yield f"row {row[0]} ({row[1]}) at {when} belongs to no press of the hand"
            continue
        found.setdefault(made[-1].number, []).append(row)
    for press in world.sensor.presses:
        own = found.get(press.number, [])
        if len(own) > 1 and not press.why:
            yield f"press {press.number} has {len(own)} rows"
        if not own and not press.why:
            yield f"press {press.number} at {press.begin_ns / S:.2f} s is lost, without any fault"
        for _, verdict, _ in own:
            if press.is_dented and verdict == "pass":
                yield f"press {press.number} is dented and passed ({', '.join(press.why) or 'no fault'})"
            if not press.why and verdict != ("fail" if press.is_dented else "pass"):
                yield f"press {press.number} has the verdict {verdict}, without any fault"


def _audit_ledger(path: Path, disturbed: int) -> Iterator[str]:
    """Every row is a press of its gel; presses without a row are counted too, and there are no more than were made."""
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
        rows = Counter(gel for (gel,) in connection.execute("SELECT gel_id FROM presses"))
        for gel, presses in connection.execute("SELECT gel_id, presses FROM gels"):
            if not rows[gel] <= presses <= rows[gel] + disturbed:
                yield f"gel {gel} has {presses} presses, and {rows[gel]} rows"
    yield from (
        f"the database is not sound: {finding.text}" for finding in check_database(path) if finding.is_fault
    )


def _audit_subscriber(broker: Broker, path: Path) -> Iterator[str]:
    """The subscriber has each row once by its id, in order, with one picture at least."""
    ids = [row[0] for row in read_presses(path)]
    order = broker.order
    if sorted(order) != sorted(ids):
        lacking = [one for one in ids if one not in order]
        more = [one for one in order if one not in ids]
        yield f"{broker.name}: {len(lacking)} results lack, {len(more)} are of no row"
    elif order != ids and not broker.has_refused_results:  # those are offered again later, behind others
        yield f"{broker.name}: the results came in another order than they were made"
    without = [
        row[0] for row in read_presses(path) if row[1] in ("pass", "fail") and not broker.pictures[row[0]]
    ]
    if without:
        yield f"{broker.name}: {len(without)} presses have no picture message"


def read_presses(path: Path) -> list[tuple[str, str, int]]:
    """Id, verdict and running time of each row, in order."""
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
        query = "SELECT press_id, verdict, time_ns FROM presses WHERE serial = ? ORDER BY number"
        return list(connection.execute(query, (SERIAL,)))
