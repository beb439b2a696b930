"""What holds of what grows: unsent messages, the file sink, the archive, memory (docs/operations.md)."""

import json
from collections import Counter
from collections.abc import Iterator

from edge.features.snapshots import Snapshots
from simulation.chosen import is_small
from simulation.lives import Station
from simulation.options import MESSAGES
from simulation.sensor import S
from simulation.surroundings import World, count_held

WORTH = {"picture": 0, "pass": 1, "fail": 2}
"""What is dropped first."""

ARCHIVED = 8
"""So many presses are kept in the archive, rejected ones among them."""

MADE_FROM = ("frame", "reference", "score_map", "machine", "masked")
"""The objects that a record of the archive names."""

KEPT_S = 20.0
"""The ten seconds before a request and the ten after it (docs/operations.md), of frames that are somewhat irregular."""

MOST_HELD = 8
"""Frames and presses in memory when none waits: the newest ones."""

REPORTED_S = 12.0
"""A station reports every ten seconds, where its disk can be read, and then says what it has dropped."""


def audit_full_outbox(world: World, station: Station) -> Iterator[str]:
    """A full outbox keeps to its room, drops pictures first, passes next and fails last, and says so."""
    room_mb = station.config.store.outbox_mb
    if not is_small(room_mb):
        return
    rows = station.disk.read("SELECT row_id, topic, content_type, payload FROM outbox WHERE retain = 0")
    size = sum(len(payload) for *_, payload in rows)
    before = station.waiting
    station.waiting = {row_id: _describe(*row) for row_id, *row in rows}
    with station.disk.sparing():
        status = station.loop.parts.publisher.outbox_status()
    dropped = status.dropped
    station.is_drop_open |= sum(dropped.values()) > sum(station.dropped.values())
    station.dropped = dropped
    if size > room_mb * 1e6:
        yield f"{size} bytes wait in an outbox of {room_mb} MB"
    disk = station.disk.unsynced
    is_kept_from_it = station.is_held_up or (disk is not None and disk.fails is not None)
    is_open = station.is_drop_unsaid and not is_kept_from_it
    # A report may have met a fault, and a person may have acknowledged the alarm between two looks.
    acknowledged = sum(dropped.values()) - sum(status.unseen.values())
    unsaid_ns = station.so_since("a drop is not said", is_open, (station.disk_faults, acknowledged))
    if unsaid_ns is not None and world.clock.now_ns - unsaid_ns > REPORTED_S * S:
        yield f"messages were dropped {REPORTED_S} s ago, and no alarm says so"
    taken = [broker.results.keys() | broker.pieces.keys() for broker in world.brokers.values()]
    stayed = [WORTH[what] for row_id, (what, _) in station.waiting.items() if row_id in before]
    for row_id in before.keys() - station.waiting.keys():
        what, result_id = before[row_id]
        is_taken = what == "picture" or all(result_id in results for results in taken)
        if not is_taken and min(stayed, default=3) < WORTH[what]:
            yield f"the result of {result_id}, a {what}, was dropped before what is worth less"


def _describe(topic: str, content_type: str, payload: bytes) -> tuple[str, str]:
    if topic not in ("result", "piece_result"):
        return "picture" if content_type.startswith("image/") else "fail", topic
    result = json.loads(payload)
    own_id = result["press_id" if topic == "result" else "piece_id"]
    return "pass" if result["verdict"] == "pass" else "fail", own_id


def audit_file(station: Station) -> Iterator[str]:
    """The file has each result, in order, and no line that is not JSON; but for what was dropped or lost before."""
    if all(sink.plugin != "jsonl" for sink in station.config.sinks):
        return
    path = station.disk.folder / MESSAGES / "messages.jsonl"
    lines = path.read_bytes().splitlines() if path.exists() else []
    found: list[str] = []
    for number, line in enumerate(lines, 1):
        try:
            said = json.loads(line)
        except ValueError:
            yield f"line {number} of the file is not JSON"
            continue
        if said["topic"] == "result" and said["payload"]["press_id"] not in found:
            found.append(said["payload"]["press_id"])
    ids = [row[0] for row in station.rows()]
    lacking = [one for one in ids[len(station.lost_rows) :] if one not in found]
    dropped = station.dropped_before + Counter(station.dropped)
    if len(lacking) > dropped["pass"] + dropped["fail"]:
        yield f"the file: {len(lacking)} results lack"
    if found != [one for one in ids if one in found]:
        yield "the file: the results are in another order than they were made, or of no row"


def audit_archive(station: Station) -> Iterator[str]:
    """The newest presses are kept, as many as are configured, and what these need (docs/security.md).

    A kill may leave one more, until the next press; a full disk files of a press that has none there.
    """
    folder = station.disk.folder / "gelgate.archive"
    records = [path.read_bytes() for path in folder.glob("presses/*.json")]
    if len(records) > ARCHIVED + bool(station.killed_ns):
        yield f"{len(records)} presses are in an archive of {ARCHIVED}"
    left = [
        path.name
        for path in folder.glob("objects/*")
        if not any(path.name.encode() in record for record in records)
    ]
    if left and not station.disk.full_since_ns:
        yield f"the archive has {len(left)} files that no press needs"


def audit_kept(world: World, station: Station) -> Iterator[str]:
    """A press of the archive has all that it was made from, also what it shares with others; but for what was lost with
    the power (docs/security.md)."""
    folder = station.disk.folder / "gelgate.archive"
    objects = folder / "objects"
    if world.has_lost_power or not objects.is_dir() or objects.stat().st_mtime_ns == station.archive_ns:
        return
    station.archive_ns = objects.stat().st_mtime_ns
    there = {path.name for path in objects.iterdir()}
    for path in (folder / "presses").glob("[!.]*.json"):
        record = json.loads(path.read_bytes())
        lacking = [name for name in MADE_FROM if record[name] and record[name] not in there]
        if lacking:
            yield f"press {path.stem} is in the archive, and its {', '.join(lacking)} is not"


def audit_memory(world: World, station: Station) -> Iterator[str]:
    """What has been inspected is let go; snapshots keep the frames of twenty seconds."""
    held = count_held() - world.held_before
    frames = MOST_HELD + (round(KEPT_S * station.fps) if station.loop.find(Snapshots) else 0)
    most = {"CameraFrame": frames}
    yield from (
        f"{number} of {name} are in memory"
        for name, number in held.items()
        if number > most.get(name, MOST_HELD)
    )
