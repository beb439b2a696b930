"""What holds of what people ask of features (docs/operations.md, docs/mqtt.md)."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from edge.core.errors import GelgateError
from edge.recording.format import Recording
from simulation.hand import MadePress
from simulation.lives import Row, Station
from simulation.overview_camera import MAX_AGE_S
from simulation.sensor import S
from simulation.surroundings import WALL_NS, World

SAID_S = 3.0
"""What a person said is looked at each second."""

WRITTEN_S = 6.0
"""A snapshot is written so long after its last frame: a stream that has stopped is waited for two seconds."""


def audit_words(world: World, station: Station) -> Iterator[str]:
    """The alarm `escape` says that a press has passed which people call damaged, by the newest word; and only that."""
    is_kept_from_it = station.is_held_up or station.is_disk_disturbed or station.loop.is_halted
    if world.clock.wall_ns != WALL_NS:  # the words of a day count, and it was set
        return
    query = (
        "SELECT arguments ->> '$.press_id', arguments ->> '$.verdict' FROM acts "
        "WHERE verb = 'confirm_press' AND outcome = 'done' ORDER BY act_id"
    )
    said = dict(station.disk.read(query))
    if not said and "escape" not in station.loop.parts.status.view().alarms:
        return
    verdicts = {row[0]: row[1] for row in station.rows()}
    escaped = [one for one, word in said.items() if word == "damaged" and verdicts.get(one) == "pass"]
    is_raised = "escape" in station.loop.parts.status.view().alarms
    if is_raised and escaped:
        station.reached.add("a damaged part was said to have passed")
    now_ns = world.clock.now_ns
    unsaid_ns = station.so_since(
        "an escape is not said", bool(escaped) and not (is_raised or is_kept_from_it)
    )
    false_ns = station.so_since(
        "an escape that is none is said", is_raised and not (escaped or is_kept_from_it)
    )
    if unsaid_ns is not None and now_ns - unsaid_ns > SAID_S * S:
        yield f"press {escaped[0]} passed, a person calls it damaged, and no alarm says so"
    if false_ns is not None and now_ns - false_ns > SAID_S * S:
        yield "the alarm escape is raised, and nobody calls a press damaged that passed"


def audit_snapshots(world: World, station: Station) -> Iterator[str]:
    """A snapshot that was asked for is an act, and then its folder is a complete recording of its time span."""
    acts = station.disk.read(
        "SELECT after ->> '$.recording', outcome FROM acts WHERE verb = 'snapshot' AND who = 'the gateway'"
    )
    outcomes, now_ns = dict(acts), world.clock.now_ns
    is_kept_from_it = station.is_held_up or station.is_disk_disturbed or station.loop.is_halted
    for asked in station.snapshots:
        is_open = asked.life == station.lives and asked.folder not in outcomes and not is_kept_from_it
        since_ns = station.so_since(f"the snapshot {asked.folder} is not written", is_open)
        if since_ns is not None and now_ns - since_ns > (asked.seconds + WRITTEN_S) * S:
            yield f"the snapshot {Path(asked.folder).name} has no outcome"
        is_there = Path(asked.folder).is_dir()
        if outcomes.get(asked.folder) == "done" and not (is_there or world.lacks_files_ns):
            yield f"the snapshot {Path(asked.folder).name} is done, and is not there"
    folder = station.disk.folder / "gelgate.snapshots"
    new = {path for path in folder.glob("[!.]*") if path.name not in station.complete}
    for path in sorted(new) if not world.lacks_files_ns else ():
        station.complete.add(path.name)
        try:
            times = [one.frame.timestamp_ns for one in Recording.open(path)]
        except (GelgateError, OSError) as error:
            yield f"the snapshot {path.name} is not complete: {error}"
            continue
        ends = [
            asked.at_ns + asked.seconds * S
            for asked in station.snapshots
            if Path(asked.folder).name == path.name
        ]
        if not times or times != sorted(times) or times[-1] > max(ends, default=0):
            yield f"the snapshot {path.name} has {len(times)} frames, not those of its time"


def audit_due(world: World, station: Station) -> Iterator[str]:
    """A press of the master piece is due at once on a new gel, and the alarm `reference` says so."""
    session = station.loop.session
    if session is None or not station.config.reference.pieces:
        return
    gels = [gel for (gel,) in station.disk.read("SELECT gel_id FROM reference_presses ORDER BY number")]
    is_raised = "reference" in station.loop.parts.status.view().alarms
    is_kept_from_it = station.is_held_up or station.is_disk_disturbed or station.loop.is_halted
    is_unsaid = session.gel.gel_id not in gels and not is_raised and not is_kept_from_it
    unsaid_ns = station.so_since("a master piece is due", is_unsaid, session.gel.gel_id)
    if unsaid_ns is not None and world.clock.now_ns - unsaid_ns > SAID_S * S:
        yield f"no master piece was pressed on gel {session.gel.gel_id}, and no alarm says that it is due"


def audit_master(world: World, station: Station) -> Iterator[str]:
    """A press of the master piece is one row of its own table, and no part's; the newest is retained (docs/mqtt.md)."""
    rows = station.disk.read("SELECT press_id, verdict FROM reference_presses ORDER BY number")
    times = {seen.press_id: seen.frame_ns or seen.judged_ns for seen in station.seen}
    found: dict[int, list[str]] = {}
    for press_id, verdict in rows:
        made = [one for one in world.hand.presses if one.begin_ns <= times.get(press_id, 0)]
        for press in made[-1:]:
            found.setdefault(press.number, []).append(verdict)
            if not press.master_ns and not press.why:
                yield f"press {press.number} is of a part, and counts as one of the master piece"
    for press in world.hand.presses:
        own = found.get(press.number, [])
        if press.master_ns and not press.why and not station.lost_rows and len(own) != 1:
            yield f"press {press.number} is of the master piece, and has {len(own)} rows of it"
        yield from (
            f"press {press.number} of the master piece is {word}, without any fault"
            for word in own
            if not press.why and word not in press.words
        )
    for broker in world.brokers.values():
        retained = json.loads(broker.retained.get("reference", b"{}")).get("press_id")
        if rows and retained not in (None, rows[-1][0]):
            yield f"{broker.name} retains press {retained} of the master piece, and it is {rows[-1][0]}"


STILL_S = 0.6
"""A camera that is well again gives its next still so soon."""

OPENED_S = 12.0
"""One that was unplugged, or hung, is opened again so soon."""


def may_lack_still(world: World, press: MadePress) -> bool:
    """Tell whether there may be no still of this part, so that its press is refused."""
    camera, begin_ns = world.overview, press.begin_ns
    return camera is not None and camera.was_troubled(begin_ns - round(OPENED_S * S), begin_ns + S)


def audit_overview(
    world: World, station: Station, found: Mapping[int | None, Sequence[Row]]
) -> Iterator[str]:
    """A press is judged as the part whose code the newest still shows, and not at all without one of these seconds
    (docs/operations.md). A still of before a fault may show the part before."""
    camera = world.overview
    for press in world.hand.presses if camera is not None else ():
        assert camera is not None
        begin_ns, seen_ns = press.begin_ns, press.begin_ns + round(world.noticed_s * S)
        is_blind = camera.was_blind(begin_ns - round((MAX_AGE_S + STILL_S) * S), seen_ns + S)
        is_well = not camera.was_troubled(begin_ns - round(OPENED_S * S), seen_ns)
        for _, verdict, part, _ in found.get(press.number, []):
            if verdict in ("pass", "fail") and is_blind and not press.why:
                yield f"press {press.number} is judged, and the overview camera has not seen its part"
            if verdict in ("pass", "fail") and is_well and not press.why and part != press.part:
                yield f"press {press.number} is of {press.part}, and is judged as {part}"
