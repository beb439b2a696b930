"""What holds of the bundles that judge (docs/operations.md, Exchange a bundle while the station runs)."""

import json
from collections.abc import Iterator

from simulation.bundles import PARTS
from simulation.lives import Station
from simulation.sensor import S
from simulation.surroundings import World

REPORTED_S = 2.0
"""What was read again is an act by then, also while something presses."""
WAITS = "read at the next start alone: "
OPENED_S = 6.0
"""What was asked for is opened by then, and a press has ended."""


def audit_bundles(world: World, station: Station) -> Iterator[str]:
    """What holds at each moment: what is told is whole, and of its part; a new one comes, and a broken one is said."""
    shelf, now_ns = world.shelf, world.clock.now_ns
    _, message = station.loop.parts.publisher.retained_state._latest.get("info", (0, None))
    if message is None:
        return
    info, view = json.loads(message.payload), station.loop.parts.status.view()
    told, part = info["bundle_id"], info["part"]
    if [told] != [bundle_id for _, bundle_id in station.told[-1:]]:
        station.told.append((now_ns, told))
    if shelf.parts.get(told) != part:
        yield f"bundle {told[:8]} is told as that of {part}, and is of {shelf.parts.get(told, 'no whole bundle')}"
    is_well = view.state == "ready" and not station.is_held_up and not station.is_disk_disturbed
    asked = world.edited.asked
    waits_ns = station.so_since("a configuration was edited", is_well and asked is not None, asked)
    if waits_ns is not None and now_ns - waits_ns > REPORTED_S * S:
        yield from _audit_waiting(world, station)
    well_ns = station.so_since("a bundle is awaited", is_well and shelf.asked > 0, (shelf.asked, part))
    if well_ns is None or now_ns - well_ns < OPENED_S * S:
        return
    number = PARTS.index(part)
    if shelf.wrong and shelf.is_asked and "bundle" not in view.alarms:
        yield f"the bundle is {[*shelf.wrong.values()]}, and the alarm bundle is not raised"
    if shelf.is_asked and number not in shelf.wrong and told != shelf.ids[number]:
        yield f"bundle {shelf.ids[number][:8]} of {part} was to be opened, and {told[:8]} is told"


def _audit_waiting(world: World, station: Station) -> Iterator[str]:
    """The acts have what else of the configuration waits for a restart (docs/operations.md, Exchange a bundle)."""
    edited = world.edited
    life, before = edited.asked or (0, 0)
    edited.asked = None
    if life != station.lives:
        return
    query = "SELECT sentence, (SELECT count(*) FROM acts WHERE verb = 'open_bundles') FROM acts WHERE verb = "
    sentence, openings = station.disk.read(f"{query} 'open_bundles' ORDER BY act_id DESC LIMIT 1")[0]
    is_waiting = edited.stats_s != station.config.station.stats_s
    if openings == before or (f"{WAITS}station" in (sentence or "")) is not is_waiting:
        yield f"stats_s is {edited.stats_s}, and was at the start {station.config.station.stats_s}: act '{sentence}'"


def audit_judges(world: World, station: Station) -> Iterator[str]:
    """A press is judged by the bundle that was told when it began, which is of its part."""
    results = {key: same[0] for broker in world.brokers.values() for key, same in broker.results.items()}
    for seen in station.seen:
        result = results.get(seen.press_id)
        begun = [one for one in world.hand.presses if one.begin_ns <= (seen.frame_ns or seen.judged_ns)][-1:]
        if result is None or not begun:
            continue
        press, judge = begun[0], result["bundle_id"]
        soon_ns = press.begin_ns + round(world.noticed_s * S)
        until_ns = (seen.judged_ns if press.why else soon_ns) + 2 * world.sensor.period_ns
        before = [told for when, told in station.told if when <= press.begin_ns][-1:]
        during = [told for when, told in station.told if press.begin_ns < when <= until_ns]
        if judge not in (*before, *during):
            told = " or ".join(one[:8] for one in (*before, *during))
            yield f"press {press.number} is judged by bundle {judge[:8]}, and told was {told}"
        if world.shelf.parts.get(judge) != result["part"]:
            yield f"press {press.number} of {result['part']} is judged by a bundle of {world.shelf.parts.get(judge)}"
