"""Studies whose presses are known: a plan, and rows as a station would have made them."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from calibration.experiments.gauge.plan import Piece, StudyPlan, make_plan
from edge.store.study_presses import StudyPress

T0 = 1_780_000_000 * 10**9

Rows = Callable[..., list[StudyPress]]


@pytest.fixture
def plan() -> StudyPlan:
    """Four pieces, the last two bad, two operators, two repeats."""
    pieces = [Piece(name=f"P{n}", known="pass" if n < 3 else "fail") for n in range(1, 5)]
    return make_plan(pieces, ["A", "B"], 2, seed=3, time_ns=T0)


@pytest.fixture
def rows_of() -> Rows:
    """The presses of a plan in its order: each piece has its score, with noise."""

    def made(
        plan: StudyPlan, noise: float = 0.05, skip: Sequence[int] = (), **changes: object
    ) -> list[StudyPress]:
        rng = np.random.default_rng(1)
        known = {piece.name: piece.known for piece in plan.pieces}
        rows = []
        for number, step in enumerate(plan.order):
            score = float(1 + int(step.piece[1:]) * 0.25 - 0.6 + noise * rng.standard_normal())
            if number in skip:
                continue
            fields = {"verdict": known[step.piece] or "pass", "score": score, **changes}
            rows.append(
                StudyPress(
                    f"{number:026d}", T0 + number * 10**9, "S1", "g1", "bolt", "crest", "b1", threshold=1.0,
                    step=number, piece=step.piece, operator=step.operator, repeat=step.repeat, **fields,
                )  # type: ignore[arg-type]
            )  # fmt: skip
        return rows

    return made
