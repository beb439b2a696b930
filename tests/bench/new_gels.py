"""How presses on a new gel are judged by a bundle of the old one, with its shading followed and without.

`python tests/bench/new_gels.py [PART...]` prints the table of docs/gel.md: development parts of `gelgate lab month`, by
default the first ten; of each, eight sound presses and four of damaged or wrong pieces on each of two new gels, and
the same presses on a fresh gel like that of the fit. Half a minute of one core a part.
"""

import argparse
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import Month, PlannedPress
from calibration.experiments.month.run import fit_first
from calibration.simulator.reproducible_math import reproducible_opencv
from edge.clock import SystemClock
from edge.core.imaging.decode import decode_view
from edge.core.imaging.frames import CameraFrame
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer

PRESSES, GELS, MOUNTED = 300, (1, 2), 150
"""Of a month; the numbers of the new gels, and of the press before which each is mounted."""

ON_FIT, ON_NEW, FOLLOWED = WAYS = ("that of the fit", "new", "new, its shading followed")

Words = tuple[tuple[str, ...], tuple[str, ...]]
"""Verdicts on presses of sound pieces, and on those of others."""


def judge(part: int, bundle: Bundle, way: str) -> Iterator[Words]:
    """Judge the same presses on each gel."""
    month = Month("development", part, PRESSES)
    sound = [press for day in (16, 17) for press in month.day(day) if press.truth == "sound"][:8]
    others = [press for day in range(30) for press in month.day(day) if press.truth != "sound"][:4]
    for gel in GELS if way != ON_FIT else (0,):
        mounted, inspector = MountedGel(month, gel, MOUNTED), Inspector(Scorer(bundle), SystemClock())
        free = decode_view(_frame(list(mounted.free(sound[0], 1.0))[-1]), bundle.profile)
        inspector.new_gel = free if way == FOLLOWED else None
        inspector.follow_light(free)
        verdict = partial(_judge_press, inspector, mounted)
        yield tuple(map(verdict, sound)), tuple(map(verdict, others))


def _judge_press(inspector: Inspector, mounted: MountedGel, press: PlannedPress) -> str:
    frames = list(mounted.press(press, 0))
    return inspector._examine(_frame(frames[len(frames) // 2]), None).word


def _frame(payload: bytes) -> CameraFrame:
    return CameraFrame(payload, 0, 0, is_on_demand=True)


def count(seen: list[Words], on_fit: Words) -> NDArray[np.int64]:
    """Of sound and of other pieces: presses, those that pass, and of them those that do not on the gel of the fit."""
    kinds = zip(*seen, strict=True)
    return np.array(
        [
            [
                sum(map(len, lists)),
                sum(words.count("pass") for words in lists),
                sum(
                    pair[0] == "pass" != pair[1]
                    for words in lists
                    for pair in zip(words, before, strict=True)
                ),
            ]
            for lists, before in zip(kinds, on_fit, strict=True)
        ]
    )


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    given.add_argument("parts", nargs="*", type=int, default=range(10))
    rows, sums = [], {way: np.zeros((2, 3), np.int64) for way in WAYS}
    for part in given.parse_args().parts:
        with tempfile.TemporaryDirectory() as folder, reproducible_opencv():
            bundle = Bundle.load(fit_first(MountedGel(Month("development", part, PRESSES)), Path(folder)))
            (on_fit,) = judge(part, bundle, ON_FIT)
            for way in WAYS:
                counted = count(list(judge(part, bundle, way)), on_fit)
                sums[way] += counted
                rows.append(_cells(str(part), way, counted))
                print(*rows[-1], sep=", ", flush=True)
    rows += [_cells("all", way, counted) for way, counted in sums.items()]
    print(
        markdown_table(["part", "gel", "sound pass", "damaged pass", "that fail on the gel of the fit"], rows)
    )


def _cells(part: str, way: str, counted: NDArray[np.int64]) -> list[str]:
    passed = [f"{passing} of {presses}" for presses, passing, _ in counted]
    return [part, way, *passed, str(counted[1, 2])]


if __name__ == "__main__":
    main()
