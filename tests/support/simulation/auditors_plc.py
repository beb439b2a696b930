"""What holds of what a PLC reads (docs/plc.md): a result is that of the press of its id, and of no other."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from simulation.hand import MadePress
from simulation.lives import Row, Seen, Station
from simulation.plc import TIMEOUT_S, Asked, Plc, Shown
from simulation.sensor import S
from simulation.surroundings import World

HALTED_S = 0.5
"""A pass is taken back so soon after the station stopped inspecting: with the next turn of its loop."""

HANGS_S = 5.0
"""A loop that hangs so long takes it back."""

LATE_S = 0.5
"""A trigger is done so soon after its time: with the next read."""

WRITES_ALONE_S = 3.0
"""Nobody else writes so long after a PLC wrote, unless it is gone."""


def audit_plcs(world: World, station: Station) -> Iterator[str]:
    """What holds of each read."""
    now_ns, state = world.clock.now_ns, station.loop.parts.status.view().state
    is_halted = state != "ready" and not station.is_held_up
    halted_ns = station.so_since(f"a PLC waits for a ready station {world.new_gel_ns}", is_halted) or now_ns
    hangs_ns = station.so_since("the loop of a PLC hangs", station.is_hanging, len(station.hung)) or now_ns
    asked = {number: one for plc in world.plcs for number, one in plc.asked.items()}
    news = [(shown.at_ns, plc.ip, shown) for plc in world.plcs for shown in plc.shown]
    for plc in world.plcs:
        plc.shown = []
    for at_ns, ip, shown in sorted(news, key=lambda one: one[0]):
        said = f"PLC {ip} at {at_ns / S:.3f} s, trigger {shown.trigger_id}"
        own = asked.get(shown.trigger_id)
        yield from (f"{said}: {what}" for what in _audit_bits(shown, own))
        if own is not None:
            yield from (f"{said}: {what}" for what in _audit_trigger(shown, own))
        if shown.has("pass") and at_ns - hangs_ns > (HANGS_S + HALTED_S) * S:
            yield f"{said}: the loop hangs for {(at_ns - hangs_ns) / S:.1f} s, and a pass is shown"
        if shown.has("pass") and at_ns - halted_ns > HALTED_S * S:
            yield f"{said}: the station is {state}, and a pass is shown"


def _audit_bits(shown: Shown, own: Asked | None) -> Iterator[str]:
    if shown.has("pass") == shown.has("not passed"):
        yield "pass and not passed are alike"
    if len(shown.words) != int(shown.has("done")) or (shown.has("busy") and shown.has("done")):
        yield f"done is {shown.has('done')}, busy {shown.has('busy')}, and the results are {shown.words}"
    is_open = shown.has("busy") or shown.has("done")
    if is_open != (own is not None):
        yield f"busy or done is {is_open}, and that is no trigger of this state"


def _audit_trigger(shown: Shown, own: Asked) -> Iterator[str]:
    """Note what is shown of a trigger, and find what may not come after what was shown before."""
    if own.acknowledged_ns is not None and shown.at_ns > own.acknowledged_ns:
        yield "it is shown again, and was acknowledged"
    if shown.has("busy"):
        own.busy_ns = shown.at_ns
    if shown.has("busy") and own.taken_ns and shown.at_ns - own.taken_ns > (TIMEOUT_S + LATE_S) * S:
        yield f"it is busy for {(shown.at_ns - own.taken_ns) / S:.1f} s"
    for word in shown.words:
        before = own.words[-1][0] if own.words else None
        if before not in (None, word) and (before, word) != ("pass", "error"):
            yield f"its result was {before}, and is {word}"
        if before != word:
            own.words.append((word, shown.at_ns))


def audit_answers(world: World, station: Station, rows: Mapping[int | None, Sequence[Row]]) -> Iterator[str]:
    """Each result is that of one recorded press: the first that began after its trigger. rows: of each press."""
    found: dict[int, set[str]] = {}
    pieces: dict[int, object] = {}
    for broker in world.brokers.values():
        for press_id, results in broker.results.items():
            if (number := results[0]["trigger_id"]) is not None:
                found.setdefault(int(str(number)), set()).add(press_id)
                pieces[int(str(number))] = results[0]["piece_id"]
    for other in world.plcs[1:]:
        yield from _audit_writers(world.plcs[0], other, station.ended_ns)
    parts = {row[0]: row[2] for row in station.rows()}
    for plc in world.plcs:
        for number, own in plc.asked.items():
            yield from (f"trigger {number}: {what}" for what in _audit_place(world, station, own, rows))
            presses = found.get(number, set())
            if len(presses) > 1:
                yield f"trigger {number} was answered by the presses {', '.join(sorted(presses))}"
            words = {word for word, _ in own.words}
            is_of_piece = world.has_pieces and own.piece and words & {"pass", "fail", "place"}
            if is_of_piece and pieces.get(number, own.piece) != own.piece:
                yield f"trigger {number} of {own.piece} was answered by a press of {pieces[number]}"
            for word, shown_ns in own.words:
                if word != "error":
                    said = f"trigger {number}, {word} at {shown_ns / S:.3f} s"
                    what = _audit_answer(world, station, own, word, shown_ns, presses, parts)
                    yield from (f"{said}: {one}" for one in what)


def _audit_place(
    world: World, station: Station, own: Asked, rows: Mapping[int | None, Sequence[Row]]
) -> Iterator[str]:
    """The first press after a trigger lies where that says: no bundle of another part or place judges it. Where a
    person has selected another part meanwhile it is rejected, and the result an error."""
    taken_ns = own.taken_ns
    if own.part is None or taken_ns is None:
        return
    noticed_ns = world.noticed_s * S
    press = next((one for one in world.hand.presses if one.begin_ns > taken_ns - noticed_ns), None)
    if press is None or press.why or not taken_ns < press.begin_ns < own.busy_ns:
        return
    judged_ns = {seen.press_id: seen.judged_ns for seen in station.seen}
    for press_id, verdict, part, _ in rows.get(press.number, []):
        until_ns = judged_ns.get(press_id, 1 << 62)
        is_open = until_ns < taken_ns + TIMEOUT_S * S and not any(
            taken_ns < at_ns <= until_ns for plc in world.plcs for at_ns in plc.acknowledges_ns
        )
        if is_open and verdict in ("pass", "fail") and part != own.part:
            yield f"press {press.number} lay at {own.part}, and its {verdict} is of {part}"
        if not is_open or world.parts.allows(press, own.part):
            continue
        if verdict != "rejected":
            yield f"another part than {own.part} is selected, and press {press.number} is {verdict}"
        if words := {word for word, _ in own.words} - {"error"}:
            yield f"another part than {own.part} was selected before its press, and it is shown {', '.join(words)}"


def may_be_other_part(world: World, press: MadePress) -> bool:
    """Tell whether another part may have been selected than the newest trigger before this press has named."""
    before = [[one for one in plc.asked.values() if one.sent_ns < press.begin_ns][-1:] for plc in world.plcs]
    parts = [one.part for asked in before for one in asked if one.part]
    return any(not world.parts.is_sure(press, part) for part in parts)


def _audit_writers(plc: Plc, other: Plc, ended_ns: Sequence[int]) -> Iterator[str]:
    """While one writes nobody else does, and for a while after; a station that starts again knows no writer."""
    for before_ns, after_ns in pairwise(plc.writes_ns):
        is_one_life = not any(before_ns < end_ns < after_ns for end_ns in ended_ns)
        is_alone = after_ns - before_ns < WRITES_ALONE_S * S and other.left_ns > after_ns and is_one_life
        if is_alone and any(before_ns < write_ns < after_ns for write_ns in other.writes_ns):
            yield f"PLC {other.ip} wrote between {before_ns / S:.3f} and {after_ns / S:.3f} s, as {plc.ip} did"


def _audit_answer(
    world: World,
    station: Station,
    own: Asked,
    word: str,
    shown_ns: int,
    presses: set[str],
    parts: dict[str, str],
) -> Iterator[str]:
    may_be = [seen for seen in station.seen if own.sent_ns <= (seen.frame_ns or seen.judged_ns)]
    may_be = [seen for seen in may_be if (seen.shown or "place") == word and seen.judged_ns <= shown_ns]
    if word in ("pass", "place"):
        may_be = [seen for seen in may_be if seen.noted_ns <= shown_ns and seen.press_id in parts]
    if presses:
        may_be = [seen for seen in may_be if seen.press_id in presses]
    if not may_be:
        is_unrecorded = any(own.sent_ns <= ended_ns for ended_ns in station.ended_ns)
        if word in ("pass", "place") or not is_unrecorded:
            yield f"no press after it is a {word} that was recorded by then"
        return
    if own.part and own.part not in {parts.get(seen.press_id, own.part) for seen in may_be}:
        yield f"it names {own.part}, and its press was judged as another part"
    if len(may_be) == 1 and own.taken_ns is not None:
        yield from _audit_first(world, own.taken_ns, may_be[0])


def _audit_first(world: World, taken_ns: int, seen: Seen) -> Iterator[str]:
    made = [press for press in world.hand.presses if press.begin_ns <= (seen.frame_ns or seen.judged_ns)]
    if not made or made[-1].why:
        return
    if made[-1].begin_ns < taken_ns - world.noticed_s * S:  # it was not noticed yet
        yield f"press {made[-1].number} had begun before it"
    first = [
        press for press in made[:-1] if press.begin_ns > taken_ns + world.noticed_s * S and not press.why
    ]
    if first:
        yield f"press {made[-1].number} answers it, and press {first[0].number} came before"
