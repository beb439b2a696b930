"""What people ask of features: to take their word on a press, to write a snapshot, to let a shadow take over, to learn
the free gel again."""

import random
from collections.abc import Callable
from typing import TYPE_CHECKING

from edge.core.errors import GelgateError
from edge.features.snapshots import Snapshots
from simulation.alarms_of_features import NEWEST_WORD
from simulation.chosen import REFERENCE, SNAPSHOT
from simulation.lives import Asked
from simulation.options import SECRET
from simulation.sensor import BEING_LEARNT

MASTER = "the master piece"
WITHIN_S = 20
FAVOURED = 5
"""So many good presses that it alone passes let a shadow take over early (docs/operations.md)."""
TABLE = f"""
[reference]
enforce = "warn"
learn = 5
within_s = {WITHIN_S}
[[reference.pieces]]
name = "{MASTER}"
"""

if TYPE_CHECKING:
    from simulation.schedule import Simulation


def say_of_press(run: "Simulation", rng: random.Random) -> float:
    """A person says what one of the newest presses was; or takes a sound one for damaged, and corrects it later."""
    known = [
        (seen.press_id, press.what)
        for seen in run.station.seen[-4:]
        for press in run.world.hand.presses[-6:]
        if not (press.why or press.master_ns)
        and seen.frame_ns
        and press.begin_ns <= seen.frame_ns <= press.end_ns
    ]
    if not known:
        return -0.5
    press_id, what = rng.choice(known)
    word = "good" if what == "sound" or run.chosen.is_lenient else "damaged"
    is_slip = what == "sound" and rng.random() < 0.3
    given = {"press_id": press_id, "verdict": "damaged" if is_slip else word}
    transaction = run.station.send_request("confirm_press", given, SECRET)
    run.reach("a person took a sound part for damaged" if is_slip else f"a person called a part {word}")
    run.note(f"a person says of press {press_id}: {'damaged, and is wrong' if is_slip else word}")
    if is_slip:
        right = {**given, "verdict": "good"}
        run.later(rng.choice((4, 12)), lambda: run.station.send_request("confirm_press", right, SECRET))
    elif rng.random() < 0.2:  # and another word, as if it were the same request: it is refused
        other = {**given, "verdict": "cannot_tell"}
        run.later(0.5, lambda: run.station.send_request("confirm_press", other, SECRET, transaction))
        run.reach("two requests had one transaction")
    return 0.0


def ask_for_snapshot(run: "Simulation", rng: random.Random) -> float:
    """A person asks for the frames around now."""
    if run.station.loop.find(Snapshots) is None:
        return 60.0
    before_s, after_s = rng.choice((0.0, 1.0, 5.0)), rng.choice((0.0, 0.5, 2.0))
    try:
        answer = run.station.ask(SNAPSHOT, before_s=before_s, after_s=after_s)
    except ValueError as error:  # another one is made, or no frame has come
        run.note(f"no snapshot: {error}")
        return -1.0
    now_ns = run.world.clock.now_ns
    run.station.snapshots.append(Asked(answer["recording"], now_ns, before_s + after_s, run.station.lives))
    run.reach("a snapshot was asked for")
    run.note("a snapshot is asked for")
    return 0.0


def adopt_shadow(run: "Simulation", rng: random.Random) -> float:
    """A person wants the shadow, which passes everything, in the place of the bundle; or the bundle back."""
    shelf, hand = run.world.shelf, run.world.hand
    if shelf.heir and (hand.press is not None or hand.free_s < 0.3):  # a stop would forget what waits
        return -0.1
    verb = rng.choice(("adopt_shadow", "adopt_shadow", "restore_bundle"))
    try:
        answer = run.station.ask(verb)
        taken = answer() if callable(answer) else answer
    except (ValueError, GelgateError) as error:
        run.note(f"{verb} is refused: {error}")
        run.reach("a shadow was refused")
        return 0.0
    query = f"SELECT count(*) FROM presses WHERE verdict = 'fail' AND ({NEWEST_WORD}) = 'good'"
    good = run.station.disk.read(query)[0][0]
    if not shelf.heir:
        run.station.found.append(f"a shadow that passes everything may take over: {taken}")
    elif good < FAVOURED or taken["bundle_id"] != shelf.heir:
        run.station.found.append(f"a shadow may take over, and of {good} good presses that fail: {taken}")
    else:
        shelf.let_take_over()
        run.reach(f"a person asked to {verb}, and it was done")
        run.note(f"{verb}: {taken}")
    return 0.0


def relearn(run: "Simulation", rng: random.Random) -> float:
    """A person has the free gel learnt again; some forget that something lies on it."""
    hand, loop = run.world.hand, run.station.loop
    if loop.session is None or run.world.sensor.is_behind or (hand.press is not None and rng.random() < 0.7):
        return -0.1
    is_pressed = hand.press is not None
    try:
        run.station.ask("relearn")
    except GelgateError as error:  # the store refuses
        run.note(f"the gel is not learnt again: {error}")
        return -0.5
    run.world.new_gel_ns = run.world.clock.now_ns
    run.world.sensor.disturb(BEING_LEARNT)
    hand.wait(3)
    run.reach(f"the free gel was learnt again{' while something pressed' if is_pressed else ''}")
    run.note("the gel is learnt again")
    return 0.0


def press_master(run: "Simulation", rng: random.Random) -> float:
    """A person asks for a press of the master piece, and presses it next."""
    hand = run.world.hand
    if REFERENCE not in run.chosen.features:
        return 60.0
    if hand.press is not None or hand.is_done or run.world.sensor.is_behind:
        return -0.1
    if hand.free_s < 0.4:
        hand.wait(0.4)
    try:
        run.station.ask(REFERENCE, piece=MASTER, restart=rng.random() < 0.1)
    except (ValueError, GelgateError):  # something presses still, or the free gel is not known yet
        return -0.1
    hand.master_ns = run.world.clock.now_ns
    run.reach("a master piece was asked for")
    run.note("the master piece is next")
    return 0.0


ASKED: "dict[str, Callable[[Simulation, random.Random], float]]" = {
    "say": say_of_press,
    SNAPSHOT: ask_for_snapshot,
    "adopt": adopt_shadow,
    "relearn": relearn,
    REFERENCE: press_master,
}
