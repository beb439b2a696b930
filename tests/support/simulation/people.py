"""What people do at a station: they change gel and part, reload, acknowledge, ask, and forge."""

import random
from collections.abc import Callable
from datetime import timedelta
from typing import TYPE_CHECKING

from edge.clock import local_day
from edge.core.errors import GelgateError, StoreError
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES
from simulation.bundles import PARTS
from simulation.options import SECRET
from simulation.sensor import BEING_LEARNT

LIES_S = 3.0
"""A part that lies on a new gel; by then that is learnt."""

if TYPE_CHECKING:
    from simulation.schedule import Simulation


def replace_gel(run: "Simulation", rng: random.Random) -> float:
    """A person changes the gel, says so, and goes on when the new one was seen free for a while, or too soon. The
    station hears it after what it saw before."""
    hand = run.world.hand
    if hand.press is not None or run.world.sensor.is_behind:
        return -0.1
    hand.wait(4)
    try:
        today, days = local_day(run.world.clock.time_ns()), rng.choice((None, -1, 0, 30))
        use_by = None if days is None else str(today + timedelta(days))
        answer = run.station.ask("replace_gel", use_by=use_by)
        run.world.gels.select(run.world.clock.now_ns, answer["gel_id"])
        run.world.new_gel_ns = run.world.clock.now_ns
        if not run.chosen.has_free_view and rng.random() < 0.5:
            hand.lie(run.world.clock.now_ns, LIES_S)
            run.world.sensor.disturb(BEING_LEARNT)
        run.reach(
            "the gel was replaced while a broker was away" if run.is_broker_away else "the gel was replaced"
        )
        if run.station.disk.is_full:
            run.reach("the gel was replaced while the disk was full")
        run.note("the gel is replaced")
    except (GelgateError, ValueError) as error:  # the latter where presses wait to be recorded
        run.world.gels.forget(run.world.clock.now_ns)
        run.reach("the gel could not be replaced")
        run.note(f"the gel is not replaced: {error}")
    return 0.0


def select_part(run: "Simulation", rng: random.Random) -> float:
    """A command selects the other part, at any moment."""
    parts = run.world.parts
    if run.world.has_pieces:
        return 60.0
    if any(plc.has_just_asked for plc in run.world.plcs):
        return -0.1
    part = PARTS[1 - PARTS.index(parts.wanted)]
    try:
        answer = run.station.ask("select_part", part=part, position="pos1")
    except GelgateError as error:
        run.note(f"part {part} is not selected: {error}")
        return 0.0
    except ValueError as error:
        run.station.found.append(f"part {part} cannot be selected, and a bundle of it was opened: {error}")
        return 0.0
    parts.select(run.world.clock.now_ns, part)
    if run.station.disk.is_dead:
        parts.forget(run.world.clock.now_ns)  # it may have died before that was recorded
    run.station.has_selected_late = is_waiting = answer["is_waiting"]
    run.reach("a part change came during a press, and waited" if is_waiting else "the part was changed")
    if run.world.hand.press and not is_waiting:
        run.reach("a part change came as a press began, or after its verdict")
    run.note(f"part {part} is selected{', and waits' if is_waiting else ''}")
    return 0.0


def begin_piece(run: "Simulation", rng: random.Random) -> float:
    """A person begins a piece beside the PLC, whose trigger may have named another one."""
    now_ns, pieces = run.world.clock.now_ns, run.world.pieces
    if not (run.world.has_pieces and run.world.has_plc):
        return 60.0
    # The station may hear of the piece that a PLC names only after this one.
    if any(plc.has_just_asked for plc in run.world.plcs):
        return -0.1
    name = f"piece by hand {now_ns // 1_000_000}"
    try:
        run.station.ask("begin_piece", piece_id=name)
    except ValueError:  # something presses, or waits to be recorded
        return -0.5
    except GelgateError:  # the commit may have been made
        pieces.forget(now_ns)
        return -0.5
    pieces.select(now_ns, name)
    if run.station.disk.is_dead:
        pieces.forget(now_ns)
    if any(plc.waits_for_piece for plc in run.world.plcs):
        run.reach("a person began another piece than the PLC")
    run.note(f"{name} is begun")
    return 0.0


def reload(run: "Simulation", rng: random.Random) -> float:
    """A command opens the bundles again."""
    run.station.ask("reload")
    run.reach_here("the bundles were opened again")
    run.note("the bundles are opened again")
    return 0.0


def request(run: "Simulation", rng: random.Random) -> float:
    """A request comes over MQTT: signed, forged, repeated, or of nobody."""
    kind = rng.choice(("signed", "forged", "unsigned", "repeated", "repeated", "too large", "elsewhere"))
    verb = rng.choice(("self_test", "reload", "acknowledge_alarm", "trigger"))
    if run.chosen.trigger == "command" and verb == "trigger":
        verb = "reload"  # the person at the station asks, and who knows for which press this one would ask
    arguments = {"alarm": "pulse"} if verb == "acknowledge_alarm" else {}
    secret = {"signed": SECRET, "forged": "another secret of nobody here, and long", "repeated": SECRET}.get(
        kind
    )
    if kind == "too large":
        arguments |= {"more": "x" * LARGEST_REQUEST_BYTES}
    transaction = run.station.send_request(verb, arguments, secret, elsewhere=kind == "elsewhere")
    if kind == "repeated":
        again_s = rng.choice((0.5, 3, 40))
        run.later(again_s, lambda: run.station.send_request(verb, arguments, secret, transaction))
    run.reach(f"a {kind} request")
    run.note(f"a {kind} request, {verb}")
    return 0.0


def acknowledge(run: "Simulation", rng: random.Random) -> float:
    """A person acknowledges what stays."""
    station = run.station
    raised = sorted({"pulse", "counts", "outbox_full", "takeover"} & station.loop.parts.status.view().alarms)
    for alarm in raised:
        try:
            station.ask("acknowledge_alarm", alarm=alarm)
        except StoreError:  # the answer is an error, and the alarm stays
            return -0.5
        run.reach(f"the alarm {alarm} was acknowledged")
        station.is_loss_open &= alarm != "counts"
        station.is_drop_open &= alarm != "outbox_full"
        run.world.shelf.is_takeover_open &= alarm != "takeover"
    return 0.0 if raised else -0.5


def break_tool(run: "Simulation", rng: random.Random) -> float:
    """The tool breaks that makes the parts: each is dented until somebody sees it."""
    if run.world.hand.dents:
        return -1.0
    run.world.hand.dents = rng.randint(6, 9)
    run.note(f"the next {run.world.hand.dents} parts are dented")
    return 0.0


PEOPLE: "dict[str, Callable[[Simulation, random.Random], float]]" = {
    "replace gel": replace_gel,
    "select part": select_part,
    "begin piece": begin_piece,
    "reload": reload,
    "request": request,
    "acknowledge": acknowledge,
    "break tool": break_tool,
}
