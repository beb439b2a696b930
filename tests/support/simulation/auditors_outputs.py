"""What holds of the outputs (docs/operations.md): what is shown, and which pulse is given."""

from bisect import bisect_right
from collections.abc import Iterator

from simulation.alarms import is_sensor_lost
from simulation.lives import Station
from simulation.outputs import DEADLINE_S, GATE, LAMP, LIFT, PULSE_S, REJECT
from simulation.sensor import S
from simulation.surroundings import World

OPENED_S = 6
"""A relay that is plugged in is opened so soon, and all of its outputs are written (docs/operations.md)."""

SHOWN_S = 0.4
"""The relay is switched so long after a press is noticed."""

LONGEST_S = 3.0
"""A pulse belongs to a press of this time before it."""

UNHEARD_S = 1.0
"""What a loop has said that hangs counts for so long (docs/operations.md)."""

UNSEEN_S = 1.0
"""A pass goes out half a second after the last picture of the gel, and the relay is switched."""


def audit_lamp(world: World, station: Station) -> Iterator[str]:
    """What holds at each moment: no pass is shown for a part that has none yet, nor without a picture of the gel."""
    press, relay, now_ns = world.hand.press, world.relay, world.clock.now_ns
    is_well = relay.mood == "up" and now_ns - relay.well_since_ns > OPENED_S * S and not station.is_frozen
    is_looked = is_well and not station.is_hanging  # else what the loop said last counts a while longer
    is_unseen = is_sensor_lost(world, station) and is_looked
    is_lost = station.so_since("nothing is seen", is_unseen, world.sensor.is_holding)  # a burst is seen
    hangs_ns = station.so_since("it hangs", station.is_hanging and is_well, len(station.hung))
    if not relay.is_on[LAMP] or not is_well:
        return
    if is_lost is not None and now_ns - is_lost > (UNSEEN_S + 2 / station.fps) * S:
        yield f"nothing is seen for {(now_ns - is_lost) / S:.1f} s, and a pass is shown"
    if hangs_ns is not None and now_ns - hangs_ns > (UNHEARD_S + SHOWN_S) * S:
        yield f"the loop hangs for {(now_ns - hangs_ns) / S:.1f} s, and a pass is shown"
    if press is None and [seen.shown for seen in station.seen[-1:]] != ["pass"]:
        yield "a pass is shown, and the last press has none"
    if press is None or press.why:
        return
    if now_ns - press.begin_ns > (world.noticed_s + SHOWN_S) * S:
        own = [seen.shown for seen in station.seen[-4:] if seen.noted_ns >= press.begin_ns]
        if press.is_bad or "pass" not in own:
            yield f"press {press.number} is {press.what}, has {own[-1:] or 'no verdict'}, and a pass is shown"


def audit_outputs(world: World, station: Station) -> Iterator[str]:
    """Each output belongs to one press that was judged so, and none comes after its deadline."""
    yield from _audit_hung(world, station)
    unused = {REJECT: [one for one in station.seen if one.shown not in ("pass", "")]}
    unused |= {GATE: [one for one in station.seen if one.shown == "pass"]}
    for one in (one for one in world.relay.switched if one.channel in (LAMP, REJECT, GATE)):
        when = f"at {one.told_ns / S:.3f} s"
        if one.channel == LAMP:
            before = [seen.shown for seen in station.seen if seen.noted_ns <= one.told_ns]
            if before[-1:] != ["pass"]:
                yield f"a pass was shown {when}, and the last press was {before[-1:] or 'none'}"
            begun = [press for press in world.hand.presses if press.begin_ns <= one.told_ns][-1:]
            for press in begun:
                is_sure = not press.why - {"the station said 'halted'"}
                is_noticed = one.told_ns - press.begin_ns > (world.noticed_s + SHOWN_S) * S
                if (
                    is_sure
                    and is_noticed
                    and not any(press.begin_ns <= seen.noted_ns <= one.told_ns for seen in station.seen)
                ):
                    yield f"a pass was shown {when}, and press {press.number} was not recorded yet"
            passed_ns = max(
                [seen.noted_ns for seen in station.seen if seen.noted_ns <= one.told_ns], default=0
            )
            if any(passed_ns < halted_ns < one.told_ns - S for halted_ns in station.halted_ns):
                yield f"a pass was shown {when}, and the station was not ready since that press"
            continue
        presses = unused[one.channel]
        own = [
            seen
            for seen in presses
            if seen.judged_ns <= one.told_ns < (seen.frame_ns or seen.judged_ns) + LONGEST_S * S
        ]
        # One that waits for room on the disk, and was judged before, is recorded before its press.
        noted = next((seen.noted_ns for seen in station.seen if seen.judged_ns > one.told_ns), 1 << 62)
        is_unrecorded = any(one.told_ns <= ended <= noted for ended in station.ended_ns)
        if own:
            presses.remove(own[-1])
            if one.told_ns - own[-1].came_ns > DEADLINE_S * S and not is_unrecorded:
                yield f"the pulse on channel {one.channel} {when} was given after its deadline"
        elif not is_unrecorded:
            yield f"the pulse on channel {one.channel} {when} belongs to no press"


def audit_pulses(world: World, station: Station) -> Iterator[str]:
    """Each press that asks for a pulse gets it in time, or the alarm `pulse` counts one more (docs/operations.md).

    The owner of the relay does one of the two with its next turn after the deadline, and after the press is recorded; a
    process that has ended before does not. Each count of the alarm stands for one press.
    """
    turns_ns, late_ns, told = station.switch_turns_ns, list(station.late_ns), world.relay.told
    for one in (one for one in station.seen if one.shown):
        channel = GATE if one.shown == "pass" else REJECT
        due_ns = max(one.noted_ns, one.came_ns + round(DEADLINE_S * S))
        done_ns = next(iter(turns_ns[bisect_right(turns_ns, due_ns) :][:2][1:]), None)
        if done_ns is None or any(one.judged_ns <= ended_ns <= done_ns for ended_ns in station.ended_ns):
            continue
        since_ns = one.judged_ns - round(PULSE_S * S)  # one that was on already is made longer
        if any(pulse.channel == channel and since_ns <= pulse.told_ns <= due_ns for pulse in told):
            continue
        late = next((when_ns for when_ns in late_ns if one.judged_ns <= when_ns <= done_ns), None)
        if late is None:
            yield (
                f"press {one.press_id} was {one.shown} at {one.judged_ns / S:.3f} s, and neither its pulse on channel "
                f"{channel} was given nor the alarm pulse counts one more"
            )
        else:
            late_ns.remove(late)


def _audit_hung(world: World, station: Station) -> Iterator[str]:
    """What was seen before the loop hung tells nothing of the part that lies there now."""
    hung = [
        (began_ns, ended_ns) for began_ns, ended_ns in station.hung if ended_ns - began_ns > UNHEARD_S * S
    ]
    for one in world.relay.switched:
        came_ns = max([seen.came_ns for seen in station.seen if seen.noted_ns <= one.told_ns], default=0)
        is_old = any(came_ns <= began_ns <= one.told_ns for began_ns, _ in hung)
        if one.channel in (LAMP, LIFT) and is_old:
            name = "a pass" if one.channel == LAMP else "lift"
            yield f"{name} was shown at {one.told_ns / S:.3f} s, and the loop hung since its press was seen"
