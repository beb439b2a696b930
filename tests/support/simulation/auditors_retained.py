"""What a subscriber that comes later would see, and what waits for it (docs/mqtt.md): nothing false, nor much."""

import json
from collections.abc import Iterator

from simulation.lives import Station
from simulation.sensor import OTHER_SERIAL, S
from simulation.surroundings import World

LATE_S = 3
"""A result that has waited so long for its receiver is late."""


def audit_retained(world: World, station: Station) -> Iterator[str]:
    """What each broker retains in the end is so: the newest press, the gel with its count, the part, the alarms."""
    raised = station.loop.parts.status.view().alarms
    newest = station.disk.read("SELECT press_id FROM presses ORDER BY number DESC LIMIT 1")
    gels = dict(station.disk.read("SELECT gel_id, presses FROM gels"))
    session = station.loop.session
    for broker in world.brokers.values():
        kept = {topic: _read(payload) for topic, payload in broker.retained.items()}
        last = kept.get("last/press")
        is_known = last is not None and "last/press" not in broker.stale  # a broker may forget it
        if newest and last is not None and is_known and last["press_id"] != newest[0][0]:
            yield f"{broker.name} retains the press {last['press_id']} as the last, and it is {newest[0][0]}"
        gel = kept.get("gel")
        if (
            session
            and gel
            and "gel" not in broker.stale
            and (gel["gel_id"], gel["presses"]) != (session.gel.gel_id, gels[session.gel.gel_id])
        ):
            yield f"{broker.name} retains the gel {gel['gel_id']} with {gel['presses']} presses, which is not so"
        info, part = kept.get("info"), station.loop.parts.selection.part.part
        if session and not info:
            yield f"{broker.name} retains no info, and {part} inspects"
        if info and info["part"] != part:
            yield f"{broker.name} retains the part {info['part']}, and {part} inspects"
        said = {topic.removeprefix("alarm/") for topic in kept if topic.startswith("alarm/")}
        if said != raised:
            yield f"{broker.name} retains the alarms {sorted(said)}, and raised are {sorted(raised)}"
        yield from broker.went_back


def audit_late(world: World, station: Station) -> Iterator[str]:
    """A result that waited for the receiver says that it is late."""
    made_ns = {seen.press_id: seen.noted_ns for seen in station.seen}
    for broker in world.brokers.values():
        for press_id, sent_ns in broker.sent_ns.items():
            since_ns = made_ns.get(press_id)
            was_away = any(
                since_ns is not None
                and begun_ns <= since_ns
                and ended_ns - since_ns > LATE_S * S
                and ended_ns <= sent_ns
                for begun_ns, ended_ns in broker.outages
            )
            if was_away and press_id in broker.results and not broker.results[press_id][0]["is_replayed"]:
                yield f"{broker.name}: the result of press {press_id} came late, and does not say so"


def audit_outbox(station: Station) -> Iterator[str]:
    """Of the topics without history only the newest waits: the outbox does not grow with the presses."""
    query = "SELECT topic, count(*) FROM outbox WHERE retain = 1 GROUP BY topic HAVING count(*) > 2"
    for topic, rows in station.disk.read(query):
        yield f"{rows} messages of the retained topic {topic} wait"


def audit_serials(station: Station) -> Iterator[str]:
    """Wear is counted for each sensor's own gel: another one during a run is refused (docs/operations.md)."""
    for table in ("gels", "presses"):
        if station.disk.read(f"SELECT 1 FROM {table} WHERE serial = ? LIMIT 1", OTHER_SERIAL):
            yield f"another sensor than the station's own has {table}"


def _read(payload: bytes) -> dict[str, object]:
    try:
        return dict(json.loads(payload))
    except ValueError:
        return {}  # a picture
