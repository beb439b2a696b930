"""How often presses of other pieces fail where a fit has learnt few pieces: the table of docs/bundle.md.

`python tests/bench/few_pieces.py ROWS.jsonl [PART...]` prints it: random parts for development, by default the first
ten, eight presses of each of 2, 3 and 6 pieces learnt, and presses of ten other and of 16 damaged pieces scored. A row
is kept as soon as it is measured. Two minutes of one core a part.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from default_fits import score_presses
from mechanisms import COMPLETE, fit_with, name_parts

from calibration.experiments.backbones.sets import Sizes, random_part_trial
from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.harness.rows import Rows
from calibration.fitting.options import DEFAULT_METHOD
from calibration.fitting.trunks import DEFAULT_BACKBONE
from edge.core.errors import FitError

LEARNT, SCORED, PRESSES = (2, 3, 6), 10, 8


def measure(part: int, learnt: int, method: str) -> dict[str, Any]:
    """Count the presses that fail after a fit of so many pieces; the sentence of a fit that is refused."""
    trial = random_part_trial(part, Sizes(learnt + SCORED, SCORED, PRESSES))
    try:
        fitted = fit_with(name_parts(COMPLETE), trial.nominal, method, DEFAULT_BACKBONE)
    except FitError as error:
        return {"error": str(error)}
    seen = score_presses(fitted, trial.frames, trial.masks)
    is_damaged = trial.masks.any(axis=(1, 2))
    return {
        "promised": fitted.manifest.threshold.alpha_floor,
        "sound": float(seen.fails[~is_damaged].mean()),
        "damaged": float(seen.fails[is_damaged].mean()),
        "warnings": list(fitted.manifest.provenance.warnings),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """One line for each number of pieces: means over the parts, and the worst one."""
    lines = []
    for learnt in LEARNT:
        own = [row for row in rows if row["learnt"] == learnt and "error" not in row]
        if own:
            sound = [row["sound"] for row in own]
            cells = (own[0]["promised"], np.mean(sound), max(sound), np.mean([row["damaged"] for row in own]))
            refused = sum(row["learnt"] == learnt and "error" in row for row in rows)
            lines.append([f"{learnt}", *(f"{cell:.0%}" for cell in cells), f"{len(own)}, {refused}"])
    head = ["pieces", "promised", "sound presses that fail", "of the worst part", "damaged presses that fail"]
    return markdown_table([*head, "parts, refused"], lines)


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    words.add_argument("rows", type=Path, help="the file of rows, made or continued")
    words.add_argument("parts", nargs="*", type=int, default=range(10))
    words.add_argument("--method", default=DEFAULT_METHOD)
    given = words.parse_intermixed_args()  # parts may follow options
    rows = Rows(given.rows)
    for part in given.parts:
        for learnt in LEARNT:
            key = f"{given.method}/{part}/{learnt}"
            if key not in rows.done():
                found = measure(part, learnt, given.method)
                rows.append({"key": key, "method": given.method, "part": part, "learnt": learnt, **found})
                print(rows.read()[-1], flush=True)
    print(table([row for row in rows.read() if row["method"] == given.method]))


if __name__ == "__main__":
    main()
