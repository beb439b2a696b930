"""What holds of the contact as a robot sees it (docs/contact.md, What a robot is told)."""

from collections.abc import Iterator

from simulation.alarms import is_sensor_lost
from simulation.auditors_outputs import OPENED_S, SHOWN_S
from simulation.lives import Station
from simulation.outputs import FREE, LIFT
from simulation.sensor import S
from simulation.surroundings import World

UNSEEN_S = 0.27
"""What has not been seen for so long is not known."""


def audit_contact(world: World, station: Station) -> Iterator[str]:
    """What holds at each moment: nothing is said of a gel that nobody sees, nor what is over."""
    relay, now_ns, presses = world.relay, world.clock.now_ns, world.hand.presses
    is_well = relay.mood == "up" and now_ns - relay.well_since_ns > OPENED_S * S and not station.is_held_up
    shown = [name for channel, name in ((LIFT, "lift"), (FREE, "free")) if relay.is_on[channel]]
    is_lost = is_sensor_lost(world, station) and is_well
    lost_ns = station.so_since("the contact is not seen", is_lost)
    state = station.loop.parts.status.view().state
    halted_ns = station.so_since(
        f"the contact of no ready station {world.new_gel_ns}", is_well and state != "ready"
    )
    if not is_well or not shown:
        return
    if len(shown) > 1:
        yield "lift and free are shown at once"
    if lost_ns is not None and now_ns - lost_ns > (UNSEEN_S + SHOWN_S + 2 / station.fps) * S:
        yield f"nothing is seen for {(now_ns - lost_ns) / S:.1f} s, and {shown[0]} is shown"
    if halted_ns is not None and now_ns - halted_ns > SHOWN_S * S:
        yield f"the station is {state}, and {shown[0]} is shown"
    if not presses or presses[-1].why:
        return
    press, since_ns = presses[-1], presses[-1].end_ns or presses[-1].begin_ns
    is_told = now_ns - since_ns > (world.noticed_s + SHOWN_S) * S
    if "free" in shown and not press.end_ns and is_told:
        yield f"press {press.number} is held, and free is shown"
    if "lift" in shown and press.end_ns and is_told:
        yield f"press {press.number} is over, and lift is shown"


def audit_lifts(world: World, station: Station) -> Iterator[str]:
    """A part may be lifted when its press is recorded, and not by the verdict of another."""
    for one in world.relay.switched:
        if one.channel != LIFT:
            continue
        begun = [press for press in world.hand.presses if press.begin_ns <= one.told_ns][-1:]
        own = [seen for seen in station.seen if begun and begun[0].begin_ns <= seen.noted_ns <= one.told_ns]
        if not begun or not (own or begun[0].why):
            number = begun[0].number if begun else "none"
            yield f"lift was shown at {one.told_ns / S:.3f} s, and press {number} was not recorded yet"
