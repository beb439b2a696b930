"""The person who edits the configuration of a station that runs, and has it read again."""

import random
from dataclasses import dataclass
from typing import TYPE_CHECKING

from simulation.bundles import PARTS
from simulation.process_faults import stop

if TYPE_CHECKING:
    from simulation.schedule import Simulation

WRONG = {
    "misspells a key": ("threads = 1", "thread = 1"),
    "leaves a quote open": ("[commands]", '[commands"'),
    "gives a wrong value": ('trigger = "', 'trigger = "not '),
}
"""What makes it wrong: a text of it, and what is written instead. All of it is refused, and the old one goes on."""

KINDS = ("changes what a start reads", "moves a bundle", *WRONG)
CONFIGURATION = -1
"""Its place in `Shelf.wrong`."""


@dataclass
class Edited:
    """What a person has written into it: the truth about it."""

    stats_s: int = 10
    """Read at a start alone (docs/operations.md, What is not planned)."""
    wrong: str = ""
    """A key of WRONG."""
    edits: int = 0
    """Each kind has its turn."""
    asked: tuple[int, int] | None = None
    """The life in which it was last to be read again after such a change, and how many acts there were."""

    def write(self, text: str) -> str:
        """Return the file."""
        return text.replace(*WRONG.get(self.wrong, ("", ""))) + f"[station]\nstats_s = {self.stats_s}\n"


def edit_configuration(run: "Simulation", rng: random.Random) -> float:
    """A person edits it and reloads, or starts the service again; a mistake is found later, and mended."""
    shelf, station, edited = run.world.shelf, run.station, run.world.edited
    is_known = station.told and station.told[-1][1] in shelf.ids and shelf.is_asked
    if shelf.wrong or not is_known or any(name.startswith("bundle of") for name in run.ending):
        return -0.5
    kind, is_reload = KINDS[(run.run.seed + edited.edits) % len(KINDS)], rng.random() < 0.8
    edited.edits += 1
    run.note(f"a person {kind}{', and reloads' if is_reload else ''}")
    run.reach_here(f"a person {kind}")

    def mend() -> None:
        edited.wrong = ""
        shelf.wrong.pop(CONFIGURATION)
        reload()

    def reload() -> None:
        run.write_config()
        station.ask("reload")
        shelf.note_asked()

    if kind in WRONG:
        edited.asked = None
        edited.wrong, shelf.wrong[CONFIGURATION] = kind, f"in a configuration in which a person {kind}"
    elif kind == "moves a bundle":
        shelf.move(rng.randrange(len(PARTS)))
    else:
        edited.stats_s = 17 - edited.stats_s if edited.stats_s < 10 else 9
        edited.asked = (station.lives, station.count_openings()) if is_reload else edited.asked
    if kind in WRONG:
        run.for_a_while(f"configuration wrong, {kind}", 9.0, mend)
    if is_reload:
        reload()
    else:
        stop(run, rng)
    return 3.0
