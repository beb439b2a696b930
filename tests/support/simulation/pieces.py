"""A person who presses pieces of two places after a plan, begins each with an id, and makes mistakes."""

import random
from typing import TYPE_CHECKING

from edge.core.errors import GelgateError
from simulation.bundles import PARTS

if TYPE_CHECKING:
    from simulation.schedule import Simulation

S = 10**9
WITHIN_S = 20
LEFT_EACH = 6
"""One of so many pieces is left after its first press for longer than it may take."""
PLAN = tuple(f"{part}/pos1" for part in PARTS)
PIECE = f"""
[piece]
order = "{{order}}"
within_s = {WITHIN_S}
""" + "".join(f'[[piece.places]]\npart = "{part}"\nposition = "pos1"\n' for part in PARTS)


class PieceWorker:
    """Takes one piece after the other. order: of the plan; in a free one the person selects the place."""

    def __init__(self, rng: random.Random, order: str) -> None:
        self._rng, self.order = rng, order
        self._number = self._first = self._wanted = 0
        self._chosen = -1
        self._left = 0
        """The piece that was left unfinished last."""

    def act(self, run: "Simulation") -> float:
        """Between two presses: take the next piece when this one has its presses; returns the seconds until the next
        look."""
        hand = run.world.hand
        made = len(hand.presses) - self._first
        if hand.press is not None or hand.is_done or not run.station.is_between_turns:
            return 0.1
        if made >= self._wanted:
            hand.wait(0.4)
            self._begin(run)
        elif made == 1 and self._number % LEFT_EACH == 3 and self._left != self._number:
            self._left = self._number
            hand.wait(WITHIN_S + 6)
            run.note(f"piece {self._number} is left for a while")
        elif self.order == "free" and self._chosen != made:
            hand.wait(0.4)
            self._choose(run, made)
        return 0.1

    def _begin(self, run: "Simulation") -> None:
        self._number += 1
        name, now_ns = f"piece {self._number}", run.world.clock.now_ns
        run.world.places.forget(now_ns)
        try:
            run.station.ask("begin_piece", piece_id=name)
        except ValueError:  # something presses still, or waits to be recorded
            return
        except GelgateError:  # the commit may have been made
            run.world.pieces.forget(now_ns)
            return
        run.world.pieces.select(now_ns, name)
        if run.station.disk.is_dead:
            run.world.pieces.forget(now_ns)
        run.note(f"{name} is begun")
        # Most people press both places; some forget one, or press once more.
        self._first, self._wanted = len(run.world.hand.presses), self._rng.choice((2, 2, 2, 2, 1, 3))
        self._chosen = -1

    def _choose(self, run: "Simulation", made: int) -> None:
        part = self._rng.choice(PARTS) if self._rng.random() < 0.15 else PARTS[made % 2]
        try:
            run.station.ask("select_part", part=part, position="pos1")
        except (ValueError, GelgateError):
            run.world.places.forget(run.world.clock.now_ns)
            return
        place, presses, seen = f"{part}/pos1", run.world.hand.presses, run.station.seen
        run.world.places.select(run.world.clock.now_ns, place)
        if presses and presses[-1].begin_ns > (seen[-1].noted_ns if seen else 0):
            run.world.places.forget(
                run.world.clock.now_ns
            )  # when that is recorded the plan may select the last one
        run.reach(f"a person selected the {'right' if part == PARTS[made % 2] else 'wrong'} place of a piece")
        self._chosen = made
