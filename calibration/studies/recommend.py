"""`gelgate recommend`: which method to take for a need, from the rows of the studies alone.

The needs are the columns of the seed paper's Table 4, and what else a station may need. An answer has the rows' numbers
with their intervals; where the rows do not decide, or are missing, it says so and names the command that gives them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from calibration.studies.evidence import MIN_SEEDS, Mean, Samples, Standing, ranking
from calibration.studies.published import no_fixture
from edge.core.errors import ConfigError

__all__ = ["NEEDS", "Answer", "Question", "answered", "recommended"]

Row = Mapping[str, Any]

FEW = 8
"""The number of presses that counts as few."""

FEW_SHOT = 0.05
"""The share of the target position's presses of the few-shot gain."""


@dataclass(frozen=True)
class Question:
    """One question to the rows.

    title: as it is printed, with the measure. study: whose rows answer it. values: of one row set by method, empty
    where the rows do not cover the question. command: what gives the rows.
    """

    title: str
    study: str
    values: Callable[[Sequence[Row]], Samples]
    command: str
    higher_is_better: bool = True
    unit: str = ""


@dataclass(frozen=True)
class Answer:
    """standing: None where the rows do not cover the question."""

    question: Question
    standing: Standing | None

    def lines(self) -> list[str]:
        """The answer as text."""
        if self.standing is None:
            return [
                self.question.title,
                f"  the rows do not cover this; `{self.question.command}` gives them",
            ]
        found, unit = self.standing, self.question.unit
        any_mean = next(iter(found.means.values()))
        counted = f"  parts: {any_mean.parts}; seeds: {any_mean.seeds} or more"
        listed = [f"  {name:<10} {mean.value:8.4f}{unit}{_span(mean)}" for name, mean in found.means.items()]
        return [self.question.title, counted, *listed, f"  -> {_verdict(found)}"]


def _span(mean: Mean) -> str:
    """The interval; nothing where too few seeds give none."""
    return f"  [{mean.low:.4f}, {mean.high:.4f}]" if mean.seeds >= MIN_SEEDS else ""


def _verdict(found: Standing) -> str:
    if found.best is not None:
        return found.best
    between = f" between {' and '.join((next(iter(found.means)), *found.rivals))}" if found.rivals else ""
    return f"undecided{between}: {found.why}"


def by_method(rows: Sequence[Row], measure: str) -> dict[str, dict[tuple[str, int], float]]:
    """Method to (part, seed) to the measure; rows without it are left out.

    Errors: ConfigError for two rows of the same method, part and seed, which were made with different settings.
    """
    found: dict[str, dict[tuple[str, int], float]] = {}
    for row in rows:
        values, pair = found.setdefault(row["method"], {}), (row["part"], row["seed"])
        if pair in values:
            raise ConfigError(
                f"two rows of {row['study']} have {row['method']} on {row['part']} with seed {row['seed']} and other "
                "settings, so they cannot be compared; give rows that one command made"
            )
        if row.get(measure) is not None:
            values[pair] = float(row[measure])
    return found


def gains(rows: Sequence[Row], measure: str, column: str, before: object, after: object) -> Samples:
    """How much a measure rises from one condition to another, on the same part and seed."""
    old, new = (by_method([r for r in rows if r.get(column) == value], measure) for value in (before, after))
    return {
        method: paired
        for method in old.keys() & new.keys()
        if (paired := {p: new[method][p] - v for p, v in old[method].items() if p in new[method]})
    }


def _at_few(rows: Sequence[Row]) -> Samples:
    shots = {int(row["shots"]) for row in rows if row.get("shots") is not None and row["shots"] <= FEW}
    return by_method([r for r in rows if r.get("shots") == max(shots)], "aupro_001") if shots else {}


def _at_all(rows: Sequence[Row], measure: str = "aupro_001") -> Samples:
    shares = {row["fraction"] for row in rows if row.get("fraction") is not None}
    return by_method([r for r in rows if r.get("fraction") == max(shares)], measure) if shares else {}


def _unfixed(rows: Sequence[Row]) -> Samples:
    return _at_all([row for row in rows if row["part"] in no_fixture()])


_GOOD = "gelgate study good-fraction DATASET -o FOLDER"
_CROSS = "gelgate study cross-position DATASET -o FOLDER"
_FINE = "gelgate study resolution DATASET -o FOLDER"

NEEDS: Mapping[str, tuple[Question, ...]] = {
    "few-presses": (
        Question(f"few presses: AU-PRO@0.01 with {FEW} presses or fewer", "good-fraction", _at_few, _GOOD),
    ),
    "localisation": (
        Question(
            "localisation at low resolution: AU-PRO@0.01 with all presses", "good-fraction", _at_all, _GOOD
        ),
    ),
    "cross-position": (
        Question(
            "another position, none of its presses: AU-PRO@0.01 of both positions",
            "cross-position",
            lambda rows: by_method([r for r in rows if r["target_fraction"] == 0], "aupro_001"),
            _CROSS,
        ),
        Question(
            f"another position, gain in AU-PRO@0.01 by {FEW_SHOT:.0%} of its presses",
            "cross-position",
            lambda rows: gains(rows, "aupro_001", "target_fraction", 0.0, FEW_SHOT),
            _CROSS,
        ),
    ),
    "high-resolution": (
        Question(
            "high resolution: AU-PRO@0.01 in tiles, in the field of view of both resolutions",
            "resolution",
            lambda rows: by_method([r for r in rows if r["view"] == "hr_tiled"], "aupro_001_common"),
            _FINE,
        ),
        Question(
            "high resolution: gain in AU-PRO@0.01 over low resolution, same field of view and masks",
            "resolution",
            lambda rows: gains(rows, "aupro_001_common", "view", "lr", "hr_tiled"),
            _FINE,
        ),
        Question(
            "high resolution: gain by its detail alone, over low resolution scaled up and tiled",
            "resolution",
            lambda rows: gains(rows, "aupro_001_common", "view", "lr_tiled", "hr_tiled"),
            _FINE,
        ),
    ),
    "no-fixture": (
        Question(
            f"no fixture: AU-PRO@0.01 on {', '.join(no_fixture())} with all presses",
            "good-fraction",
            _unfixed,
            f"{_GOOD} {' '.join(f'--part {part}' for part in no_fixture())}",
        ),
    ),
    "bad-presses": (
        Question(
            "damaged presses among the nominal ones: AU-PRO@0.01 with the largest share of them",
            "bad-presses",
            lambda rows: by_method(
                [r for r in rows if r["bad"] == max(one["bad"] for one in rows)], "aupro_001"
            ),
            "gelgate study bad-presses DATASET -o FOLDER",
        ),
    ),
    "least-time": (
        Question(
            "least time: milliseconds of the head per press, on one thread",
            "good-fraction",
            lambda rows: _at_all(rows, "score_ms"),
            _GOOD,
            higher_is_better=False,
            unit=" ms",
        ),
    ),
}
"""What `--need` takes, with the questions that are asked of the rows."""


def answered(question: Question, rows: Sequence[Row]) -> Answer:
    """The answer of rows of one mode, backbone and split; rows with an error count as missing."""
    own = [row for row in rows if row["study"] == question.study and row.get("error") is None]
    samples = question.values(own) if own else {}
    samples = {method: values for method, values in samples.items() if values}
    return Answer(question, ranking(samples, higher_is_better=question.higher_is_better) if samples else None)


def recommended(rows: Sequence[Row], needs: Sequence[str] = ()) -> list[Answer]:
    """The answers to some needs, or to all."""
    return [answered(question, rows) for need in needs or NEEDS for question in NEEDS[need]]
