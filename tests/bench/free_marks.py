"""How surely a mark on the free gel beside the part is said, on simulated films: `python tests/bench/free_marks.py`.

Every part is pressed 40 times over a month of wear and of light that fades, with nothing on the gel, at three ways to
lift; what is said then is a false alarm. Then a hair or a grain settles where the part does not reach, as
the fourth of eleven presses begins, and is wiped off before the tenth: said at the ninth, the fifth before which it was
seen, and no more at the tenth, is right. A part takes a minute of one core.
"""

import argparse
from collections import Counter
from collections.abc import Iterable
from typing import Final

import numpy as np

from calibration.experiments.month import gel as month_gel
from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import Month, PlannedPress
from calibration.simulator.field_of_view import LR
from calibration.simulator.scars import Scar, grain, random_scar
from edge.core.arrays import Mask
from edge.core.contact.events import PressBegan, PressSettled, ReferenceReady
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.reference import View
from edge.core.contact.relief import reach_beside_marks
from edge.core.gel_scars.free_change import FreeViews
from edge.core.gel_scars.gel_scars import GelScars
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

LIFTS: Final = ((0.3, 0.1), (0.3, 1 / 18.75), (1.0, 0.1))
"""Seconds that the gel is free, and between two frames."""
SETTLES, WIPED, PRESSES, QUIET = 3, 9, 11, 40


class Film:
    """A gel that is pressed, and the marks beside the part that a station would say."""

    def __init__(self, gel: MountedGel, frame_s: float) -> None:
        self.gel, self.said = gel, list[Mask]()
        self.reached: Mask = np.zeros(VIEW_SIZE[::-1], bool)
        month_gel.FRAME_S = self._frame_s = frame_s  # type: ignore[misc]
        self._detector, self._free, self._scars = (
            PressDetector(profile("cropped_lr")),
            FreeViews(),
            GelScars(),
        )
        self._left: View | None = None
        self._number = 0

    def show(self, frames: Iterable[bytes]) -> None:
        """Look at frames as a station does."""
        for payload in frames:
            self._number += 1
            time_ns = round(self._number * self._frame_s * 1e9)
            look = self._detector.feed(CameraFrame(payload, time_ns, self._number))
            for event in look.events:
                reference = self._detector.tracker.reference
                if isinstance(event, ReferenceReady) and reference is not None and self._scars.first is None:
                    self._scars.first = reference.view.copy()
                if isinstance(event, PressBegan):
                    self._scars.see_free(self._free.mean(), self._left)
                if isinstance(event, PressSettled) and event.findings is not None:
                    self._judge(event)
            if look.level is not None:
                self._free.see(look.state, look.level, time_ns, is_faint=look.phase == "touching")

    def press(self, press: PlannedPress, lift_s: float) -> None:
        """Press a piece and lift."""
        self.show(self.gel.press(press))
        self.show(self.gel.free(press, lift_s))

    def _judge(self, event: PressSettled) -> None:
        found = event.findings
        assert found is not None
        free = self._free.mean()
        before = found.free if free is None else free
        here = reach_beside_marks(found.mask, found.relief, found.level, before, self._scars.near_marks)
        self.reached, self._left = self.reached | here, found.imprint
        self.said.append(self._scars.lasting_specks & ~here)


def find_inspected() -> Mask:
    """Find the pixels of the view that are inspected."""
    inside = np.zeros(VIEW_SIZE[::-1], bool)
    region, (width, height) = Region.centre(LR.size), LR.size
    (left, top), (across, down) = (region.x, region.y), (VIEW_SIZE[0] / width, VIEW_SIZE[1] / height)
    rows = slice(round(top * down), round((top + region.height) * down))
    inside[rows, round(left * across) : round((left + region.width) * across)] = True
    return inside


def play(
    month: Month, presses: list[PlannedPress], lift: tuple[float, float], mark: Scar | None = None
) -> Film:
    """Play a film; with a mark it settles and is wiped off."""
    film = Film(MountedGel(month, month.part % 3), lift[1])
    film.show(film.gel.free(presses[0], 2.5))
    for number, press in enumerate(presses):
        if mark is not None and number in (SETTLES, WIPED):
            film.gel.specks = [mark] if number == SETTLES else []
        if mark is not None and number == WIPED:
            film.show(film.gel.free(press, 3.5))
        film.press(press, lift[0])
    return film


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    words.add_argument("parts", nargs="?", type=int, default=4)
    words.add_argument("--marks", type=int, default=4, help="of each kind on each part")
    given, inside, counts = words.parse_args(), find_inspected(), Counter[str]()
    for part in range(given.parts):
        month, rng = Month("development", part, 3000), np.random.default_rng(part)
        month.__dict__["_lasting"] = []  # no scars
        plan = [press for day in range(month.days) for press in month.day(day)]
        for lift in LIFTS:
            film = play(month, plan[:: len(plan) // QUIET][:QUIET], lift)
            counts["quiet presses"] += len(film.said)
            counts["quiet presses with an alarm"] += sum(bool((said & inside).any()) for said in film.said)
        rows, columns = np.nonzero(inside & ~film.reached)
        for kind in ("hair", "grain"):
            for number in range(given.marks):
                k = int(rng.integers(len(rows)))
                across, down = (LR.extent_mm[axis] / VIEW_SIZE[axis] for axis in (0, 1))
                x, y = (columns[k] - 79.5) * across, (rows[k] - 59.5) * down
                at_mm = float(x), float(y)
                mark = grain(at_mm, 0.1, 0.05, 0) if kind == "grain" else random_scar("hair", at_mm, 0, rng)
                film = play(month, plan[:PRESSES], LIFTS[number % len(LIFTS)], mark)
                told = [bool((said & inside).any()) for said in film.said]
                counts[f"{kind}s"] += 1
                is_fifth = told[: SETTLES + 6] == [False] * (SETTLES + 5) + [True]
                counts[f"{kind}s said with the fifth press"] += is_fifth
                counts[f"{kind}s said after they were wiped off"] += any(told[WIPED:])
        print(dict(counts), flush=True)


if __name__ == "__main__":
    main()
