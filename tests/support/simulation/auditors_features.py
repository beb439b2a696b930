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
from simulation.surroundings import World

WRITTEN_S = 6.0
"""A snapshot is written so long after its last frame: a stream that has stopped is waited for two seconds."""


def audit_snapshots(world: World, station: Station) -> Iterator[str]:
    """A snapshot that was asked for is an act, and then its folder is a complete recording of its time span."""
    acts = station.disk.read(
        "SELECT after ->> '$.recording', outcome FROM acts WHERE verb = 'snapshot' AND who = 'the gateway'"
    )
    outcomes, now_ns = dict(acts), world.clock.now_ns
    for asked in station.snapshots:
        is_open = asked.life == station.lives and asked.folder not in outcomes and not station.is_kept_from_it
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
        if rows and retained not in (None, rows[-1][0]) and "reference" not in broker.stale:
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
