"""What must hold, written against docs/ and not against the code. Each auditor gives sentences; none is a good run."""

import json
import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

from edge.core.errors import ArchiveError
from edge.features.black_box.replay import Bundles, judge_again
from edge.store.integrity import check_database
from edge.store.press_archive import ArchiveFolder
from simulation.lives import Station
from simulation.outputs import DEADLINE_S, GATE, LAMP, REJECT
from simulation.surroundings import SERIAL, Broker, S, World

CALM_S = 60
"""So long after the last fault everything has left, and the station is ready (docs/operations.md)."""


OPENED_S = 6
"""A relay that is plugged in is opened so soon, and all of its outputs are written (docs/operations.md)."""

SHOWN_S = 0.7
"""A press is noticed, and the relay switched, so long after its begin."""

OLDEST_S = 1.0
"""An older frame is refused (docs/operations.md)."""

LONGEST_S = 3.0
"""A pulse belongs to a press of this time before it."""

LATEST_S = 1.5
"""A press that has no judged frame has the time of its row, so long after its end at most."""


def _audit_results(world: World, station: Station) -> Iterator[str]:
    """What holds of all that a subscriber got: one result a press, with a verdict or an error."""
    for broker in world.brokers.values():
        for press_id, results in broker.results.items():
            kept = [{key: value for key, value in one.items() if key != "is_replayed"} for one in results]
            if any(one != kept[0] for one in kept):
                yield f"{broker.name}: two results of press {press_id} differ"
            if results[0]["verdict"] is None and not results[0]["error"]:
                yield f"{broker.name}: press {press_id} has neither a verdict nor an error"


def audit_now(world: World) -> Iterator[str]:
    """What holds while the hand holds a part: no pass of an earlier one is shown, nor one of a dented part."""
    press, relay, now_ns = world.sensor.press, world.relay, world.clock.now_ns
    if press is None or press.why or not press.is_dented or not relay.is_on[LAMP]:
        return
    is_well = relay.mood == "up" and now_ns - relay.well_since_ns > OPENED_S * S
    if is_well and now_ns - press.begin_ns > SHOWN_S * S:
        yield f"press {press.number} is dented, and a pass is shown"


def audit_end(world: World, station: Station) -> Iterator[str]:
    """What holds when all is calm again."""
    yield from _audit_results(world, station)
    yield from _audit_presses(world, station)
    yield from _audit_judged(station)
    yield from _audit_outputs(world, station)
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


def audit_replay(world: World, station: Station, bundles: Sequence[Path]) -> Iterator[str]:
    """An archived press scores the same again, bit for bit (docs/operations.md)."""
    path = station.disk.folder / "gelgate.db"
    again, archive = Bundles(bundles, world.clock), ArchiveFolder(path.with_suffix(".archive"))
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
        query = "SELECT press_id, evidence FROM presses WHERE evidence IS NOT NULL AND verdict IN ('pass', 'fail')"
        rows = list(connection.execute(query))
    for press_id, evidence in rows:
        try:
            press = archive.press(press_id, evidence)
            replayed = judge_again(press, archive, again.inspector(press))
        except ArchiveError:
            continue  # the archive drops, and may be lost with the power
        for difference in replayed.differences:
            yield f"press {press_id} scores otherwise when it is judged again: {difference}"


def _audit_presses(world: World, station: Station) -> Iterator[str]:
    """Each press of the hand is one row, in order, with its verdict; where a fault was, it may be lost."""
    rows = read_presses(station.disk.folder / "gelgate.db")
    found: dict[int, list[tuple[str, str, str, str]]] = {}
    times = {seen.press_id: seen.frame_ns or seen.noted_ns for seen in station.seen}
    for row in rows:
        seen_ns = times.get(row[0])
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
        for _, verdict, part, gel in own:
            if not press.why and not world.parts.allows(press, part):
                yield f"press {press.number} is judged as {part}, and another part was selected at its begin"
            if not press.why and not world.gels.allows(press, gel):
                yield f"press {press.number} counts on gel {gel}, and another gel was mounted at its begin"
            if press.is_dented and verdict == "pass":
                yield f"press {press.number} is dented and passed ({', '.join(press.why) or 'no fault'})"
            if not press.why and verdict != ("fail" if press.is_dented else "pass"):
                yield f"press {press.number} has the verdict {verdict}, without any fault"


def _audit_judged(station: Station) -> Iterator[str]:
    """A verdict is of a frame of the same second, and of the same uninterrupted press."""
    for seen in station.seen:
        if seen.word not in ("pass", "fail") or seen.frame_ns is None:
            continue
        age_s = (seen.judged_ns - seen.frame_ns) / S
        if OLDEST_S < age_s < 10:  # otherwise the wall clock was set
            yield f"the frame of press {seen.press_id} was {age_s:.1f} s old when it was judged"
        if seen.is_over_gap:
            yield f"press {seen.press_id} was judged by a frame from before an interruption"


def _audit_outputs(world: World, station: Station) -> Iterator[str]:
    """Each output belongs to one press that was judged so, and none comes after its deadline."""
    unused = {REJECT: [one for one in station.seen if one.word != "pass"]}
    unused |= {GATE: [one for one in station.seen if one.word == "pass"]}
    for one in world.relay.switched:
        when = f"at {one.told_ns / S:.3f} s"
        if one.channel == LAMP:
            before = [seen.word for seen in station.seen if seen.noted_ns <= one.told_ns]
            if before[-1:] != ["pass"]:
                yield f"a pass was shown {when}, and the last press was {before[-1:] or 'none'}"
            continue
        presses = unused[one.channel]
        own = [
            seen for seen in presses if 0 <= one.told_ns - (seen.frame_ns or seen.judged_ns) < LONGEST_S * S
        ]
        if not own:
            noted = [*(seen.noted_ns for seen in station.seen if seen.noted_ns >= one.told_ns), 1 << 62][0]
            if not any(
                one.told_ns <= killed <= noted for killed in station.ended_ns
            ):  # before it was recorded
                yield f"the pulse on channel {one.channel} {when} belongs to no press"
            continue
        presses.remove(own[-1])
        if own[-1].frame_ns is not None and one.told_ns - own[-1].frame_ns > DEADLINE_S * S:
            yield f"the pulse on channel {one.channel} {when} was given after its deadline"


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
    for press_id, _, part, gel in read_presses(path):
        results = broker.results.get(press_id, [])
        if any((one["gel_id"], one["part"]) != (gel, part) for one in results):
            yield f"{broker.name}: the result of press {press_id} has another gel or part than its row"
    without = [
        row[0] for row in read_presses(path) if row[1] in ("pass", "fail") and not broker.pictures[row[0]]
    ]
    if without:
        yield f"{broker.name}: {len(without)} presses have no picture message"


def read_presses(path: Path) -> list[tuple[str, str, str, str]]:
    """Id, verdict, part and gel of each row, in order."""
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
        query = "SELECT press_id, verdict, part, gel_id FROM presses WHERE serial = ? ORDER BY number"
        return list(connection.execute(query, (SERIAL,)))
