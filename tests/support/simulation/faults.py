"""The faults that a schedule draws: each begins one, and returns how long it lasts, in seconds."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from edge.core.errors import GelgateError
from simulation.surroundings import S

if TYPE_CHECKING:
    from simulation.schedule import Simulation


def unplug(run: "Simulation") -> float:
    """The sensor's cable is pulled, and comes back."""
    sensor = run.world.sensor
    sensor.is_plugged = False
    run.reach("the sensor was unplugged during a press" if sensor.press else "the sensor was unplugged")

    def plug() -> None:
        sensor.is_plugged = True

    return run.for_a_while("unplugged", run.rng.choice((0.2, 2, 12)), plug, is_sensors=True)


def silence(run: "Simulation") -> float:
    """The sensor gives no frame, and stays on the bus."""
    sensor = run.world.sensor
    sensor.is_silent = True

    def speak() -> None:
        sensor.is_silent = False

    return run.for_a_while("silent", run.rng.choice((0.3, 1.5, 6)), speak, is_sensors=True)


def corrupt(run: "Simulation") -> float:
    """Some frames end in the middle."""
    sensor = run.world.sensor
    sensor.corrupt_share = run.rng.choice((0.02, 0.3, 1.0))

    def mend() -> None:
        sensor.corrupt_share = 0.0

    return run.for_a_while("corrupt frames", run.rng.uniform(0.5, 6), mend, is_sensors=True)


def hang_up(run: "Simulation") -> float:
    """A broker is away, forgets its answers, or refuses one kind of message."""
    broker = run.rng.choice(list(run.world.brokers.values()))
    broker.mood = run.rng.choice(("away", "forgets answers", "refuses"))
    broker.refuses = run.rng.choice(("result", "heatmap", "gel"))
    if broker.mood == "away":
        broker.lose_all()
    run.reach(f"a broker {'is away' if broker.mood == 'away' else broker.mood}")

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
    step_s = run.rng.choice((-86_400, -3600, -1, 1, 3600, 30 * 86_400))
    run.world.clock.wall_ns += step_s * S
    run.note(f"the wall clock is set by {step_s} s")
    run.reach("the wall clock went back" if step_s < 0 else "the wall clock went on")
    return 0.0


def replace_gel(run: "Simulation") -> float:
    """A person changes the gel, says so, and goes on when the new one was seen free for a while."""
    sensor = run.world.sensor
    if sensor.press is not None:
        return 0.1
    sensor.wait(4)
    try:
        run.station.ask("replace_gel")
        run.reach("the gel was replaced")
        run.note("the gel is replaced")
    except GelgateError as error:
        run.note(f"the gel is not replaced: {error}")
    return 0.0


def stop(run: "Simulation") -> float:
    """The service is restarted."""
    run.note("stopped in order")
    run.world.sensor.disturb("the gateway was restarted")
    run.reach(
        "the gateway was restarted during a press" if run.world.sensor.press else "the gateway was restarted"
    )
    run.station.stop()
    run.open_again()
    return 0.0


def kill(run: "Simulation") -> float:
    """The process is killed at one of its next writes."""
    run.station.disk.kill_in = run.rng.randint(1, 60)
    return 0.0


def select_part(run: "Simulation") -> float:
    """A command selects the other part, at any moment."""
    parts = run.world.parts
    part = parts.names[1 - parts.names.index(parts.wanted)]
    try:
        answer = run.station.ask("select_part", part=part, position="pos1")
    except GelgateError as error:
        run.note(f"part {part} is not selected: {error}")
        return 0.0
    parts.select(run.world.clock.now_ns, part)
    run.reach(
        "a part change waited for the end of a press" if answer["is_waiting"] else "the part was changed"
    )
    run.note(f"part {part} is selected{', and waits' if answer['is_waiting'] else ''}")
    return 0.0


def reload(run: "Simulation") -> float:
    """A command opens the bundles again."""
    run.station.ask("reload")
    run.reach("a reload during a press" if run.world.sensor.press else "a reload")
    run.note("the bundles are opened again")
    return 0.0


def disturb_relay(run: "Simulation") -> float:
    """The relay board is unplugged, slow or stuck."""
    relay = run.world.relay
    relay.mood = run.rng.choice(("unplugged", "slow", "stuck"))
    run.reach(f"the relay was {relay.mood}")
    return run.for_a_while(f"relay {relay.mood}", run.rng.uniform(0.5, 8), relay.mend)


def disturb_pedal(run: "Simulation") -> float:
    """The pedal is unplugged, held down, or trodden."""
    pedal = run.world.pedal
    pedal.mood = run.rng.choice(("unplugged", "stuck", "trodden", "trodden"))
    run.reach(f"the pedal was {pedal.mood}")
    return run.for_a_while(f"pedal {pedal.mood}", run.rng.uniform(0.1, 2), pedal.mend)


def freeze(run: "Simulation") -> float:
    """The process gets no time for a while, as in a machine that is suspended or short of memory."""
    lasts_s = run.rng.choice((0.3, 0.9, 1.3, 3.0))
    run.freeze(lasts_s)
    run.reach("the process was frozen during a press" if run.world.sensor.press else "the process was frozen")
    return run.for_a_while("frozen", lasts_s, lambda: None, is_sensors=True)


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
    "select part": select_part,
    "reload": reload,
    "relay": disturb_relay,
    "pedal": disturb_pedal,
    "freeze": freeze,
}
