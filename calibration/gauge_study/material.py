"""From the rows of a study to what can be analysed: which presses count, and a table without gaps."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration.gauge_study.plan import StudyPlan
from edge.core.errors import DatasetError
from edge.store.study_presses import StudyPress

__all__ = ["Material", "material"]

_SCORED: Final = ("pass", "fail", "unsure")

Cell = tuple[str, str]


@dataclass(frozen=True)
class Material:
    """A balanced study. pieces, operators, repeats: what is analysed, which may be less than the plan.

    scores: float64 (pieces, operators, repeats). verdicts: the same as words. presses: every counted press with a score
    in the order of time. missing: of the plan, without a counted press. left_out: counted presses that the table has no
    place for. rejected: by operator, presses without a score. void: pressed again.
    """

    plan: StudyPlan
    pieces: tuple[str, ...]
    operators: tuple[str, ...]
    repeats: int
    scores: NDArray[np.float64]
    verdicts: list[list[list[str]]]
    presses: tuple[StudyPress, ...]
    missing: int
    left_out: int
    rejected: Mapping[str, int]
    void: int

    @property
    def known(self) -> list[str] | None:
        """What is known of each analysed piece; None where it is not known of all."""
        known = {piece.name: piece.known for piece in self.plan.pieces}
        found = [known[name] for name in self.pieces]
        return [one for one in found if one is not None] if None not in found else None


def material(plan: StudyPlan, rows: Sequence[StudyPress]) -> Material:
    """The presses of the study. Where some are missing, the table is the largest one without gaps: fewer repeats, or
    fewer pieces. Errors: DatasetError where no table of 2 x 2 x 2 is left, and for a change in the middle."""
    counted = [one for one in rows if not one.is_void]
    scored = [one for one in counted if one.verdict in _SCORED and one.score is not None]
    _check_same(scored)
    cells = _cells(scored)
    pieces, operators, repeats = _largest(plan, cells)
    chosen = [[cells[piece, operator][:repeats] for operator in operators] for piece in pieces]
    scores = [[[one.score for one in cell] for cell in row] for row in chosen]
    return Material(
        plan,
        pieces,
        operators,
        repeats,
        np.array(scores, np.float64),
        [[[one.verdict for one in cell] for cell in row] for row in chosen],
        tuple(scored),
        missing=len(plan.order) - sum(min(len(cell), plan.repeats) for cell in cells.values()),
        left_out=len(scored) - len(pieces) * len(operators) * repeats,
        rejected=Counter(one.operator for one in counted if one.verdict not in _SCORED),
        void=sum(one.is_void for one in rows),
    )


def _check_same(scored: Sequence[StudyPress]) -> None:
    """Errors: DatasetError for two gels, bundles, sensors or positions."""
    for what, name in (
        ("gel", "gel_id"),
        ("bundle", "bundle_id"),
        ("sensor", "serial"),
        ("part", "part"),
        ("position", "position"),
    ):
        found = list(dict.fromkeys(str(getattr(one, name)) for one in scored))
        if len(found) > 1:
            raise DatasetError(
                f"the study was pressed with more than one {what} ({', '.join(one[:16] for one in found)}): its scores "
                "cannot be compared; make a new plan and press it with one"
            )


def _cells(scored: Sequence[StudyPress]) -> dict[Cell, list[StudyPress]]:
    """Piece and operator to presses, in the order of repeats."""
    cells: dict[Cell, list[StudyPress]] = {}
    for one in sorted(scored, key=lambda press: press.repeat):
        cells.setdefault((one.piece, one.operator), []).append(one)
    return cells


def _largest(
    plan: StudyPlan, cells: Mapping[Cell, Sequence[StudyPress]]
) -> tuple[tuple[str, ...], tuple[str, ...], int]:
    """The pieces, operators and repeats of the largest table without gaps. Errors: DatasetError."""
    present = {operator for _, operator in cells}
    operators = tuple(name for name in plan.operators if name in present)
    best: tuple[tuple[str, ...], int] = ((), 0)
    for repeats in range(plan.repeats, 1, -1):
        pieces = tuple(
            one.name
            for one in plan.pieces
            if all(len(cells.get((one.name, operator), ())) >= repeats for operator in operators)
        )
        if len(pieces) * repeats > len(best[0]) * best[1]:
            best = (pieces, repeats)
    if len(best[0]) < 2 or len(operators) < 2:
        pressed = sum(map(len, cells.values()))
        raise DatasetError(
            f"{pressed} of {len(plan.order)} presses of the study have a score, and no 2 pieces were pressed twice by "
            "2 operators; `gelgate lab msa run` goes on with the plan"
        )
    return best[0], operators, best[1]
