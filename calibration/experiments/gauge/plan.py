"""The plan of a gauge study: which operator presses which piece, in a random order that is written down.

Within each repeat every operator has one block, and within a block the pieces are in random order; the blocks are in
random order too. So no operator waits for each press, and no piece has its own time of the day.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator

from edge.core.arrays import F64
from edge.core.errors import ConfigError, DatasetError
from edge.store.study_presses import StudyPress
from edge.store.ulid import new_ulid

__all__ = ["ORIGIN", "SCORED", "Material", "Piece", "StudyPlan", "make_plan", "material", "read_plan"]

Name = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]{1,64}$")]


class _Entry(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


class Piece(_Entry):
    """known: the verdict that it must give, None where that is not known."""

    name: Name
    known: Literal["pass", "fail"] | None = None


class Step(_Entry):
    """One press; repeat counts from 1."""

    operator: Name
    piece: Name
    repeat: int = Field(ge=1)


class StudyPlan(_Entry):
    """order: the presses, first to last."""

    kind: Literal["gelgate gauge study"] = "gelgate gauge study"
    version: Literal[1] = 1
    study_id: str = Field(pattern=r"^[0-7][0-9A-HJKMNP-TV-Z]{25}$")
    seed: int
    repeats: int = Field(ge=2, le=100)
    operators: tuple[Name, ...] = Field(min_length=2, max_length=50)
    pieces: tuple[Piece, ...] = Field(min_length=2, max_length=1000)
    order: tuple[Step, ...]

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        for what, names in (("operator", self.operators), ("piece", [piece.name for piece in self.pieces])):
            if twice := [name for name, n in Counter(names).items() if n > 1]:
                raise ValueError(f"the {what} '{twice[0]}' is there twice")
        wanted = {
            (operator, piece.name, repeat)
            for operator in self.operators
            for piece in self.pieces
            for repeat in range(1, self.repeats + 1)
        }
        counts = Counter((step.operator, step.piece, step.repeat) for step in self.order)
        if set(counts) != wanted or set(counts.values()) != {1}:
            raise ValueError(
                f"order has {len(self.order)} presses, expected each operator with each piece in each repeat, once: "
                f"{len(wanted)}"
            )
        return self

    def text(self) -> str:
        """The plan as it is written: the same plan gives the same text."""
        return self.model_dump_json(indent=1) + "\n"


def make_plan(
    pieces: Sequence[Piece], operators: Sequence[str], repeats: int, seed: int, time_ns: int
) -> StudyPlan:
    """time_ns: wall clock, for the study's id. Errors: ConfigError for fewer than two of anything, or a name twice."""
    for what, number in (("pieces", len(pieces)), ("operators", len(operators)), ("repeats", repeats)):
        if number < 2:
            raise ConfigError(
                f"a gauge study has at least 2 {what}, found {number}; with fewer nothing can be compared (10 pieces, "
                "3 operators and 3 repeats are usual)"
            )
    rng = np.random.default_rng(seed)
    order = tuple(
        Step(operator=operators[operator], piece=pieces[piece].name, repeat=repeat)
        for repeat in range(1, repeats + 1)
        for operator in rng.permutation(len(operators))
        for piece in rng.permutation(len(pieces))
    )
    try:
        return StudyPlan(
            study_id=new_ulid(time_ns),
            seed=seed,
            repeats=repeats,
            operators=tuple(operators),
            pieces=tuple(pieces),
            order=order,
        )
    except ValidationError as error:
        raise ConfigError(f"the plan cannot be made: {_first(error)}") from error


def read_plan(text: str, where: Path | str) -> StudyPlan:
    """where: named in a refusal. Errors: ConfigError."""
    try:
        return StudyPlan.model_validate_json(text)
    except ValidationError as error:
        raise ConfigError(
            f"plan {where} cannot be used: {_first(error)}; `gelgate lab msa plan` makes one"
        ) from error


def _first(error: ValidationError) -> str:
    fault = error.errors()[0]
    where = ".".join(map(str, fault["loc"]))
    text = str(fault["msg"]).removeprefix("Value error, ")
    return f"{where}: {text}" if where else text


SCORED: Final = ("pass", "fail", "unsure")

ORIGIN: Final = {
    "sensor": "serial",
    "gel": "gel_id",
    "part": "part",
    "position": "position",
    "bundle": "bundle_id",
}
"""What all presses of a study have in common, with its column."""


@dataclass(frozen=True)
class Material:
    """A balanced study: what is analysed may be less than the plan."""

    plan: StudyPlan
    pieces: tuple[str, ...]
    operators: tuple[str, ...]
    scores: F64
    """float64 (pieces, operators, repeats)."""
    verdicts: NDArray[np.str_]
    """The verdicts in the same table."""
    presses: tuple[StudyPress, ...]
    """Every counted press with a score in the order of time."""
    missing: int
    """Presses of the plan without a counted press."""
    rejected: Counter[str]
    """By operator, presses without a score."""
    void: int
    """Pressed again."""

    @property
    def left_out(self) -> int:
        """Counted presses that the table has no place for."""
        return len(self.presses) - self.scores.size

    @property
    def known(self) -> list[str] | None:
        """The truth of each analysed piece; None where it is not known of all."""
        known = [piece.known for piece in self.plan.pieces if piece.name in self.pieces]
        return [press for press in known if press is not None] if None not in known else None


def material(plan: StudyPlan, rows: Sequence[StudyPress]) -> Material:
    """Sort presses into a table: where some are missing the largest without gaps, with fewer repeats or fewer pieces.

    Errors: DatasetError where no table of 2 x 2 x 2 is left, and for a change in the middle.
    """
    counted = [row for row in rows if not row.is_void]
    scored = [one for one in counted if one.verdict in SCORED and one.score is not None]
    _require_one_origin(scored)
    cells: dict[tuple[str, str], list[StudyPress]] = {}
    for study_press in sorted(scored, key=lambda press: press.repeat):
        cells.setdefault((study_press.piece, study_press.operator), []).append(study_press)
    operators = tuple(name for name in plan.operators if any(name == one.operator for one in scored))

    def find_pieces(repeats: int) -> tuple[str, ...]:
        names = (piece.name for piece in plan.pieces)
        return tuple(n for n in names if all(len(cells.get((n, o), ())) >= repeats for o in operators))

    repeats = max(range(plan.repeats, 1, -1), key=lambda number: number * len(find_pieces(number)))
    pieces = find_pieces(repeats)
    if len(pieces) < 2 or len(operators) < 2:
        raise DatasetError(
            f"{len(scored)} of {len(plan.order)} presses of the study have a score, and no 2 pieces were pressed twice "
            "by 2 operators; `gelgate lab msa run` goes on with the plan"
        )
    table = [[cells[piece, operator][:repeats] for operator in operators] for piece in pieces]
    return Material(
        plan,
        pieces,
        operators,
        np.array([[[one.score for one in cell] for cell in row] for row in table], np.float64),
        np.array([[[one.verdict for one in cell] for cell in row] for row in table]),
        tuple(scored),
        missing=len(plan.order) - sum(min(len(cell), plan.repeats) for cell in cells.values()),
        rejected=Counter(one.operator for one in counted if one.verdict not in SCORED),
        void=len(rows) - len(counted),
    )


def _require_one_origin(scored: Sequence[StudyPress]) -> None:
    """Refuse mixed presses. Errors: DatasetError for two gels, bundles, sensors or positions."""
    for what, name in ORIGIN.items():
        origins = list(dict.fromkeys(str(getattr(press, name)) for press in scored))
        if len(origins) > 1:
            raise DatasetError(
                f"the study was pressed with more than one {what} ({', '.join(one[:16] for one in origins)}): its "
                "scores cannot be compared; make a new plan and press it with one"
            )
