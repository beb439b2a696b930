"""The faults that a schedule draws: each begins one, and returns how long it lasts, in seconds."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from edge.core.errors import GelgateError
from simulation.surroundings import PARTS, S

if TYPE_CHECKING:
    from pathlib import Path

    from simulation.power import Unsynced
    from simulation.schedule import Simulation


def unplug(run: "Simulation") -> float:
    """The sensor's cable is pulled, and comes back."""
    sensor = run.world.sensor
    sensor.is_plugged = False

    def plug() -> None:
        sensor.is_plugged = True

    return run.for_a_while("sensor unplugged", run.rng.choice((0.2, 2, 12)), plug, is_sensors=True)


def silence(run: "Simulation") -> float:
    """The sensor gives no frame, and stays on the bus."""
    sensor = run.world.sensor
    sensor.is_silent = True

    def speak() -> None:
        sensor.is_silent = False

    return run.for_a_while("sensor silent", run.rng.choice((0.3, 1.5, 6)), speak, is_sensors=True)


def corrupt(run: "Simulation") -> float:
    """Some frames end in the middle."""
    sensor = run.world.sensor
    sensor.corrupt_share = run.rng.choice((0.02, 0.3, 1.0))

    def mend() -> None:
        sensor.corrupt_share = 0.0

    return run.for_a_while("corrupt frames", run.rng.uniform(0.5, 6), mend, is_sensors=True)


def hang_up(run: "Simulation") -> float:
    """A broker is away, forgets its answers, refuses one kind of message, or restarts without what it retained."""
    broker = run.rng.choice(list(run.world.brokers.values()))
    broker.mood = run.rng.choice(("away", "away", "forgets answers", "refuses", "restarts without memory"))
    broker.refuses = run.rng.choice(("result", "heatmap", "gel"))
    run.reach(f"a broker {broker.mood}")
    if broker.mood == "restarts without memory":
        broker.mood = "away"
        broker.lose_all()
        broker.retained.clear()
    elif broker.mood == "away":
        broker.lose_all()

    def come_back() -> None:
        broker.mood = "up"

    return run.for_a_while(f"{broker.name} {broker.mood}", run.rng.uniform(1, 30), come_back)


def fill_disk(run: "Simulation") -> float:
    """No room on the disk, then room again."""
    disk = run.station.disk
    disk.fill(True)
    run.world.parts.forget(run.world.clock.now_ns)
    return run.for_a_while("disk full", run.rng.uniform(1, 20), lambda: disk.fill(False))


def step_clock(run: "Simulation") -> float:
    """Somebody, or a time server, sets the wall clock."""
    step_s = run.rng.choice((-86_400, -3600, -1, 1, 3600, 31 * 86_400, 31 * 86_400))
    run.world.clock.wall_ns += step_s * S
    run.note(f"the wall clock is set by {step_s} s")
    run.reach("the wall clock went back" if step_s < 0 else "the wall clock went on")
    if run.is_broker_away:
        run.reach("the wall clock was set while a broker was away")
    return 0.0


def replace_gel(run: "Simulation") -> float:
    """A person changes the gel, says so, and goes on when the new one was seen free for a while."""
    sensor = run.world.sensor
    if sensor.press is not None:
        return 0.1
    sensor.wait(4)
    try:
        run.world.gels.select(run.world.clock.now_ns, run.station.ask("replace_gel")["gel_id"])
        run.reach(
            "the gel was replaced while a broker was away" if run.is_broker_away else "the gel was replaced"
        )
        run.note("the gel is replaced")
    except GelgateError as error:
        run.reach("the gel could not be replaced")
        run.note(f"the gel is not replaced: {error}")
    return 0.0


def stop(run: "Simulation") -> float:
    """The service is restarted."""
    run.note("stopped in order")
    run.world.sensor.disturb("the gateway was restarted")
    run.reach_here("restarted")
    run.station.stop()
    run.open_again()
    return 0.0


def kill(run: "Simulation") -> float:
    """The process is killed at one of its next writes."""
    run.station.disk.kill_in = run.rng.randint(1, 60)
    return 0.0


def lose_power(run: "Simulation") -> float:
    """The power is lost at one of the next writes: what was not synced is lost in part."""

    def lose(unsynced: "Unsynced", copy: "Path") -> None:
        if unsynced.lose(copy, run.rng):
            run.reach("writes were lost with the power")

    run.station.disk.kill_in, run.station.disk.lost = run.rng.randint(1, 60), lose
    return 0.0


def select_part(run: "Simulation") -> float:
    """A command selects the other part, at any moment."""
    parts = run.world.parts
    part = PARTS[1 - PARTS.index(parts.wanted)]
    try:
        answer = run.station.ask("select_part", part=part, position="pos1")
    except GelgateError as error:
        run.note(f"part {part} is not selected: {error}")
        return 0.0
    parts.select(run.world.clock.now_ns, part)
    is_waiting = answer["is_waiting"]
    run.reach("a part change came during a press, and waited" if is_waiting else "the part was changed")
    run.note(f"part {part} is selected{', and waits' if is_waiting else ''}")
    return 0.0


def reload(run: "Simulation") -> float:
    """A command opens the bundles again."""
    run.station.ask("reload")
    run.reach_here("the bundles were opened again")
    run.note("the bundles are opened again")
    return 0.0


def disturb_relay(run: "Simulation") -> float:
    """The relay board is unplugged, slow or stuck."""
    relay = run.world.relay
    relay.mood = run.rng.choice(("unplugged", "slow", "stuck"))
    return run.for_a_while(f"relay {relay.mood}", run.rng.uniform(0.5, 8), relay.mend)


def disturb_pedal(run: "Simulation") -> float:
    """The pedal is unplugged, held down, or trodden."""
    pedal = run.world.pedal
    pedal.mood = run.rng.choice(("unplugged", "stuck", "trodden", "trodden"))
    return run.for_a_while(f"pedal {pedal.mood}", run.rng.uniform(0.1, 2), pedal.mend)


def freeze(run: "Simulation") -> float:
    """The process gets no time for a while, as in a machine that is suspended or short of memory."""
    lasts_s = run.rng.choice((0.3, 0.9, 1.3, 3.0))
    run.freeze(lasts_s)
    return run.for_a_while("process frozen", lasts_s, lambda: run.freeze(0), is_sensors=True)


FAULTS: "dict[str, Callable[[Simulation], float]]" = {
    "unplug": unplug,
    "silence": silence,
    "corrupt": corrupt,
    "hang up": hang_up,
    "fill disk": fill_disk,
    "step clock": step_clock,
    "replace gel": replace_gel,
    "stop": stop,
    "kill": kill,
    "lose power": lose_power,
    "select part": select_part,
    "reload": reload,
    "relay": disturb_relay,
    "pedal": disturb_pedal,
    "freeze": freeze,
}

ASKING = (replace_gel, select_part, reload, stop, freeze)
"""Faults that need an answer of the process."""
