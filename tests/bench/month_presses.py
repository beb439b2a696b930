"""Single presses of a month's first days, scored by fits with and without smoothing: what the camera's noise costs.

    python tests/bench/month_presses.py PART [PART ...]    development parts of `gelgate lab month`

A gel without dust and scars, lamps as at the fit, a fifth of the pieces damaged; one frame of each press.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.month import plan
from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import Month, PlannedPress
from calibration.experiments.month.run import fit_first
from calibration.fitting.presses import preparation
from edge.core.arrays import U8
from edge.core.errors import PoseNotFound
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer

_DAMAGED_SHARE, _DAYS, _SOUND_EVERY = 0.2, 9, 3


def measure(part: int, folder: Path) -> list[list[str]]:
    """Measure a part: a row of the table with smoothing, and one without."""
    with damaged_months():
        month = Month("development", part, 3000)
        gel, presses = MountedGel(month), list(_choose(month))
        smoothed = fit_first(gel, folder / "smoothed")
        with patch.object(preparation, "smooth_presses", lambda presses: presses):
            plain = fit_first(gel, folder / "plain")
        scorers = [Scorer(Bundle.load(path), 1) for path in (smoothed, plain)]
        scores = np.array([_score(gel, press, scorers) for press in presses]).T
    is_damaged = np.array([press.truth == "damaged" for press in presses])
    return [_row(f"{part}, {name}", scores[k], is_damaged) for k, name in enumerate(("smoothed", "as it is"))]


@contextmanager
def damaged_months() -> Iterator[None]:
    """Inside, a fifth of the pieces of a month are damaged, and its gels have no scars."""
    shares = patch.object(plan, "_DAMAGED_SHARE", _DAMAGED_SHARE)
    with shares, patch.object(Month, "scars", lambda *_: ()):
        yield


def see(frame: bytes, bundle: Bundle) -> U8:
    """Return the region of a frame that the bundle inspects."""
    picture = decode(CameraFrame(frame, 0, 0, is_on_demand=True), bundle.profile)
    return np.ascontiguousarray(bundle.region.crop(picture))


def _choose(month: Month) -> Iterator[PlannedPress]:
    """All damaged pieces of the days, and each third of the sound ones."""
    for number, press in enumerate(press for day in range(_DAYS) for press in month.day(day)):
        if press.truth == "damaged" or (press.truth == "sound" and number % _SOUND_EVERY == 0):
            yield replace(press, light=1.0)


def _score(gel: MountedGel, press: PlannedPress, scorers: list[Scorer]) -> list[float]:
    """Score a press, in units of the limits; infinite where it is rejected."""
    frames = list(gel.press(press))
    found = []
    for scorer in scorers:
        bundle = scorer.bundle
        try:
            score = scorer.score(see(frames[len(frames) // 2], bundle)).anomaly_score
            found.append(score / bundle.manifest.threshold.value)
        except PoseNotFound:
            found.append(np.inf)
    return found


def _row(name: str, scores: np.ndarray, is_damaged: np.ndarray) -> list[str]:
    sound, damaged = np.sort(scores[~is_damaged]), scores[is_damaged]
    limits = [1.0, *(sound[int((1 - share) * len(sound)) - 1] for share in (0.01, 0.05))]
    missed = [f"{np.mean(damaged <= limit):.3f}" for limit in limits]
    return [name, str(len(sound)), str(len(damaged)), f"{np.mean(sound > 1):.3f}", *missed]


def main(measure: Callable[[int, Path], list[list[str]]], head: list[str], usage: str | None) -> None:
    """Measure each part that is named, and print the table."""
    if not sys.argv[1:]:
        raise SystemExit(usage)
    rows = []
    with TemporaryDirectory() as folder:
        for part in map(int, sys.argv[1:]):
            rows += measure(part, Path(folder) / str(part))
    print(markdown_table(head, rows))


if __name__ == "__main__":
    head = ["part", "sound", "damaged", "sound that fail", "damaged that pass", "at 1 %", "at 5 %"]
    main(measure, head, __doc__)
