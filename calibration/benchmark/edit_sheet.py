"""A contact sheet of the edits of real touch, to be looked at before figures are believed.

    python3 -m calibration.benchmark.edit_sheet REAL_TACTILE OUT.png --set real-touch

One row per trial: the held-out press, its edit, and the edit with the outline of its mask, side by side.
"""

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.real_touch import trials_of
from calibration.benchmark.sets import SENSORS
from calibration.benchmark.trial import Trial
from edge.core.errors import DatasetError, GelgateError

__all__ = ["main", "sheet_row"]

_SIDE_PX = 224
_OUTLINE = (255, 255, 255)


def sheet_row(trial: Trial, edits: int) -> NDArray[np.uint8]:
    """Edits of one trial, uint8 (224, 672 edits, 3) RGB: the press, its edit, and the edit with its outline."""
    damaged = np.flatnonzero(trial.masks.any(axis=(1, 2)))
    sound = np.flatnonzero(trial.is_own & ~trial.masks.any(axis=(1, 2)))
    shown = np.linspace(0, len(damaged) - 1, edits).astype(int)
    return np.hstack([_triple(trial, sound[k % len(sound)], damaged[k]) for k in shown])


def _triple(trial: Trial, before: int, after: int) -> NDArray[np.uint8]:
    mask = trial.masks[after].astype(np.uint8)
    outlined = trial.frames[after].copy()
    lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(outlined, lines, -1, _OUTLINE)
    three = (trial.frames[before], trial.frames[after], outlined)
    side = (_SIDE_PX, _SIDE_PX)
    return np.hstack([np.asarray(cv2.resize(one, side, interpolation=cv2.INTER_NEAREST)) for one in three])


def main(words: list[str] | None = None) -> int:
    """0, or 2 after a sentence on the standard error."""
    parser = argparse.ArgumentParser(
        prog="edit_sheet", description=__doc__.splitlines()[0] if __doc__ else ""
    )
    parser.add_argument("tactile", type=Path, help="folder of real tactile frames")
    parser.add_argument("out", type=Path, help="the picture to write, .png")
    parser.add_argument("--set", default="real-touch", choices=sorted(SENSORS), help="default: %(default)s")
    parser.add_argument("--edits", type=int, default=4, help="of each trial; default: %(default)s")
    given = parser.parse_args(words)
    try:
        trials = [make() for make in trials_of(given.tactile, list(SENSORS[given.set]))]
        sheet = np.vstack([sheet_row(trial, given.edits) for trial in trials])
        if not cv2.imwrite(str(given.out), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR)):
            raise DatasetError(f"'{given.out}' cannot be written; choose another file that ends with .png")
    except (GelgateError, cv2.error) as error:
        print(error, file=sys.stderr)
        return 2
    for trial in trials:
        print(trial.name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
