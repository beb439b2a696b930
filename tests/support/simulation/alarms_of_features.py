"""Reasons of alarms (`alarms.py`): what people say, pieces, shadows, second presses and marks on the gel."""

from simulation.lives import Station
from simulation.sensor import S
from simulation.surroundings import WALL_NS, World

WITHIN_S = 1.2
"""The next part comes in that time, or later."""

SCORED = ("pass", "fail", "unsure")
"""Verdicts that have a score."""
NEWEST_WORD = (
    "SELECT arguments ->> '$.verdict' FROM acts WHERE verb = 'confirm_press' AND outcome = 'done' "
    "AND arguments ->> '$.press_id' = press_id ORDER BY act_id DESC LIMIT 1"
)
"""What was said of a press last."""


def has_escaped(world: World, station: Station) -> bool:
    """By the newest word on it a press that passed is damaged. The words of a day count."""
    query = f"SELECT 1 FROM presses WHERE verdict = 'pass' AND ({NEWEST_WORD}) = 'damaged' LIMIT 1"
    is_asked = station.signed and not is_clock_set(world, station)
    return bool(is_asked and station.disk.read(query))


def is_clock_set(world: World, station: Station) -> bool:
    return world.clock.wall_ns != WALL_NS


def is_piece_late(world: World, station: Station) -> bool:
    """The newest piece was not complete in time, and may still lie there."""
    query = "SELECT ended_by FROM pieces ORDER BY number DESC LIMIT 1"
    return world.has_pieces and station.disk.read(query) == [("time",)]


def may_piece_be_late(world: World, station: Station) -> bool:
    return bool(world.shelf.wrong)


def is_shadow_broken(world: World, station: Station) -> bool:
    return world.shelf.is_shadow_broken and world.shelf.is_asked


def may_shadow_be_broken(world: World, station: Station) -> bool:
    return world.shelf.is_shadow_broken or not world.shelf.is_asked


def has_taken_over(world: World, station: Station) -> bool:
    """Another bundle inspects than before."""
    told = [bundle_id for _, bundle_id in station.told[-1:]]
    return world.shelf.is_takeover_open and told == [world.shelf.ids[0]]


def may_take_over(world: World, station: Station) -> bool:
    """It has once; nobody has signed the acknowledgement here, so that a restart says it again."""
    return world.shelf.has_taken_over


def lacks_second(world: World, station: Station) -> bool:
    """The newest press has asked for another one of its part, which did not come in time."""
    newest = station.seen[-1] if station.seen else None
    if newest is None or newest.word != "unsure" or newest.noted_ns < station.began_ns:
        return False
    is_last = newest.press_id == next(reversed(station.judged_ns))
    if not is_last or world.clock.now_ns - newest.judged_ns <= WITHIN_S * S:
        return False
    results = next(iter(world.brokers.values())).results.get(newest.press_id, [])
    again = [result["press_again"] for result in results]
    return any(isinstance(one, dict) and one["is_asked"] for one in again)


def may_lack_second(world: World, station: Station) -> bool:
    """One of the newest has; the next one ends it, and without a score it asks again."""
    return any(seen.word == "unsure" for seen in station.seen[-3:])


def is_blind(world: World, station: Station) -> bool:
    """The gel was damaged, and some presses were scored since, also the newest: the first one finds the marks."""
    marked_ns = world.hand.marked_ns[-1] if world.hand.is_marked else world.clock.now_ns
    newest = station.seen[-3:]
    scored = [(seen.frame_ns or 0) > marked_ns and seen.word in ("fail", "unsure") for seen in newest]
    return scored == [True] * 3 and newest[-1].noted_ns > station.began_ns


def may_be_blind(world: World, station: Station) -> bool:
    """It is damaged, or was, and the newest press with a score has not passed since: a dent may lie where it was."""
    wiped_ns = world.hand.marked_ns[-1] if world.hand.marked_ns else 0
    scored = [seen for seen in station.seen if seen.word in SCORED]
    has_passed = any(seen.word == "pass" and (seen.frame_ns or 0) > wiped_ns for seen in scored[-1:])
    return world.hand.is_marked or (bool(world.hand.marked_ns) and not has_passed)
