"""Second presses of a piece: how often a piece fails wrongly or passes wrongly, by the lower of two scores and by what
both show at one place.

    python tests/bench/second_presses.py PART [PART ...]    development parts of `gelgate lab month`

Per cent of the sound pieces that fail, and of the damaged ones that pass. Each bundle is fitted as on the first day of
a month, and judges pieces of the days after it on the gel of the fit and on another one, a fifth of them damaged, each
pressed three times. A second press is asked for above the threshold, up to the bound of `PressAgain` by default.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, permutations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from month_presses import damaged_months, main, see

from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import Month, PlannedPress
from calibration.experiments.month.run import fit_first
from edge.core.errors import PoseNotFound
from edge.core.press import Press
from edge.core.press_again import AGREED, SeenScores, is_asked, score_both
from edge.features.press_again import find_seen
from edge.model.again_facts import DEFAULT_COSTS, plan_for
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer

_DAYS, _SOUND_EVERY, _PRESSES = 15, 9, 3
RULES = {"one press": None, "lower score": 0.0} | {
    f"both show {share:g}": share for share in (0.9, AGREED, 1.0)
}


class Piece(NamedTuple):
    """Its scores, what the presses show, and which of them ask for another one."""

    is_damaged: bool
    threshold: float
    scores: list[float]
    seen: list[SeenScores | None]
    asks: list[bool]


def measure(part: int, folder: Path) -> list[list[str]]:
    """Return the rows of a part: on the gel of the fit, and on another one."""
    with damaged_months():
        month = Month("development", part, 3000)
        bundle = Bundle.load(fit_first(MountedGel(month), folder))
        scorer = Scorer(bundle, 1)
        rows = []
        for gel, name in enumerate(("", ", another gel")):
            mounted = MountedGel(month, gel)
            pieces = [piece for press in _choose(month) if (piece := _press(mounted, press, scorer))]
            rows.append(_row(f"{part}{name}", pieces))
    return rows


def _choose(month: Month) -> Iterator[PlannedPress]:
    """Choose each second damaged piece of the days, and some of the sound ones."""
    for number, press in enumerate(press for day in range(_DAYS) for press in month.day(day)):
        every = {"damaged": 2, "sound": _SOUND_EVERY}.get(press.truth)
        if every and number % every == 0:
            yield replace(press, light=1.0)


def _press(gel: MountedGel, press: PlannedPress, scorer: Scorer) -> Piece | None:
    """Press a piece three times; None where one of these has no pose."""
    bundle, presses = scorer.bundle, list[Press]()
    for attempt in range(_PRESSES):
        _, held = islice(gel.press(press, attempt), 2)
        try:
            found = scorer.score(see(held, bundle))
        except PoseNotFound:
            return None
        verdict = bundle.manifest.decide(found.anomaly_score)
        presses.append(Press(verdict, score_map=found.score_map, registered=found.registered))
    bound = plan_for(bundle.manifest, DEFAULT_COSTS).bound
    return Piece(
        press.truth == "damaged",
        bundle.manifest.threshold.value,
        [one.verdict.score or 0.0 for one in presses if one.verdict],
        list(map(find_seen, presses)),
        [is_asked(one.verdict, bound) for one in presses if one.verdict],
    )


def _row(name: str, pieces: list[Piece]) -> list[str]:
    is_damaged = np.array([piece.is_damaged for piece in pieces])
    asked = np.mean([piece.asks for piece in pieces if not piece.is_damaged])
    row = [name, f"{np.count_nonzero(~is_damaged)}, {np.count_nonzero(is_damaged)}", f"{100 * asked:.1f}"]
    for share in RULES.values():
        fails = np.array([_fail(piece, share) for piece in pieces])
        row.append(f"{100 * fails[~is_damaged].mean():.1f}, {100 - 100 * fails[is_damaged].mean():.1f}")
    return row


def _fail(piece: Piece, share: float | None) -> float:
    """Return how often it fails, over the orders of its presses. share: of the threshold that both show at one place; 0
    for the lower score, None for the first press alone."""
    limit, found = piece.threshold, list[bool]()
    for first, second, *_ in permutations(range(_PRESSES)):
        lower, seen = min(piece.scores[first], piece.scores[second]), (piece.seen[first], piece.seen[second])
        is_beyond = piece.scores[second] > limit and not piece.asks[second]
        if share is None or not piece.asks[first]:
            found.append(piece.scores[first] > limit)
        elif share and not is_beyond and seen[0] is not None and seen[1] is not None:
            found.append(score_both(seen[0], seen[1]) * AGREED / share > limit)
        else:
            found.append(lower > limit)
    return float(np.mean(found))


if __name__ == "__main__":
    head = ["part", "pieces, sound and damaged", "decided by", "sound that fail", "damaged that pass"]
    main(measure, [*head, "pressed twice"], __doc__)
