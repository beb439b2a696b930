"""What holds of the contact as a robot sees it, at a relay or at a broker (docs/contact.md, What a robot is told)."""

from collections.abc import Iterator

from simulation.alarms import is_sensor_lost
from simulation.auditors_outputs import OPENED_S, SHOWN_S, UNHEARD_S
from simulation.brokers import Broker
from simulation.hand import MadePress
from simulation.lives import Station
from simulation.outputs import FREE, LIFT, OVERLOAD
from simulation.sensor import S
from simulation.surroundings import World

UNSEEN_S = 0.27
"""What has not been seen for so long is not known."""

SENT_S = 1.0
"""A change has come by then to a robot at a broker, whether it believes what came before or not."""

ANSWERED_S = 0.3
"""A broker that owes an answer for longer may get nothing."""


def audit_contact(world: World, station: Station) -> Iterator[str]:
    """What holds at each moment: nothing is said of a gel that nobody sees, nor what is over."""
    relay, now_ns, is_held_up = world.relay, world.clock.now_ns, station.is_held_up
    is_open = relay.mood == "up" and now_ns - relay.well_since_ns > OPENED_S * S
    is_well = is_open and not is_held_up
    channels = {LIFT: "lift", FREE: "free", OVERLOAD: "overload"}
    shown = {name for channel, name in channels.items() if relay.is_on[channel]}
    yield from _audit_shown(world, station, "the relay", shown if is_well else None, SHOWN_S)
    is_hanging = station.is_hanging and is_open and not station.is_frozen
    hangs_ns = station.so_since("the loop hangs", is_hanging, len(station.hung))
    if hangs_ns is not None and shown and now_ns - hangs_ns > (UNHEARD_S + SHOWN_S) * S:
        yield f"the loop hangs for {(now_ns - hangs_ns) / S:.1f} s, and {' and '.join(shown)} is shown"
    for broker in world.brokers.values():
        owes_ns = station.so_since(
            f"{broker.name} owes an answer", world.connections.turns[broker.name].is_waiting
        )
        is_heard = (
            broker.is_well and broker.says_ready and (owes_ns is None or now_ns - owes_ns < ANSWERED_S * S)
        )
        told_ns = station.so_since(f"{broker.name} is told", is_heard and not is_held_up)
        is_told = told_ns is not None and now_ns - told_ns > SENT_S * S
        shown = {broker.contact.state} if broker.contact is not None else set()
        yield from _audit_shown(world, station, broker.name, shown if is_told else None, SENT_S)
    press, alarms = world.hand.press, station.loop.parts.status.view().alarms
    is_hard = press is not None and press.way == "hard" and not press.why and not is_held_up
    since_ns = station.so_since("a press is hard", is_hard)
    if since_ns is None or now_ns - since_ns < (world.noticed_s + SHOWN_S) * S:
        return
    if "gel_overload" not in alarms:
        yield "a press is hard, and the alarm gel_overload is not raised"
    if is_well and not relay.is_on[OVERLOAD]:
        yield "a press is hard, and the relay does not show it"


def _audit_shown(
    world: World, station: Station, where: str, shown: set[str] | None, within_s: float
) -> Iterator[str]:
    """shown: None where it may be anything. within_s: of a change, it is shown."""
    now_ns, presses, is_known = world.clock.now_ns, world.hand.presses, shown is not None
    state = station.loop.parts.status.view().state
    lost_ns = station.so_since(
        f"the contact is not seen, {where}",
        is_sensor_lost(world, station) and is_known,
        world.sensor.is_holding,
    )
    halted_ns = station.so_since(
        f"the contact of no ready station {world.new_gel_ns}, {where}", is_known and state != "ready"
    )
    if shown is None:
        return
    said = shown & {"lift", "free", "overload"}
    if len(said) > 1:
        yield f"{where}: {' and '.join(sorted(said))} are shown at once"
    if said and lost_ns is not None and now_ns - lost_ns > (UNSEEN_S + within_s + 2 / station.fps) * S:
        yield f"{where}: nothing is seen for {(now_ns - lost_ns) / S:.1f} s, and {said.pop()} is shown"
    if said and halted_ns is not None and now_ns - halted_ns > within_s * S:
        yield f"{where}: the station is {state}, and {said.pop()} is shown"
    if not presses or presses[-1].why:
        return
    press, since_ns = presses[-1], presses[-1].end_ns or presses[-1].begin_ns
    if now_ns - since_ns > (world.noticed_s + within_s) * S:
        yield from (f"{where}: press {press.number} is {what}" for what in _audit_press(press, said))


def _audit_press(press: MadePress, said: set[str]) -> Iterator[str]:
    if "free" in said and not press.end_ns:
        yield "held, and free is shown"
    if press.end_ns:
        yield from (f"over, and {word} is shown" for word in said - {"free"})
    if "overload" in said and press.way != "hard":
        yield f"{press.way}, and overload is shown"


def audit_lifts(world: World, station: Station) -> Iterator[str]:
    """A part may be lifted when its press is recorded, and not by the verdict of another, but for one that was
    recorded as the next began. A process that was frozen shows what its loop has said within the last second."""
    for one in world.relay.switched:
        if one.channel != LIFT:
            continue
        begun = [
            press
            for press in world.hand.presses
            if press.begin_ns <= one.told_ns and not _is_unseen(station, press, one.told_ns)
        ][-1:]
        own = [seen for seen in station.seen if begun and begun[0].begin_ns <= seen.noted_ns <= one.told_ns]
        why = begun[0].why if begun else set()
        is_frozen = "process frozen" in why
        noticed_ns = round((UNHEARD_S if is_frozen else world.noticed_s) * S)
        is_just_recorded = any(0 <= one.told_ns - seen.noted_ns < noticed_ns for seen in station.seen)
        is_of_before = (
            bool(begun) and one.told_ns - begun[0].begin_ns < noticed_ns and (is_frozen or is_just_recorded)
        )
        if not (
            own
            or is_of_before
            or "a relay that is plugged in may say `lift` before the station has it" in why
        ):
            number = begun[0].number if begun else "none"
            yield f"lift was shown at {one.told_ns / S:.3f} s, and press {number} was not recorded yet"
    for broker in world.brokers.values():
        yield from (f"{broker.name}: {what}" for what in _audit_messages(world, station, broker))


def _is_unseen(station: Station, press: MadePress, told_ns: int) -> bool:
    """Tell whether it began while the loop hung that has just gone on, and has recorded nothing of it."""
    is_recorded = any(
        press.begin_ns < (seen.frame_ns or 0) <= seen.noted_ns <= told_ns for seen in station.seen
    )
    return not is_recorded and any(
        began_ns < press.begin_ns < ended_ns > told_ns - S // 20 for began_ns, ended_ns in station.hung
    )


def _audit_messages(world: World, station: Station, broker: Broker) -> Iterator[str]:
    """A message says of which press it is."""
    frame_ns = {seen.press_id: seen.frame_ns or seen.judged_ns for seen in station.seen if seen.noted_ns}
    for press_id, told in broker.lifts.items():
        if not told.is_at_once:
            continue
        if press_id is None or press_id not in frame_ns:
            yield f"lift of the press {press_id}, which is not recorded, at {told.at_ns / S:.3f} s"
            continue
        begun = [
            press
            for press in world.hand.presses
            if press.begin_ns <= told.at_ns - (world.noticed_s + SENT_S) * S
        ]
        if begun and begun[-1].begin_ns > frame_ns[press_id] and not begun[-1].why:
            yield f"lift of an earlier press than {begun[-1].number}, which is on the gel, at {told.at_ns / S:.3f} s"


def audit_overloads(world: World, station: Station) -> Iterator[str]:
    """Each overload is an act, but of a database that was removed. A gel that is learnt while it lies pressed takes
    the lift for another one."""
    hard = [press for press in world.hand.presses if press.way == "hard"]
    least = 0 if station.lost_rows else sum(not press.why for press in hard)
    acts = station.disk.read("SELECT count(*) FROM acts WHERE verb = 'overload'")[0][0]
    most = len(hard) + sum("the gel was being learnt" in press.why for press in hard)
    if not least <= acts <= most:
        yield f"{acts} overloads are acts, and {least} to {most} presses were so hard"
