"""What holds of pieces of several places (docs/operations.md): one verdict each, and no pass with a place missing."""

import json
from collections.abc import Iterator, Mapping, Sequence

from simulation.auditors_outputs import OPENED_S, SHOWN_S
from simulation.lives import Station
from simulation.outputs import LAMP
from simulation.pieces import PLAN
from simulation.sensor import S
from simulation.surroundings import World

Places = Mapping[str, list[str]]
"""Place to the verdicts of its presses, in order."""


def audit_piece_lamp(world: World, station: Station) -> Iterator[str]:
    """A pass goes off when the next piece is begun. A board that is plugged in may begin with any light."""
    relay, now_ns = world.relay, world.clock.now_ns
    is_well = relay.mood == "up" and now_ns - relay.well_since_ns > OPENED_S * S and not station.is_held_up
    is_old = bool(station.seen) and station.seen[-1].noted_ns < world.pieces.changed_ns
    is_shown = world.has_pieces and relay.is_on[LAMP] and is_well
    since_ns = station.so_since("a pass of the piece before", is_shown and is_old)
    if since_ns is not None and now_ns - since_ns > SHOWN_S * S:
        yield "a pass of the piece before is shown"


def audit_pieces(world: World, station: Station) -> Iterator[str]:
    """What holds at the end: in the database, at each subscriber, and of each press."""
    if not world.has_pieces:
        return
    pieces = station.disk.read("SELECT piece_id, verdict FROM pieces ORDER BY number")
    rows = station.disk.read(
        "SELECT piece_id, part || '/' || position, verdict, press_id FROM presses WHERE piece_id IS NOT NULL "
        "ORDER BY number"
    )
    made: dict[str, dict[str, list[str]]] = {piece: {} for piece, _ in pieces}
    order: dict[str, list[str]] = {}
    for piece, place, verdict, _ in rows:
        made.setdefault(piece, {}).setdefault(place, []).append(verdict)
        order.setdefault(piece, []).extend([place] if verdict in ("pass", "fail") else [])
    if world.worker.order == "fixed":
        wrong = {piece: places for piece, places in order.items() if places != [*PLAN][: len(places)]}
        yield from (f"{piece} was pressed at {places}, in fixed order" for piece, places in wrong.items())
    for piece, verdict in pieces:
        yield from (f"{piece} is {verdict}: {what}" for what in _audit_verdict(verdict, made[piece]))
    yield from _audit_presses(world, station, {press_id: row for *row, press_id in rows})
    over = {piece: verdict for piece, verdict in pieces if verdict is not None}
    current = next((piece for piece, verdict in pieces if verdict is None), None)
    for broker in world.brokers.values():
        yield from (f"{broker.name}: {what}" for what in _audit_results(broker.pieces, over, station))
        retained = json.loads(broker.retained.get("piece", b"{}")).get("piece_id")
        if retained != current:
            yield f"{broker.name} retains the piece {retained}, and {current} is in progress"


def _audit_verdict(verdict: str | None, places: Places) -> Iterator[str]:
    words = [[word for word in places.get(place, []) if word in ("pass", "fail")][:1] for place in PLAN]
    if verdict == "pass" and words != [["pass"]] * len(PLAN):
        yield f"its places are {words}"
    if verdict == "incomplete" and (["fail"] in words or [] not in words):
        yield f"its places are {words}"
    if verdict == "fail" and ["fail"] not in words:
        yield f"its places are {words}"
    if verdict is None and [] not in words:
        yield f"in progress, and its places are {words}"


def _audit_presses(world: World, station: Station, rows: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """A press is of the piece that the person had begun, and judged as the place at which it lies. rows: piece, place
    and verdict of each."""
    for seen in station.seen:
        piece, place, verdict = rows.get(seen.press_id, ("", "", ""))
        at_ns = seen.frame_ns or seen.judged_ns
        press = next((one for one in reversed(world.hand.presses) if one.begin_ns <= at_ns), None)
        if press is None or press.why or not piece.startswith("piece "):
            continue
        if not world.pieces.allows(press, piece):
            yield f"press {press.number} counts for {piece}, and another piece was begun before it"
        if verdict in ("pass", "fail") and not world.places.allows(press, place):
            yield f"press {press.number} lay elsewhere, and its {verdict} is of {place}"


def _audit_results(
    got: Mapping[str, list[dict[str, object]]], over: Mapping[str, str], station: Station
) -> Iterator[str]:
    """Each piece that is over has one result, which may come twice."""
    for piece, results in got.items():
        kept = [{key: value for key, value in one.items() if key != "is_replayed"} for one in results]
        if station.has_lost_pieces:
            continue
        if any(one != kept[0] for one in kept):
            yield f"two results of {piece} differ"
        if piece in over and over[piece] != kept[0]["verdict"]:
            yield f"{piece} has the result {kept[0]['verdict']}, and is {over[piece]}"
        if piece not in over:
            yield f"{piece} has a result, and is not over"
    lacking = [piece for piece in over if piece not in got]
    if lacking and not (station.dropped or station.dropped_before):
        yield f"the results of {', '.join(lacking)} lack"
