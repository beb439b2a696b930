"""The faults that a schedule draws: each begins one, and returns how long it lasts, in seconds; less than 0 where it
could not begin, and when it is to be tried again."""

import random
from collections.abc import Callable
from typing import TYPE_CHECKING

from edge.core.errors import StoreError
from simulation.asked import ASKED
from simulation.chosen import MOODS, OVERVIEW, is_small
from simulation.outputs import LAMP
from simulation.overview_camera import disturb_overview
from simulation.people import PEOPLE
from simulation.plc import STEPS, Server
from simulation.second_sensor import plug_second
from simulation.sensor import OTHER_SERIAL, SERIAL, S
from simulation.shelf import exchange_bundle

if TYPE_CHECKING:
    from pathlib import Path

    from simulation.power import Unsynced
    from simulation.schedule import Simulation

WAITS_S = 4
"""A broker is away for so long, and then a result waits for it."""

LONG_S = 3
"""Nobody holds a part for so long until it is seen again."""

# The sensor


def _let_lie(run: "Simulation", rng: random.Random, lasts_s: float) -> None:
    """Mostly let a part that is pressed now lie until it has been seen again for a while."""
    hand = run.world.hand
    if lasts_s < LONG_S and hand.press is not None and hand.is_down and rng.random() < 0.7:
        hand.hold(lasts_s + 1)
        run.reach("a part lay there before and after a time without sight")


def _until_next_part(run: "Simulation", rng: random.Random, lasts_s: float) -> float:
    """Return how long a fault lasts: mostly, where a part lies there, until the gel was free for a while and the next
    one is about to be pressed, so that it is seen free once, or not at all."""
    hand = run.world.hand
    ends_s = hand.free_s - rng.choice((0, 1, 2)) / run.chosen.fps
    return ends_s if hand.press is not None and ends_s > 0.3 and rng.random() < 0.6 else lasts_s


def unplug(run: "Simulation", rng: random.Random) -> float:
    """The sensor's cable is pulled, and comes back; or another sensor is plugged in for a while."""
    sensor = run.world.sensor
    # A station that has not seen its own sensor yet takes any.
    is_other = rng.random() < 0.4 and run.station.loop.session is not None
    sensor.is_plugged, sensor.serial = is_other, OTHER_SERIAL if is_other else SERIAL
    sensor.forget()

    def plug() -> None:
        sensor.is_plugged, sensor.serial = True, SERIAL
        sensor.forget()

    name = "another sensor" if is_other else "sensor unplugged"
    # Another one that is gone at once was not opened.
    lasts_s = rng.choice((12, 2, 12) if is_other else (0.2, 2, 12))
    _let_lie(run, rng, lasts_s)
    return run.for_a_while(name, lasts_s, plug, is_sensors=True)


def silence(run: "Simulation", rng: random.Random) -> float:
    """The sensor gives no frame, and stays on the bus; or a part is put down meanwhile, and lies until it is seen."""
    sensor, hand, begun_ns = run.world.sensor, run.world.hand, run.world.clock.now_ns
    lasts_s, is_held = _until_next_part(run, rng, rng.choice((0.3, 1.5, 6, 9))), rng.random() < 0.7
    if is_held and hand.is_pressing_soon:
        lasts_s, hand.has_dented = hand.free_s + 0.4, True
    _let_lie(run, rng, lasts_s)
    sensor.is_silent = True

    def speak() -> None:
        sensor.is_silent = False
        if is_held and hand.press and hand.press.begin_ns > begun_ns and hand.is_down:
            hand.hold(1)
            run.reach("a part that nobody saw put down lay there")

    return run.for_a_while("sensor silent", lasts_s, speak, is_sensors=True)


def blind(run: "Simulation", rng: random.Random) -> float:
    """The sensor gives the same bytes again and again, or shows nothing."""
    sensor = run.world.sensor
    name = rng.choice(("sensor frozen", "sensor covered"))
    sensor.is_frozen, sensor.is_covered = name == "sensor frozen", name == "sensor covered"

    def see() -> None:
        sensor.is_frozen = sensor.is_covered = False

    return run.for_a_while(name, rng.choice((0.3, 1.5, 6, 9)), see, is_sensors=True)


def damage(run: "Simulation", rng: random.Random) -> float:
    """Some frames end in the middle, or have a hole."""
    sensor, kind = run.world.sensor, rng.choice(("corrupt", "truncated", "broken inside"))
    sensor.damage = (kind, rng.choice((0.02, 0.3, 1.0)))

    def mend() -> None:
        sensor.damage = ("", 0.0)

    return run.for_a_while(f"frames {kind}", rng.choice((0.5, 2, 5, 12)), mend, is_sensors=True)


def shake(run: "Simulation", rng: random.Random) -> float:
    """Frames come irregularly."""
    sensor = run.world.sensor
    sensor.jitter_share = rng.choice((0.2, 0.6))

    def calm() -> None:
        sensor.jitter_share = 0.0

    return run.for_a_while("frames jitter", rng.uniform(1, 10), calm, is_sensors=True)


def hold_back(run: "Simulation", rng: random.Random) -> float:
    """The bus gives nothing for a moment, then all of it in a burst."""
    sensor = run.world.sensor
    sensor.is_holding = True

    def burst() -> None:
        sensor.is_holding = False

    return run.for_a_while("frames in a burst", rng.choice((0.15, 0.6, 1.7)), burst, is_sensors=True)


# Brokers


def hang_up(run: "Simulation", rng: random.Random) -> float:
    """A broker is away, or has another of its moods."""
    broker = rng.choice(list(run.world.brokers.values()))
    is_mostly_away = is_small(run.chosen.outbox_mb) or run.is_full_and_away
    mood = rng.choice(MOODS) if rng.random() < (0.25 if is_mostly_away else 0.75) else "away"
    mood = rng.choice(run.chosen.moods) if run.chosen.moods else mood
    broker.chosen_kind = rng.choice(("result", "heatmap", "gel", "alarm", "info"))
    run.reach(f"a broker {mood}")
    broker.go("away" if mood == "restarts without memory" else mood)
    if mood == "restarts without memory":
        broker.retained.clear()
    times_s = (8, 8, 20, 20) if is_mostly_away else (1, 4, 4, 8, 20)
    lasts_s = rng.choice(times_s) * (2 if is_small(run.chosen.outbox_mb) else 1)
    return run.for_a_while(f"{broker.name} {broker.mood}", lasts_s, broker.mend)


# Disk


def fill_disk(run: "Simulation", rng: random.Random) -> float:
    """No room on the disk, then room again."""
    disk = run.station.disk
    lasts_s, room = rng.uniform(8 if run.is_full_and_away else 1, 14), rng.choice((0, 0, 30_000))
    if "replace gel" in run.meeting:
        room = max(
            room, 200_000
        )  # a gel and some presses are recorded, and no file of the archive is written
    disk.fill(room)
    disk.full_since_ns = run.world.clock.now_ns
    if run.station.loop.parts.selection.is_waiting:
        run.world.parts.forget(run.world.clock.now_ns)

    def make_room() -> None:
        disk.fill(None)
        run.world.may_lack_files(run.world.clock.now_ns)

    return run.for_a_while("disk full", lasts_s, make_room)


def slow_disk(run: "Simulation", rng: random.Random) -> float:
    """Each flush takes its time."""
    unsynced = run.station.disk.unsynced
    assert unsynced is not None
    takes_s = rng.choice((0.02, 0.1, 0.4))
    unsynced.at_sync = lambda: run.world.clock.sleep(takes_s)

    def mend() -> None:
        unsynced.at_sync = None

    return run.for_a_while("disk slow", rng.uniform(1, 8), mend, is_sensors=True)


def bad_disk(run: "Simulation", rng: random.Random) -> float:
    """Some reads, writes or flushes of the database end in an error."""
    unsynced = run.station.disk.unsynced
    assert unsynced is not None
    what, share, own = (
        rng.choice(("read", "write", "sync")),
        rng.choice((0.1, 0.5)),
        random.Random(rng.random()),
    )
    unsynced.fails = lambda call: call == what and own.random() < share
    run.station.disk_faults += 1
    run.world.parts.forget(run.world.clock.now_ns)
    run.world.gels.forget(run.world.clock.now_ns)
    run.reach(f"the disk failed to {what}")

    def mend() -> None:
        unsynced.fails = None
        run.station.disk_faults += 1
        run.world.parts.forget(run.world.clock.now_ns)
        run.world.gels.forget(run.world.clock.now_ns)

    return run.for_a_while("disk errs", rng.uniform(0.5, 5), mend, is_sensors=True)


def lock_database(run: "Simulation", rng: random.Random) -> float:
    """Another program locks the database: a shell, a check or a backup; or it is alone while the station starts."""
    locker, kind = run.station.disk.locker, rng.choice(("writes", "writes", "writes", "reads", "is alone"))
    lasts_s = rng.choice((0.6, 2.0, 4.0, 8.0, 15.0, 30.0))

    def leave() -> None:
        locker.leave()
        locker.left_ns = run.world.clock.now_ns

    def lock() -> bool:
        is_taken = locker.take(kind)
        if is_taken:
            if run.station.loop.parts.selection.is_waiting:
                run.world.parts.forget(run.world.clock.now_ns)
            run.reach(f"another program {kind} at the database")
            run.for_a_while("database locked", lasts_s, leave, is_sensors=True)
        return is_taken

    if kind == "is alone" and not run.ending.keys() & {"database locked", "disk full", "disk errs"}:
        stop(run, rng, lock)
        return lasts_s
    return lasts_s if lock() else -0.1


# Clock


def step_clock(run: "Simulation", rng: random.Random) -> float:
    """Somebody, or a time server, sets the wall clock, or it drifts from now on."""
    clock = run.world.clock
    if rng.random() < 0.3 and not run.is_broker_away:
        now_ns, clock.drift = clock.time_ns(), rng.choice((-0.01, 0.0, 0.005))
        clock.wall_ns += now_ns - clock.time_ns()
        run.reach("the wall clock drifts")
        run.note(f"the wall clock drifts by {clock.drift}")
        return 0.0
    step_s = rng.choice((-86_400, -3600, -1, 1, 3600, *[31 * 86_400] * 8))
    clock.wall_ns += step_s * S
    run.note(f"the wall clock is set by {step_s} s")
    run.reach("the wall clock went back" if step_s < 0 else "the wall clock went on")
    if run.is_broker_away:
        run.reach("the wall clock was set while a broker was away")
    return 0.0


# The process


def stop(run: "Simulation", rng: random.Random, meanwhile: Callable[[], object] = lambda: None) -> float:
    """The service is restarted: SIGTERM."""
    run.note("stopped in order")
    run.world.sensor.disturb("the gateway was restarted")
    run.reach_here("restarted")
    if run.station.disk.is_full:
        run.reach("restarted while the disk was full")
        run.note_uncounted()
    try:
        run.station.stop()
    except StoreError as error:
        run.note(f"it did not end well: {error}")
    meanwhile()
    run.open_again()
    return 0.0


def lose_database(run: "Simulation", rng: random.Random) -> float:
    """Somebody removes the database while the service is stopped."""
    # The second record of the count, that may be one press behind after a power cut, is mended with the first frame.
    if run.station.is_disk_disturbed or run.station.loop.session is None:
        return -0.5
    stop(run, rng, run.station.lose_database)
    run.world.parts.forget(run.world.clock.now_ns)
    run.reach("the database was removed")
    return 0.0


def kill(run: "Simulation", rng: random.Random) -> float:
    """The process is killed at one of its next writes."""
    run.station.disk.kill_in = _next_writes(run, rng)
    return 0.0


def lose_power(run: "Simulation", rng: random.Random) -> float:
    """The power is lost at one of the next writes: what was not synced is lost in part."""

    def lose(unsynced: "Unsynced", copy: "Path") -> None:
        if unsynced.lose(copy, rng):
            run.reach("writes were lost with the power")

    run.station.disk.kill_in, run.station.disk.lost = _next_writes(run, rng), lose
    return 0.0


def _next_writes(run: "Simulation", rng: random.Random) -> int:
    """One press and its answers take some 25; of a verdict that comes next, and of a full disk, the first are meant."""
    return rng.randint(1, 4 if run.station.disk.is_full or _is_pressed_unjudged(run) else 25)


def freeze(run: "Simulation", rng: random.Random) -> float:
    """The process gets no time for a while: the machine is suspended, or short of memory."""
    lasts_s, began_ns = rng.choice((0.3, 0.9, 1.3, 3.0, 8.0)), run.world.clock.now_ns

    def go_on() -> None:
        run.freeze(0)
        # Nobody could open a board that was plugged in meanwhile.
        if run.world.relay.well_since_ns > began_ns:
            run.world.relay.well_since_ns = run.world.clock.now_ns

    lasts_s = _until_next_part(run, rng, lasts_s)
    _let_lie(run, rng, lasts_s)
    run.freeze(lasts_s)
    return run.for_a_while("process frozen", lasts_s, go_on, is_sensors=True)


def hang(run: "Simulation", rng: random.Random) -> float:
    """The loop alone gets no time, between two frames or when it judges or records a press: its detector, or its disk,
    is slow. Other threads go on with what it said last."""
    station, lasts_s = run.station, rng.choice((0.9, 2.5, 4.0, 9.0))

    def go_on() -> None:
        station.is_hanging = False

    def begin() -> None:
        station.is_hanging = True
        run.for_a_while("loop hangs", _until_next_part(run, rng, lasts_s), go_on, is_sensors=True)

    places = ("a turn", "a verdict", "a verdict", "a commit")
    station.hangs_in, station.on_hang = rng.choice(places), begin
    return lasts_s


def kill_start(run: "Simulation", rng: random.Random) -> float:
    """The service is restarted, and killed at a write of its start."""

    def kill_soon() -> None:
        run.station.disk.kill_in = rng.randint(1, 4)

    stop(run, rng, kill_soon)
    if run.station.disk.is_dead:
        run.reach("killed while it started")
    return 0.0


def stop_hanging(run: "Simulation", rng: random.Random) -> float:
    """SIGTERM comes while the loop hangs, which ends with its turn."""
    lasts_s, number = hang(run, rng), len(run.station.hung)

    def end() -> None:
        if (
            "loop hangs" in run.ending
            or run.station.hangs_in
            or run.world.connections.turns["loop"].is_waiting
        ):
            run.later(0.02, end)
        elif len(run.station.hung) > number:
            run.reach("restarted as soon as the loop did not hang any more")
            stop(run, rng)

    run.later(0.02, end)
    return lasts_s


# Outputs


def disturb_relay(run: "Simulation", rng: random.Random) -> float:
    """The relay board is unplugged, slow or stuck."""
    relay, hand = run.world.relay, run.world.hand

    def mend() -> None:
        if relay.mood == "unplugged" and hand.may_lift is not None and hand.press is not None:
            hand.press.why.add("a relay that is plugged in may say `lift` before the station has it")
        relay.mend()

    relay.mood = rng.choice((*["unplugged"] * 4, "slow", "stuck"))
    return run.for_a_while(f"relay {relay.mood}", rng.uniform(0.5, 5), mend)


def disturb_pedal(run: "Simulation", rng: random.Random) -> float:
    """The pedal is unplugged, held down, or trodden."""
    pedal = run.world.pedal
    pedal.mood = rng.choice(("unplugged", "stuck", "trodden", "trodden"))
    return run.for_a_while(f"pedal {pedal.mood}", rng.uniform(0.1, 5), pedal.mend)


def disturb_plc(run: "Simulation", rng: random.Random) -> float:
    """Its cable is pulled, now or at a step of the handshake; its watchdog stands still; it acknowledges late."""
    if not run.world.has_plc:
        return 60.0
    plc, lasts_s = run.world.plcs[0], rng.choice((0.1, 0.6, 2.0, 4.0, 12.0))

    def pull() -> None:
        plc.mood = "cut"
        run.for_a_while("plc cut", lasts_s, plc.mend)

    kind = rng.choice(("cut", "cut at", "mute", "slow", "slow", "slow"))
    if plc.mood != "up" or kind == "cut":
        pull()
    elif kind == "cut at":
        plc.cut_at, plc.on_cut = rng.choice(STEPS), pull
    else:
        plc.mood = kind
        if kind == "slow":
            lasts_s = max(lasts_s, 8.0)  # until a pass is shown, and after the station has halted
            _unplug_at_pass(run, rng)
        return run.for_a_while(f"plc {kind}", lasts_s, plc.mend)
    return lasts_s


def _unplug_at_pass(run: "Simulation", rng: random.Random) -> None:
    """The sensor is unplugged once the slow PLC has a pass that it does not acknowledge yet."""

    def act() -> float:
        is_out = run.ending.keys() & {"sensor unplugged", "another sensor"}
        if Server.now.is_pass and not is_out:
            unplug(run, rng)
        if Server.now.is_pass or run.world.plcs[0].mood != "slow":
            end()
        return 0.1

    end = run.join("sensor at a pass", act)


def join_plc(run: "Simulation", rng: random.Random) -> float:
    """Another PLC asks for the same for a while."""
    if not run.world.has_plc or len(run.world.plcs) > 20:
        return 60.0
    plcs = run.world.plcs
    number = 1_000_000 * len(plcs)
    plc = run.world.add_plc(random.Random(rng.random()), f"10.0.1.{len(plcs)}", number)
    end = run.join("second plc", plc.act)

    def leave() -> None:
        end()
        plc.leave()

    return run.for_a_while("second plc", rng.choice((1.0, 5.0, 15.0)), leave)


FAULTS: "dict[str, Callable[[Simulation, random.Random], float]]" = {
    "unplug": unplug,
    "silence": silence,
    "blind": blind,
    "damage": damage,
    "shake": shake,
    "hold back": hold_back,
    "hang up": hang_up,
    "fill disk": fill_disk,
    "slow disk": slow_disk,
    "bad disk": bad_disk,
    "lock database": lock_database,
    "exchange bundle": exchange_bundle,
    "second sensor": plug_second,
    "kill start": kill_start,
    "stop hanging": stop_hanging,
    "step clock": step_clock,
    "stop": stop,
    "lose database": lose_database,
    "kill": kill,
    "lose power": lose_power,
    "freeze": freeze,
    "hang": hang,
    "relay": disturb_relay,
    "pedal": disturb_pedal,
    "plc": disturb_plc,
    "second plc": join_plc,
    OVERVIEW: disturb_overview,
    **PEOPLE,
    **ASKED,
}


def _is_pressed_unjudged(run: "Simulation") -> bool:
    """A press was noticed, and has no verdict yet."""
    press = run.world.hand.press
    is_noticed = press is not None and run.world.clock.now_ns - press.begin_ns > run.world.noticed_s * S
    return is_noticed and _is_unjudged(run)


def _is_unjudged(run: "Simulation") -> bool:
    """A press has no verdict yet."""
    press, seen = run.world.hand.press, run.station.seen
    return press is not None and not (seen and seen[-1].noted_ns > press.begin_ns)


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
        return run.station.is_drop_open
    return _is_press_waiting(run) or _is_result_waiting(run)


def _is_press_unrecorded(run: "Simulation") -> bool:
    """A press has no row: it waits for room on the disk, or its verdict comes next."""
    is_full = run.station.disk.is_full or "fill disk" in run.meeting
    is_unsent = "hang up" not in run.meeting or _is_result_unsent(run)
    return _is_press_waiting(run) and is_unsent if is_full else _is_pressed_unjudged(run)


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
    "select part": lambda run: _is_pressed_unjudged(run) or _is_part_asked_for(run),
    "replace gel": lambda run: _is_pass_shown(run) or run.station.disk.is_full,
    "kill": _is_press_unrecorded,
    "lose power": _is_press_unrecorded,
    "stop": _is_loss_unread,
    "step clock": _is_result_waiting,
    "silence": lambda run: run.world.hand.is_pressing_soon,
    "blind": _is_pass_shown,
    "hold back": _is_pressed_unjudged,
    "fill disk": lambda run: "hang up" not in run.meeting or _is_result_unsent(run),
    "unplug": _is_pressed_judged,
    "lock database": _is_unjudged,
    "exchange bundle": _is_unjudged,
    "begin piece": _is_piece_asked_for,
}
"""When a fault does most harm: every other one waits for it."""

WAIT_FIRST = {"step clock", "silence", "blind", "hold back", "unplug", "begin piece"}
"""Faults whose first one waits; of others a draw says whether it does."""

NEEDS_ANSWER = {
    "kill start",
    "stop hanging",
    "stop",
    "second sensor",
    "exchange bundle",
    "lock database",
    "lose database",
    "freeze",
    "hang",
    *PEOPLE,
    *ASKED,
}
"""Faults that need an answer of the process."""
NEEDS_DISK = {"fill disk", "lose power", "slow disk", "bad disk", "lock database"}
"""Faults for which the writes of SQLite are listened to."""
