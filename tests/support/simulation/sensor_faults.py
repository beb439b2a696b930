"""Faults of the sensor (`faults.py`)."""

import random
from functools import partial
from typing import TYPE_CHECKING

from simulation.sensor import BEING_LEARNT, OTHER_SERIAL, SERIAL, S

if TYPE_CHECKING:
    from simulation.schedule import Simulation

LONG_S = 3
"""Nobody holds a part for so long until it is seen again."""
MARKED, NEVER_S = "the gel is damaged", 1e6
TAKEN_FOR_A_PRESS = "was taken for a press"


def let_lie(run: "Simulation", rng: random.Random, lasts_s: float) -> None:
    """Mostly let a part that is pressed now lie until it has been seen again for a while."""
    hand = run.world.hand
    if lasts_s < LONG_S and hand.press is not None and hand.is_down and rng.random() < 0.7:
        hand.hold(lasts_s + 1)
        run.reach("a part lay there before and after a time without sight")


def until_next_part(run: "Simulation", rng: random.Random, lasts_s: float) -> float:
    """Return how long a fault lasts: in some runs mostly, where a part lies there, until the next one is about to be
    pressed, so that the free gel between them is seen once, or not at all."""
    hand = run.world.hand
    if not run.chosen.until_next:
        return lasts_s
    ends_s = hand.free_s - rng.choice((0, 1, 2)) / run.chosen.fps
    return ends_s if hand.press is not None and ends_s > 0.3 and rng.random() < 0.6 else lasts_s


def unplug(run: "Simulation", rng: random.Random) -> float:
    """The sensor's cable is pulled, and comes back; or another sensor is plugged in for a while."""
    sensor = run.world.sensor
    # A station that has not seen its own sensor yet takes any.
    is_own_seen = run.station.loop.session is not None
    is_other = rng.random() < 0.4 and is_own_seen
    # It takes the only one that is plugged in, and then waits for that, where it names none.
    if not (is_own_seen or run.chosen.has_serial) and "second sensor" in run.ending:
        run.ending.pop("second sensor")()
    sensor.is_plugged, sensor.serial = is_other, OTHER_SERIAL if is_other else SERIAL
    sensor.forget()

    def plug() -> None:
        sensor.is_plugged, sensor.serial = True, SERIAL
        sensor.forget()

    name = "another sensor" if is_other else "sensor unplugged"
    # Another one that is gone at once was not opened.
    lasts_s = rng.choice((12, 2, 12) if is_other else (0.2, 2, 12))
    let_lie(run, rng, lasts_s)
    return run.for_a_while(name, lasts_s, plug, is_sensors=True)


def silence(run: "Simulation", rng: random.Random) -> float:
    """The sensor gives no frame, and stays on the bus; or a part is put down meanwhile, and lies until it is seen."""
    sensor, hand, begun_ns = run.world.sensor, run.world.hand, run.world.clock.now_ns
    lasts_s, is_held = until_next_part(run, rng, rng.choice((0.3, 1.5, 6, 9))), rng.random() < 0.7
    if is_held and hand.is_pressing_soon:
        lasts_s, hand.dents = hand.free_s + 0.4, max(1, hand.dents)
    let_lie(run, rng, lasts_s)
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


def mark_gel(run: "Simulation", rng: random.Random) -> float:
    """What lies between two parts damages the gel, which the station knows; some presses later a person wipes it, and
    has it learnt again, or it goes by itself."""
    hand, clock = run.world.hand, run.world.clock
    if hand.press is not None or hand.is_marked or not run.station.seen:
        return -0.1
    lasts_s, goes_by_itself = rng.choice((15, 25)), rng.random() < 0.5
    until_ns = clock.now_ns + lasts_s * S

    def set_marked(*, is_marked: bool) -> None:
        hand.is_marked = is_marked
        hand.marked_ns.append(clock.now_ns)
        hand.wait(1 if is_marked else 3)
        if is_marked:
            return
        if goes_by_itself:
            run.reach("marks on a gel went by themselves")
            _hear_of_contact(run)
        elif run.station.loop.session is not None:
            run.station.ask("relearn")
            run.world.new_gel_ns = clock.now_ns
            run.world.sensor.disturb(BEING_LEARNT)

    def wipe() -> float:
        if clock.now_ns >= until_ns and hand.press is None and MARKED in run.ending:
            run.ending.pop(MARKED)()
        if MARKED not in run.ending:
            leave()
        return 0.1

    set_marked(is_marked=True)
    run.for_a_while(MARKED, NEVER_S, partial(set_marked, is_marked=False), is_sensors=True)
    leave = run.join("wipe", wipe)
    return lasts_s


def _hear_of_contact(run: "Simulation") -> None:
    """Hear what the station says of the next parts: what has gone may have counted as a press, and a part over it is
    then one press with it (docs/contact.md)."""
    hand, parts = run.world.hand, len(run.world.hand.presses)

    def look() -> float:
        raised = run.station.loop.parts.status._raised.get("contact")
        if raised is not None and TAKEN_FOR_A_PRESS in raised[0] and hand.press is not None:
            hand.press.why.add("the alarm contact says that it is not judged")
            run.reach("a part over what was taken for a press was said")
        if len(hand.presses) > parts + 2:
            leave()
        return 0.05

    leave = run.join("contact", look)


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
