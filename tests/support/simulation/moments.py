"""The moments at which faults do most harm."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from simulation.chosen import is_small
from simulation.outputs import LAMP
from simulation.sensor import S

if TYPE_CHECKING:
    from simulation.schedule import Simulation

WAITS_S = 4
"""A broker is away for so long, and then a result waits for it."""


def is_unjudged(run: "Simulation") -> bool:
    """A press has no verdict yet."""
    press, seen = run.world.hand.press, run.station.seen
    return press is not None and not (seen and seen[-1].noted_ns > press.begin_ns)


def _is_noticed_unjudged(run: "Simulation") -> bool:
    """A press was noticed, and has no verdict yet. Of a slow sensor only those are that rest late."""
    press = run.world.hand.press
    is_noticed = press is not None and run.world.clock.now_ns - press.begin_ns > run.world.noticed_s * S
    return is_noticed and is_unjudged(run)


def _is_pressed_judged(run: "Simulation") -> bool:
    """A part lies on the gel, and its press has a verdict."""
    hand, seen = run.world.hand, run.station.seen
    is_judged = hand.press is not None and bool(seen) and seen[-1].noted_ns > hand.press.begin_ns
    return is_judged and hand.is_down


def _is_piece_asked_for(run: "Simulation") -> bool:
    """A trigger names a piece, and its press has not begun."""
    return run.world.hand.press is None and any(plc.waits_for_piece for plc in run.world.plcs)


def _is_part_asked_for(run: "Simulation") -> bool:
    """A trigger names a part, and its press has not begun."""
    return run.world.hand.press is None and any(plc.waits_for_part for plc in run.world.plcs)


def _is_pass_shown(run: "Simulation") -> bool:
    return run.world.relay.is_on[LAMP] and run.world.hand.press is None


def _is_press_waiting(run: "Simulation") -> bool:
    """A press that has ended is not recorded, for the disk is full."""
    press = run.world.hand.presses[-1] if run.world.hand.presses else None
    has_begun = press is not None and press.begin_ns > run.station.disk.full_since_ns
    return run.station.loop.is_halted and has_begun and 0 < press.end_ns < run.world.clock.now_ns - 2 * S


def _is_loss_unread(run: "Simulation") -> bool:
    """A press waits for room, a result for its broker, or messages were dropped from a full outbox, and nobody has
    acknowledged it."""
    if is_small(run.chosen.outbox_mb):
        return run.station.is_drop_open and not run.is_broker_away
    return _is_press_waiting(run) or _is_result_waiting(run)


def _is_press_unrecorded(run: "Simulation") -> bool:
    """A press has no row: it waits for room on the disk, or its verdict comes next."""
    is_full = run.station.disk.is_full or "fill disk" in run.meeting
    is_unsent = "hang up" not in run.meeting or _is_result_unsent(run)
    return _is_press_waiting(run) and is_unsent if is_full else is_unjudged(run)


def is_held_up(run: "Simulation") -> bool:
    """The station has a press that there is no room for, and a broker does not have the one before."""
    loop = run.station.loop
    is_waiting = loop.is_halted and loop.session is not None and loop.session.unrecorded > 0
    return is_waiting and _is_result_unsent(run)


def _is_result_waiting(run: "Simulation") -> bool:
    """A broker has taken nothing for the time of a press and more."""
    begun_ns = [broker.away_since_ns for broker in run.world.brokers.values() if broker.away_since_ns]
    return bool(begun_ns) and run.world.clock.now_ns - min(begun_ns) > WAITS_S * S


def _is_result_unsent(run: "Simulation") -> bool:
    """The newest press was recorded after its broker went away."""
    begun_ns = [broker.away_since_ns for broker in run.world.brokers.values() if broker.away_since_ns]
    return bool(begun_ns and run.station.seen) and run.station.seen[-1].noted_ns > min(begun_ns)


MOMENTS: "dict[str, Callable[[Simulation], bool]]" = {
    "select part": lambda run: _is_noticed_unjudged(run) or _is_part_asked_for(run),
    "replace gel": lambda run: _is_pass_shown(run) or run.station.disk.is_full,
    "kill": _is_press_unrecorded,
    "lose power": _is_press_unrecorded,
    "stop": _is_loss_unread,
    "step clock": _is_result_waiting,
    "silence": lambda run: run.world.hand.is_pressing_soon,
    "blind": _is_pass_shown,
    "hold back": is_unjudged,
    "freeze": is_unjudged,
    "fill disk": lambda run: "hang up" not in run.meeting or _is_result_unsent(run),
    "unplug": _is_pressed_judged,
    "lock database": is_unjudged,
    "exchange bundle": is_unjudged,
    "begin piece": _is_piece_asked_for,
}
"""When a fault does most harm: every other one waits for it."""


WAIT_FIRST = {"step clock", "silence", "blind", "hold back", "unplug", "begin piece", "freeze"}
"""Faults whose first one waits; of others a draw says whether it does."""
