"""Alarms that must be raised, and cleared, within a stated time (docs/operations.md)."""

from bisect import bisect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import date

from edge.clock import local_day
from simulation.alarms_of_features import (
    NEWEST_WORD,
    SCORED,
    has_escaped,
    has_taken_over,
    is_blind,
    is_clock_set,
    is_piece_late,
    is_shadow_broken,
    lacks_second,
    may_be_blind,
    may_lack_second,
    may_piece_be_late,
    may_shadow_be_broken,
    may_take_over,
)
from simulation.auditors_outbox import REPORTED_S
from simulation.chosen import is_small
from simulation.disk import ROOM_BYTES
from simulation.hand import SLIPS_AFTER, MadePress
from simulation.lives import Seen, Station
from simulation.plc import Server
from simulation.sensor import BEING_LEARNT, SERIAL, S
from simulation.surroundings import WALL_NS, World

OFFERED_S = 60.0
"""What was refused is offered again within a minute."""


@dataclass(frozen=True)
class Rule:
    """alarm: raised when `is_so` was so for `raised_s`; it may be raised while that, or `may_be`; cleared `cleared_s`
    after."""

    alarm: str
    is_so: Callable[[World, Station], bool]
    raised_s: float
    may_be: Callable[[World, Station], bool]
    cleared_s: float


def is_sensor_lost(world: World, station: Station) -> bool:
    """Tell whether nobody can see the gel now."""
    sensor = world.sensor
    is_silent = sensor.is_silent or sensor.is_frozen or sensor.is_covered or sensor.is_holding
    is_broken = sensor.damage[0] != "" and sensor.damage[1] == 1.0
    return not sensor.is_plugged or sensor.serial != SERIAL or is_silent or is_broken


def _is_sensor_disturbed(world: World, station: Station) -> bool:
    """Something is wrong with it, which may raise the alarm or not."""
    return bool(world.sensor.troubles)


def _is_relay_away(world: World, station: Station) -> bool:
    return world.relay.mood == "unplugged"


def _is_relay_disturbed(world: World, station: Station) -> bool:
    return world.relay.mood != "up"


def _is_pedal_away(world: World, station: Station) -> bool:
    return world.pedal.mood == "unplugged"


def _may_be_pressed(world: World, station: Station) -> bool:
    return world.hand.press is not None or bool(world.sensor.troubles)


def _is_learnt_touched(world: World, station: Station) -> bool:
    """A part lay on the gel while that was learnt, and was lifted, and the station has not said so yet."""
    press = world.hand.lain
    known = {BEING_LEARNT, "the station said 'starting'", "the station said 'halted'"}
    if press is None or press.why - known or press.begin_ns < world.new_gel_ns:
        world.hand.lain = None
        return False
    if "free_gel" in station.loop.parts.status.view().alarms:
        world.hand.lain = None
    return press.end_ns > 0


def _is_plc_silent(world: World, station: Station) -> bool:
    return world.has_plc and len(world.plcs) == 1 and world.plcs[0].mood in ("cut", "mute")


def _may_plc_be_named(world: World, station: Station) -> bool:
    """Its watchdog stands still, or a result waits for its acknowledgement."""
    return world.has_plc and (world.plcs[0].mood != "up" or len(world.plcs) > 1 or Server.now.has_result)


def _never(world: World, station: Station) -> bool:
    return False


def _always(world: World, station: Station) -> bool:
    return True


def _is_disk_disturbed(world: World, station: Station) -> bool:
    return station.is_disk_disturbed


def _is_disk_low(world: World, station: Station) -> bool:
    return station.disk.free_bytes < ROOM_BYTES


def _takes_no_file(world: World, station: Station) -> bool:
    return station.disk.is_full or _is_disk_low(world, station)


def _is_newest_judged(station: Station, since_ns: int) -> bool:
    """The newest press of a part was judged since then, and this life has recorded it."""
    kept = (one for one in reversed(station.seen) if one.shown and station.config.archive.presses)
    newest = next(kept, None)
    is_own = newest is not None and newest.word in ("pass", "fail") and newest.noted_ns > station.began_ns
    return is_own and newest.judged_ns > since_ns


def _is_not_archived(world: World, station: Station) -> bool:
    return _takes_no_file(world, station) and _is_newest_judged(station, station.disk.full_since_ns)


def _may_not_be_archived(world: World, station: Station) -> bool:
    return _takes_no_file(world, station) or not _is_newest_judged(station, world.lacks_files_ns)


def _is_overview_away(world: World, station: Station) -> bool:
    return world.overview is not None and world.overview.mood in ("unplugged", "silent", "frozen")


def _is_overview_disturbed(world: World, station: Station) -> bool:
    return world.overview is not None and world.overview.mood != "up"


def _is_broker_disturbed(world: World, station: Station) -> bool:
    return any(broker.mood != "up" for broker in world.brokers.values())


def _is_refused(world: World, station: Station, alarm: str, topics: tuple[str, ...]) -> bool:
    """A broker has refused such a message since the alarm was seen last, and a report can say so."""
    since_ns = station.raised_ns.get(alarm, 0)
    refused = [broker.refused for broker in world.brokers.values() if broker.mood != "silent"]
    return not station.is_disk_disturbed and any(
        at_ns > since_ns and name.startswith(topics) for one in refused for name, at_ns in one.items()
    )


def _is_row_refused(world: World, station: Station) -> bool:
    is_kept = not is_small(station.config.store.outbox_mb)
    return is_kept and _is_refused(world, station, "refused", ("result", "heatmap"))


def _is_receiver_at_fault(world: World, station: Station) -> bool:
    """A broker keeps no second connection, or wants no alarm, or not to know what the station is."""
    is_alone = any(one.mood == "lets one in" and one.is_connected for one in world.brokers.values())
    return is_alone or _is_refused(world, station, "receiver", ("alarm", "info"))


def _has_lost_frames(world: World, station: Station) -> bool:
    """More were dropped than may be, and no report has said so; those that a database cost have their own alarm."""
    lost_ns, reported_ns = station.lost_frames_ns, round(REPORTED_S * S)
    well_ns = station.so_since("its disk is well", not station.is_disk_disturbed)
    is_disks = well_ns is None or (well_ns > station.began_ns + S and lost_ns - well_ns < reported_ns)
    is_late = 0 < lost_ns < world.clock.now_ns - reported_ns
    return is_late and station.raised_ns.get("overload", 0) < lost_ns and not is_disks


def _is_disturbed(world: World, station: Station) -> bool:
    return bool(world.sensor.troubles) or station.is_disk_disturbed


def _is_otherwise(world: World, station: Station) -> bool:
    is_off = station.loop.parts.selection.inspector.bundle is station.off_bundle
    return is_off and not _is_disturbed(world, station)


def _may_be_otherwise(world: World, station: Station) -> bool:
    return station.off_bundle is not None or _is_disturbed(world, station)


# Of what is recorded


def _is_worn(world: World, station: Station) -> bool:
    """From four fifths of its limit on a gel is due."""
    _, presses, limit, _ = station.mounted_gel()
    return bool(presses >= 0.8 * limit)


def _is_past_date(world: World, station: Station) -> bool:
    """It is past its last day of use."""
    use_by = station.mounted_gel()[3]
    return use_by is not None and local_day(world.clock.time_ns()) > date.fromisoformat(use_by)


def _may_be_past_date(world: World, station: Station) -> bool:
    """The alarm stays for two hours where a clock is set back."""
    return world.clock.wall_ns != WALL_NS and station.mounted_gel()[3] is not None


def _is_other_gel(world: World, station: Station) -> bool:
    """Each bundle is older than any gel but the first, and nobody has proven it."""
    return bool(station.mounted_gel()[0] != f"{SERIAL}-1")


def _may_be_unproven(world: World, station: Station) -> bool:
    return station.has_lost_pieces


def _find_judged(world: World, station: Station) -> list[tuple[Seen, MadePress]]:
    """Find the presses of parts that have a score in this life, in order."""
    judged = []
    for seen in station.seen:
        if seen.noted_ns > station.began_ns and seen.word in SCORED and seen.frame_ns:
            number = bisect(world.hand.presses, seen.frame_ns, key=lambda press: press.begin_ns)
            judged += [(seen, press) for press in world.hand.presses[:number][-1:] if not press.master_ns]
    return judged


def _find_sole_part(world: World, station: Station) -> str:
    """Find the part that is inspected, if it has had one bundle alone."""
    part = world.shelf.parts[station.told[-1][1]] if station.told else ""
    of_part = {told for _, told in station.told if world.shelf.parts.get(told) == part}
    return part if len(of_part) == 1 else ""


def _is_of_one_gel(world: World, station: Station, judged: Sequence[tuple[Seen, MadePress]]) -> bool:
    """All are of the mounted gel, and of one bundle, which is in use."""
    ids = ", ".join(f"'{seen.press_id}'" for seen, _ in judged)
    query = f"SELECT DISTINCT gel_id, part FROM presses WHERE press_id IN ({ids})"
    here = station.mounted_gel()[0], _find_sole_part(world, station)
    return [*station.disk.read(query)] == [here]


def _is_damage_repeated(world: World, station: Station) -> bool:
    """Five in a row fail at one place."""
    newest = _find_judged(world, station)[-5:]
    is_dent = [press.what == "dented" and not (press.why or press.way == "hard") for _, press in newest]
    return is_dent == [True] * 5 and _is_of_one_gel(world, station, newest)


def _may_damage_repeat(world: World, station: Station) -> bool:
    """The newest is not a sound one."""
    return not any(press.what == "sound" and not press.why for _, press in _find_judged(world, station)[-1:])


CHARTED, DEEPER = 12, 8
"""When so many presses have passed, and then so many that lay deeper, a shift is said."""


def _has_slipped(world: World, station: Station) -> bool:
    """The newest that have passed lie deeper than those before, of which there are enough."""
    passed = [one for one in _find_judged(world, station) if one[0].word == "pass"]
    deeper = [press.number >= SLIPS_AFTER for _, press in passed]
    # What hung as a part rested on the way may have seen no more of it.
    is_usual = not any(
        press.way == "hard" or (press.why and press.way in ("slow", "hesitating")) for _, press in passed
    )
    is_enough = deeper.count(False) >= CHARTED and deeper.count(True) >= DEEPER
    return is_usual and is_enough and _is_of_one_gel(world, station, passed)


def _is_master_due(world: World, station: Station) -> bool:
    """No press of the master piece was made on this gel."""
    if not station.config.reference.pieces:
        return False
    return (station.mounted_gel()[0],) not in station.disk.read("SELECT gel_id FROM reference_presses")


def _is_promise_broken(world: World, station: Station) -> bool:
    """A third of the presses of this bundle and gel fail, of which people call four or more good, and few damaged."""
    if not world.is_lenient or world.clock.wall_ns != WALL_NS:
        return False
    query = (
        f"SELECT ({NEWEST_WORD}), verdict = 'fail' FROM presses "
        "WHERE verdict IN ('pass', 'fail') AND gel_id = ? AND part = ? AND evidence IS NOT NULL"
    )
    judged = station.disk.read(query, station.mounted_gel()[0], _find_sole_part(world, station))
    failed = [word for word, has_failed in judged if has_failed]
    is_good = failed.count("good") >= max(4, 4 * sum(word not in ("good", None) for word in failed))
    return (
        is_good
        and 3 * len(failed) >= len(judged)
        and not (station.has_lost_pieces or _is_other_gel(world, station))
    )


def _may_promise_be_broken(world: World, station: Station) -> bool:
    return world.is_lenient


SEEN = (
    # Two seconds without a picture are a fault; 38 frames in a row that cannot be read are.
    Rule("device", is_sensor_lost, 6.5, _is_sensor_disturbed, 14.0),
    # Its presence is asked for once a second; it is opened again every 0.5 to 5 s, and a second.
    Rule("actuator", _is_relay_away, 2.5, _is_relay_disturbed, 8.0),
    Rule("trigger_device", _is_pedal_away, 2.5, _is_pedal_away, 8.0),
    # A second without a beat; after a cable that was pulled its own old connection may write for three seconds.
    Rule("plc", _is_plc_silent, 2.5, _may_plc_be_named, 6.0),
    # The lift shows it, if nothing else does; it ends when the gel is seen free.
    Rule("free_gel", _is_learnt_touched, 0.5, _may_be_pressed, 8.0),
    Rule("contact", _never, 0.0, _may_be_pressed, 8.0),
    # It ends when the gel is seen free.
    Rule("gel_overload", _never, 0.0, _may_be_pressed, 8.0),
    # It ends with the next press that is recorded, or with the next report, every 10 s.
    Rule("store", _never, 0.0, _is_disk_disturbed, 14.0),
    # What follows is said by a report, every 10 s.
    Rule("disk", _is_disk_low, REPORTED_S, _is_disk_low, REPORTED_S),
    Rule("refused", _is_row_refused, REPORTED_S, _is_broker_disturbed, OFFERED_S),
    Rule("receiver", _is_receiver_at_fault, REPORTED_S, _is_broker_disturbed, OFFERED_S),
    # It ends with a report in whose time no frame was dropped.
    Rule("overload", _has_lost_frames, 0.5, _is_disturbed, 2 * REPORTED_S),
    # It is said when a press is recorded, and ends with the next one that is archived.
    Rule("archive", _is_not_archived, 2.0, _may_not_be_archived, 2.0),
    # As the sensor; presses are refused, or come without its still.
    Rule("overview", _is_overview_away, 6.5, _is_overview_disturbed, 14.0),
    # A self-test scores golden frames while nothing presses the gel.
    Rule("golden", _is_otherwise, 8.0, _may_be_otherwise, 8.0),
    # It stays until a person acknowledges it.
    Rule("takeover", has_taken_over, 2.0, may_take_over, 2.0),
    # It ends with the next press.
    Rule("press_again", lacks_second, 0.3, may_lack_second, 2.0),
)

RECORDED = (
    Rule("gel", _is_worn, 3.0, _never, 3.0),
    Rule("gel_expired", _is_past_date, 3.0, _may_be_past_date, 3.0),
    Rule("gel_proof", _is_other_gel, 3.0, _may_be_unproven, 3.0),
    # It ends with the next press that is sound there.
    Rule("gel_mark", _is_damage_repeated, 3.0, _may_damage_repeat, 3.0),
    # It stays until a person acknowledges it.
    Rule("drift", _has_slipped, 3.0, _always, 0.0),
    # It may also be out of limits, or be waited for.
    Rule("reference", _is_master_due, 3.0, _always, 0.0),
    # What a person said is looked at each second.
    Rule("escape", has_escaped, 3.0, is_clock_set, 3.0),
    Rule("false_alarms", _is_promise_broken, 3.0, _may_promise_be_broken, 3.0),
    Rule("piece", is_piece_late, 3.0, may_piece_be_late, 3.0),
    # What was asked for is opened by then, and a press has ended.
    Rule("shadow", is_shadow_broken, 6.0, may_shadow_be_broken, 6.0),
    # It ends with the next press of which less is hidden.
    Rule("gel_scar", is_blind, 3.0, may_be_blind, 3.0),
)
"""They are looked at every other second, while all is recorded."""


def audit_alarms(world: World, station: Station, rules: Sequence[Rule], *, is_held_up: bool) -> Iterator[str]:
    """Compare what is so with the alarms that the station raises. A process that gets no time says nothing."""
    now_ns = world.clock.now_ns
    view = station.loop.parts.status.view()
    raised = view.alarms
    mended = {"actuator": world.relay.well_since_ns, "trigger_device": world.pedal.well_since_ns}
    if world.has_plc:
        mended["plc"] = world.plcs[0].well_since_ns  # a cut may be over between two looks
    # A sensor that is opened again may be well, until it is found that it is not; a frozen one stays the same.
    # A pause between pictures that show nothing is not their blindness.
    sensor = world.sensor
    given = sensor.given if sensor.is_frozen else sensor.openings
    # Each request opens the shadow anew, so that one which is cut may have been whole between two looks.
    of = {"device": (given, sensor.is_silent, sensor.is_holding), "shadow": world.shelf.asked}
    station.raised_ns |= dict.fromkeys(raised, now_ns)
    for rule in rules:
        is_so = not is_held_up and rule.is_so(world, station)
        may = is_held_up or is_so or rule.may_be(world, station)
        if is_so and rule.alarm in raised:
            station.reached.add(f"the alarm {rule.alarm} was raised for its reason")
        on = (is_held_up or station.mounted_gel()[0],) if rules is RECORDED else ()
        again = *on, of.get(rule.alarm)
        so_since_ns = station.so_since(f"{rule.alarm} is so", is_so, again)
        mended_ns = mended.get(rule.alarm)
        # What is recorded may have come and gone between two looks.
        is_well = not may and (rules is SEEN or rule.alarm in raised)
        well_since_ns = station.so_since(f"{rule.alarm} is well", is_well, mended_ns)
        is_late = so_since_ns is not None and now_ns - so_since_ns > rule.raised_s * S
        if is_late and rule.alarm not in raised:
            yield f"the alarm {rule.alarm} is not raised {rule.raised_s} s after its reason came"
        if rule.alarm == "device" and is_late and view.state == "ready":
            yield f"nothing was seen for more than {rule.raised_s} s, and the station is ready"
        if rule.alarm in ("device", "store") and rule.alarm in raised and view.state == "ready":
            yield f"the station is ready, and the alarm {rule.alarm} is raised"
        if well_since_ns is not None and now_ns - well_since_ns > rule.cleared_s * S and rule.alarm in raised:
            yield f"the alarm {rule.alarm} is still raised {rule.cleared_s} s after its reason went"
