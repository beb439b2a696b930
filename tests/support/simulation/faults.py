"""The faults that a schedule draws: each begins one, and returns how long it lasts, in seconds; less than 0 where it
could not begin, and when it is to be tried again."""

import random
from collections.abc import Callable
from typing import TYPE_CHECKING

from simulation.asked import ASKED
from simulation.chosen import MARK_GEL, MOODS, OTHERWISE, OVERVIEW, is_small
from simulation.configuration import edit_configuration
from simulation.disk_faults import bad_disk, fill_disk, lock_database, slow_disk
from simulation.overview_camera import disturb_overview
from simulation.people import PEOPLE, request
from simulation.plc import STEPS, Server
from simulation.process_faults import (
    freeze,
    hang,
    kill,
    kill_start,
    lose_database,
    lose_power,
    stop,
    stop_hanging,
)
from simulation.sensor import S
from simulation.sensor_faults import blind, damage, hold_back, mark_gel, shake, silence, unplug
from simulation.shelf import break_shadow, exchange_bundle, score_otherwise

if TYPE_CHECKING:
    from simulation.schedule import Simulation

# A second sensor


def plug_second(run: "Simulation", rng: random.Random) -> float:
    """A second sensor is plugged in for a while; sometimes the first is unplugged meanwhile, or the service starts
    again. A station that names its own by serial sees nothing of that (docs/operations.md, Two sensors)."""
    sensor, is_named = run.world.sensor, run.chosen.has_serial
    if sensor.has_second or run.station.loop.session is None:
        return -1.0
    sensor.has_second, lasts_s = True, rng.choice((2.0, 6.0, 15.0))
    what = rng.choice(("stays", "stays", "first is unplugged", "restart"))

    def unplug() -> None:
        sensor.has_second = False

    def plug() -> None:
        sensor.is_plugged = True
        sensor.forget()

    run.for_a_while("second sensor", lasts_s, unplug, is_sensors=not is_named)
    run.reach(f"a second sensor was beside {'one that is named' if is_named else 'any'}, {what}")
    if what == "first is unplugged" and sensor.is_plugged and "sensor unplugged" not in run.ending:
        sensor.is_plugged = False
        sensor.forget()
        run.for_a_while("sensor unplugged", lasts_s / 2, plug, is_sensors=True)
    elif what == "restart" and sensor.is_plugged:
        stop(run, rng)
    return lasts_s


# Brokers


def hang_up(run: "Simulation", rng: random.Random) -> float:
    """A broker is away, or has another of its moods."""
    broker = rng.choice(list(run.world.brokers.values()))
    is_mostly_away = is_small(run.chosen.outbox_mb) or run.is_full_and_away
    mood = rng.choice(MOODS) if rng.random() < (0.25 if is_mostly_away else 0.75) else "away"
    mood = rng.choice(run.chosen.moods) if run.chosen.moods else mood
    kinds = (
        ("result", "heatmap", "gel") if run.chosen.moods else ("result", "heatmap", "gel", "alarm", "info")
    )
    broker.chosen_kind = rng.choice(kinds)
    run.reach(f"a broker {mood}")
    if mood == "restarts with an old memory":
        broker.crash()
    broker.go("away" if mood.startswith("restarts") else mood)
    if mood == "restarts without memory":
        broker.retained.clear()
    times_s = (8, 8, 20, 20) if run.is_full_and_away else (1, 4, 8, 20)
    if run.chosen.moods:  # and nothing else
        times_s = (3, 3, 4, 5) if is_small(run.chosen.outbox_mb) else (1, 2, 4, 8)
    lasts_s = rng.choice(times_s) * (4 if is_small(run.chosen.outbox_mb) else 1)
    lasts_s = max(lasts_s, 20) if mood in ("lets one in", "refuses") else lasts_s  # until the station says so
    if rng.random() < 0.5:  # people do not know that it is away
        run.later(lasts_s / 2, lambda: request(run, rng))
    return run.for_a_while(f"{broker.name} {broker.mood}", lasts_s, broker.mend)


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
    MARK_GEL: mark_gel,
    "hang up": hang_up,
    "fill disk": fill_disk,
    "slow disk": slow_disk,
    "bad disk": bad_disk,
    "lock database": lock_database,
    "exchange bundle": exchange_bundle,
    "break shadow": break_shadow,
    OTHERWISE: score_otherwise,
    "edit configuration": edit_configuration,
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


NEEDS_ANSWER = {
    "kill start",
    "stop hanging",
    "stop",
    "second sensor",
    "exchange bundle",
    "break shadow",
    OTHERWISE,
    "edit configuration",
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
