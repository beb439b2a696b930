"""What must hold, written against docs/ and not against the code. Each auditor gives sentences; none is a good run."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from edge.core.errors import ArchiveError
from edge.features.black_box.replay import Bundles, judge_again
from edge.store.integrity import check_database
from edge.store.press_archive import ArchiveFolder
from simulation.alarms import RECORDED, SEEN, audit_alarms, is_sensor_lost
from simulation.auditors_brokers import audit_availability, audit_levels
from simulation.auditors_bundles import audit_bundles, audit_judges
from simulation.auditors_contact import audit_contact, audit_lifts, audit_overloads
from simulation.auditors_database import audit_locked
from simulation.auditors_features import (
    audit_master,
    audit_overview,
    audit_snapshots,
    may_lack_still,
)
from simulation.auditors_outbox import (
    ARCHIVED,
    audit_archive,
    audit_file,
    audit_full_outbox,
    audit_kept,
    audit_memory,
)
from simulation.auditors_outputs import audit_lamp, audit_outputs, audit_pulses
from simulation.auditors_pieces import audit_piece_lamp, audit_pieces
from simulation.auditors_plc import audit_answers, audit_plcs, may_be_other_part
from simulation.auditors_retained import audit_late, audit_outbox, audit_retained, audit_serials
from simulation.brokers import Broker
from simulation.bundles import PARTS
from simulation.lives import Row, Station, find_lasting
from simulation.sensor import S
from simulation.surroundings import World

ANSWERED_S = 2.0
"""The loop answers a request with its next turn, also while the store refuses (docs/architecture.md)."""

CALM_S = 60
"""So long after the last fault everything has left, and the station is ready (docs/operations.md)."""


OLDEST_S = 1.0
"""An older frame is refused (docs/operations.md)."""

LEARNS_S = (0.3, 0.6)
"""When the picture of a new gel is being learnt, after its replacement."""

LONG_UNSEEN_S, NOTED_S = 4, 0.5
"""A time without sight that is an act for certain, noted so long after the gel is seen (docs/operations.md)."""

RESTS_S = 0.45
"""After an interruption the exposure settles for 0.3 s, and then a press rests for 0.2 s (docs/contact.md)."""

AGAIN = {"the gateway was killed", "the gateway was restarted", "it began just after an interruption"}
"""After these a part that still presses may be judged again, or a press count as one with that before."""

LATEST_S = 1.5
"""A press that has no judged frame has the time of its row, so long after its end at most."""


def _audit_results(world: World, station: Station) -> Iterator[str]:
    """What holds of all that a subscriber got: one result a press, with a verdict or an error, and all of it judged."""
    for broker in world.brokers.values():
        for press_id, results in broker.results.items():
            kept = [{key: value for key, value in one.items() if key != "is_replayed"} for one in results]
            if any(one != kept[0] for one in kept):
                yield f"{broker.name}: two results of press {press_id} differ"
            shadow = results[0]["shadow"]
            is_passing = shadow is not None and (shadow["verdict"] == "pass" or bool(world.shelf.heir))
            if shadow is not None and (is_passing, results[0]["part"]) != (True, PARTS[0]):
                yield f"{broker.name}: the shadow says {shadow['verdict']} of press {press_id} of {results[0]['part']}"
            if results[0]["blind_share"] and not world.hand.marked_ns:
                yield f"{broker.name}: a part of press {press_id} was not judged, and no gel has a scar"
            if results[0]["verdict"] is None and not results[0]["error"]:
                yield f"{broker.name}: press {press_id} has neither a verdict nor an error"


def audit_now(world: World, station: Station) -> Iterator[str]:
    """What holds at each moment."""
    if world.sensor.is_other_taken:  # docs/operations.md, Two sensors
        yield "of two sensors the station has opened one, and its own is the other"
    yield from audit_lamp(world, station)
    yield from audit_contact(world, station)
    yield from audit_plcs(world, station)
    yield from audit_piece_lamp(world, station)
    yield from audit_availability(world, station)
    yield from _audit_new_gel(world, station)
    yield from audit_alarms(world, station, SEEN, is_held_up=station.is_held_up)
    yield from audit_locked(world, station)
    yield from audit_bundles(world, station)
    yield from _audit_sight(world, station)
    is_unsaid = station.is_loss_open and "counts" not in station.loop.parts.status.view().alarms
    lost_ns = station.so_since("a loss is not said", is_unsaid and station.loop.session is not None)
    now_ns = world.clock.now_ns
    waiting = station.loop.parts.calls._waiting  # others may have come since
    oldest_ns = waiting[0][0] if waiting else None
    since_ns = station.so_since(f"a request waits {oldest_ns}", bool(waiting) and not station.is_held_up)
    if since_ns is not None and now_ns - since_ns > ANSWERED_S * S:
        yield f"a request has no answer after {ANSWERED_S} s"
    if lost_ns is not None and now_ns - lost_ns > ANSWERED_S * S:
        yield "presses or the database were lost, and no alarm says so"
    before_ns = now_ns - world.sensor.period_ns
    if now_ns // S != before_ns // S:
        yield from audit_full_outbox(world, station)
        yield from audit_kept(world, station)
        yield from audit_snapshots(world, station)
    if now_ns // (2 * S) != before_ns // (2 * S):
        yield from audit_alarms(world, station, RECORDED, is_held_up=station.is_kept_from_it)
    if now_ns // (5 * S) != before_ns // (5 * S):
        yield from audit_outbox(station)


def _audit_new_gel(world: World, station: Station) -> Iterator[str]:
    """A new gel is learnt before it is pressed: the station is not ready at once (docs/operations.md)."""
    age_s = (world.clock.now_ns - world.new_gel_ns) / S
    is_same_life = world.new_gel_ns > station.began_ns and not station.is_frozen
    # A loop that has just gone on still looks at frames of before.
    is_behind = any(0 <= world.new_gel_ns - ended_ns < S for _, ended_ns in station.hung)
    is_ready = station.loop.parts.status.view().state == "ready"
    if is_same_life and not is_behind and LEARNS_S[0] < age_s < LEARNS_S[1] and is_ready:
        yield f"the gel was replaced {age_s:.1f} s ago, and the station is ready at once"


def audit_end(world: World, station: Station) -> Iterator[str]:
    """What holds when all is calm again."""
    yield from _audit_results(world, station)
    found = find_rows(world, station)
    yield from _audit_presses(world, station, found)
    yield from _audit_judged(station)
    yield from audit_outputs(world, station)
    yield from audit_pulses(world, station)
    yield from audit_lifts(world, station)
    yield from audit_overloads(world, station)
    yield from audit_answers(world, station, found)
    yield from audit_judges(world, station)
    for seen in station.seen:
        if seen.frame_ns in world.sensor.others and seen.word in ("pass", "fail"):
            yield f"press {seen.press_id} was judged by a frame of a second sensor"
    yield from audit_pieces(world, station)
    yield from audit_retained(world, station)
    yield from audit_late(world, station)
    yield from audit_serials(station)
    yield from audit_levels(world)
    yield from audit_file(station)
    yield from audit_archive(station)
    yield from audit_memory(world, station)
    yield from audit_overview(world, station, found)
    yield from audit_master(world, station)
    yield from station.found
    without = [press for press in world.hand.presses if press.number not in found]
    must = sum(press.must_count for press in without)
    most = sum(press.may_count for press in world.hand.presses)
    yield from _audit_ledger(station, 0 if station.lost_rows else must, most)
    yield from _audit_requests(station)
    for broker in world.brokers.values():
        yield from _audit_subscriber(broker, station)
        state = json.loads(broker.retained.get("state", b"null"))
        if state is None or state["state"] != "ready":
            yield f"{broker.name} retains the state {state and state['state']} {CALM_S} s after the last fault"
    status = station.loop.parts.publisher.outbox_status()
    if status.rows:
        yield f"{status.rows} messages still wait {CALM_S} s after the last fault"
    for alarm in sorted(find_lasting(station)):
        yield f"the alarm {alarm} is still raised {CALM_S} s after the last fault"


def audit_replay(world: World, station: Station, bundles: Sequence[Path]) -> Iterator[str]:
    """An archived press scores the same again, bit for bit; the newest before a crash may lack, and those that people
    spoke of may take half of the room (docs/security.md)."""
    again = Bundles(bundles, world.clock)
    archive = ArchiveFolder(station.disk.folder / "gelgate.archive")
    words = station.disk.read("SELECT count(*) FROM acts WHERE verb = 'confirm_press'")[0][0]
    kept = ARCHIVED // 2 if words else ARCHIVED
    query = "SELECT press_id, evidence, verdict FROM presses WHERE evidence IS NOT NULL ORDER BY number DESC"
    for newer, (press_id, evidence, verdict) in enumerate(station.disk.read(query)):
        if verdict not in ("pass", "fail"):
            continue
        try:
            press = archive.press(press_id, evidence)
            for digest in press.objects:
                archive.read(digest, "what it was made from")
            replayed = judge_again(press, archive, again.inspector(press))
        except ArchiveError as error:  # the archive drops, and may be lost with the power
            own = next((seen for seen in station.seen if seen.press_id == press_id), None)
            if own is None:  # a kill came before it was reported, and its files are written later
                continue
            # A loop that hangs when it has recorded a press writes its files when it goes on.
            hung = [ended_ns for began_ns, ended_ns in station.hung if began_ns == own.noted_ns]
            written_ns = max([own.noted_ns, *hung])
            is_before_crash = any(0 <= killed_ns - written_ns < S for killed_ns in station.killed_ns)
            if newer < kept - 1 and own.judged_ns > world.lacks_files_ns and not is_before_crash:
                yield f"press {press_id}, the newest but {newer}, is not in the archive: {error}"
            continue
        for difference in replayed.differences:
            yield f"press {press_id} scores otherwise when it is judged again: {difference}"


def find_rows(world: World, station: Station) -> dict[int | None, list[Row]]:
    """Find the rows of each press of the hand by its number; None: those of no press.

    A commit whose sync fails may be on the disk. The next try finds it, or a kill comes first: then no process has
    reported the press, one for each kill.
    """
    rows, unreported = station.rows(), len(station.killed_ns)
    found: dict[int | None, list[Row]] = {}
    times = {seen.press_id: seen.frame_ns or seen.judged_ns for seen in station.seen}
    for row in rows:
        seen_ns = times.get(row[0])
        if seen_ns is None and unreported:
            unreported -= 1
            continue
        made = [one for one in world.hand.presses if seen_ns and one.begin_ns <= seen_ns]
        if not made or (seen_ns > made[-1].end_ns + LATEST_S * S and not made[-1].why):
            found.setdefault(None, []).append(row)
            continue
        found.setdefault(made[-1].number, []).append(row)
    return found


def _audit_presses(world: World, station: Station, found: dict[int | None, list[Row]]) -> Iterator[str]:
    """Each press of the hand is one row, in order, with its verdict; where a fault was, it may be lost."""
    for row in found.get(None, []):
        when = [seen.noted_ns / S for seen in station.seen if seen.press_id == row[0]]
        yield f"row {row[0]} ({row[1]}) at {when} s belongs to no press of the hand"
    for press in world.hand.presses:
        own = found.get(press.number, [])
        if len(own) > 1 and not press.why:
            yield f"press {press.number} has {len(own)} rows"
        judged = [row[0] for row in own if row[1] in ("pass", "fail")]
        if len(judged) > 1 and not press.why & AGAIN:
            yield f"press {press.number} was judged {len(judged)} times ({', '.join(press.why)})"
        if own and press.master_ns and not press.why:
            yield f"press {press.number} is of the master piece, and has a result"
        if not own and not press.why and not press.master_ns:
            yield f"press {press.number} at {press.begin_ns / S:.2f} s is lost, without any fault"
        for _, verdict, part, gel in own:
            if not press.why and not world.parts.allows(press, part):
                yield f"press {press.number} is judged as {part}, and another part was selected at its begin"
            if not press.why and not world.gels.allows(press, gel):
                yield f"press {press.number} counts on gel {gel}, and another gel was mounted at its begin"
            if press.is_others and verdict in ("pass", "fail"):
                yield f"press {press.number} was made on another sensor, and is judged"
            if not (press.is_asked or press.why) and verdict in ("pass", "fail"):
                yield f"press {press.number} is judged, and nobody asked for it"
            if press.is_bad and verdict == "pass":
                yield f"press {press.number} is {press.what} and passed ({', '.join(press.why) or 'no fault'})"
            allowed = press.words | ({"unsure"} if world.is_again and "fail" in press.words else set())
            allowed |= (
                {"rejected"}
                if world.has_pieces or may_be_other_part(world, press) or may_lack_still(world, press)
                else set()
            )  # a place, or a part, that is not expected
            if not press.why and verdict not in allowed:
                yield f"press {press.number}, {press.what}, has the verdict {verdict}, without any fault"


def _audit_judged(station: Station) -> Iterator[str]:
    """A verdict is of a frame of the same second, and of the same uninterrupted press."""
    for seen in station.seen:
        if seen.word not in ("pass", "fail") or seen.frame_ns is None:
            continue
        age_s = (seen.judged_ns - seen.frame_ns) / S
        if age_s > OLDEST_S:
            yield f"the frame of press {seen.press_id} was {age_s:.1f} s old when it was judged"
        if seen.after_gap_s < RESTS_S:
            yield f"press {seen.press_id} was judged {seen.after_gap_s:.2f} s after an interruption"
        if seen.is_over_gap:
            yield f"press {seen.press_id} was judged by a frame from before an interruption"


def _audit_ledger(station: Station, least: int, most: int) -> Iterator[str]:
    """Every row is a press of its gel, and between `least` and `most` presses without a row are counted too: those that
    were made while the database refused writes (docs/operations.md)."""
    total, path = 0, station.disk.folder / "gelgate.db"
    rows = Counter(gel for _, _, _, gel in station.rows())
    rows.update(station.master_gels())
    for gel, presses in station.disk.read("SELECT gel_id, presses FROM gels"):
        total += presses - rows[gel]
        if not rows[gel] <= presses <= rows[gel] + most:
            yield f"gel {gel} has {presses} presses, and {rows[gel]} rows"
    if not least <= total <= most:
        yield f"the gels have {total} presses more than rows, and {least} to {most} were made without one"
    yield from (
        f"the database is not sound: {finding.text}" for finding in check_database(path) if finding.is_fault
    )


def _audit_subscriber(broker: Broker, station: Station) -> Iterator[str]:
    """The subscriber has each row once by its id, in order, with one picture at least; but for what was dropped from a
    full outbox, and what was unsent in a database that was removed."""
    rows, order = station.rows(), broker.order
    ids, dropped = [row[0] for row in rows], station.dropped_before + Counter(station.dropped)
    lacking = [row[0] for row in rows[len(station.lost_rows) :] if row[0] not in order]
    more = [one for one in order if one not in ids]
    if len(lacking) > dropped["pass"] + dropped["fail"] or more:
        yield f"{broker.name}: {len(lacking)} results lack, {len(more)} are of no row"
    elif order != [one for one in ids if one in order] and not broker.has_refused_results:
        yield f"{broker.name}: the results came in another order than they were made"  # refused ones come later
    numbers = [broker.results[press_id][0]["sequence"] for press_id in ids if press_id in broker.results]
    if any(int(str(later)) <= int(str(then)) for then, later in pairwise(numbers)):
        yield f"{broker.name}: the numbers of the presses do not rise"
    for press_id, _, part, gel in rows:
        results = broker.results.get(press_id, [])
        if any((one["gel_id"], one["part"]) != (gel, part) for one in results):
            yield f"{broker.name}: the result of press {press_id} has another gel or part than its row"
    judged = [row[0] for row in rows[len(station.lost_rows) :] if row[1] in ("pass", "fail")]
    without = [press_id for press_id in judged if not broker.pictures[press_id]]
    if len(without) > dropped["heatmap"]:
        yield f"{broker.name}: {len(without)} presses have no picture message"
    if broker.misnamed:
        yield f"{broker.name}: {len(broker.misnamed)} pictures name another press than their topic"


def _audit_sight(world: World, station: Station) -> Iterator[str]:
    """Each time without sight is an act when all is well again, for presses may have been made in it
    (docs/operations.md)."""
    now_ns, troubles = world.clock.now_ns, sorted(world.sensor.troubles)
    lost_ns = station.so_since("no sight", is_sensor_lost(world, station), troubles)
    is_unseen = is_sensor_lost(world, station) or world.sensor.damage[0] != ""
    is_disturbed = is_unseen or station.is_disk_disturbed or station.is_held_up
    is_well = not is_disturbed and station.loop.parts.status.view().state == "ready"
    well_ns = station.so_since("sight", is_well)
    is_long = lost_ns is not None and now_ns - lost_ns > LONG_UNSEEN_S * S
    if station.acts_before is None and is_long and any(fed_ns < lost_ns for fed_ns in station.fed_ns[:1]):
        station.acts_before = _count_unseen(station)
    if station.acts_before is None or well_ns is None or now_ns - well_ns < NOTED_S * S:
        return
    if _count_unseen(station) <= station.acts_before:
        yield f"nothing was seen for long until {well_ns / S:.1f} s, and that is not in the acts"
    station.acts_before = None


def _count_unseen(station: Station) -> int:
    """Count the acts of times without sight that were long."""
    query = "SELECT count(*) FROM acts WHERE verb = 'not_seen' AND arguments ->> '$.seconds' > ?"
    return int(station.disk.read(query, LONG_UNSEEN_S - 1)[0][0])


def _audit_requests(station: Station) -> Iterator[str]:
    """A request is done once, and only where it is signed, or everyone may ask it (docs/mqtt.md)."""
    query = "SELECT verb, request, count(*) FROM acts WHERE outcome = 'done' AND request IS NOT NULL GROUP BY 1, 2"
    for verb, transaction, done in station.disk.read(query):
        if done > 1:
            yield f"the request {verb}, {transaction}, was done {done} times"
    for answer in station.answers:
        if not station.heard.get(answer["transaction"], True):
            yield f"the request {answer['verb']}, {answer['transaction']}, was sent while nobody listened, and came"
        if answer["status"] == "ok" and not station.allows(answer):
            yield f"the request {answer['verb']}, {answer['transaction']}, was done, and nobody may ask it so"
