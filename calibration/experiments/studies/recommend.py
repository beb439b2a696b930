"""`gelgate lab recommend`: which method to take for a need, from the rows of the studies alone.

The needs are the columns of the seed paper's Table 4, and what else a station may need. An answer has the rows' numbers
with their intervals. Where the rows do not decide, it says so, and what to take then; where they are missing, it names
the command that gives them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from calibration.experiments.harness.evidence import Mean, Sample, Samples, Standing, ranking
from calibration.experiments.harness.intervals import is_drawn
from calibration.experiments.harness.page import Page, by_setup, only_scored, table
from calibration.experiments.harness.published import judgements, no_fixture, source
from calibration.fitting.candidates import DEFAULT_METHOD
from edge.core.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["NEEDS", "Answer", "Question", "answer_question", "page", "recommended"]

Row = Mapping[str, Any]

FEW = 8
"""The number of presses that counts as few."""

FEW_SHOT = 0.05
"""The share of the target position's presses of the few-shot gain."""

CLOSE = 0.05
"""Where the rows do not decide, a mean this far below the highest is as good for the choice."""


@dataclass(frozen=True)
class Question:
    """One question to the rows."""

    need: str
    """The need that it belongs to."""
    title: str
    """As it is printed, with the measure."""
    study: str
    """Whose rows answer it."""
    values: Callable[[Sequence[Row]], Samples]
    """The values of one row set by method, empty where the rows do not cover the question."""
    column: str | None = None
    """The column of the paper's Table 4."""
    span: tuple[float, float] = (0.0, 1.0)
    """The lowest and highest value possible."""
    parts: Sequence[str] = ()
    """Which it is about; all if empty."""
    higher_is_better: bool = True
    unit: str = ""

    @property
    def judgements(self) -> Mapping[str, str]:
        """The paper's word on each method."""
        return {} if self.column is None else judgements(self.column)

    @property
    def command(self) -> str:
        """The command that gives the rows."""
        words = [
            f"gelgate lab study {self.study} DATASET -o FOLDER",
            *(f"--part {part}" for part in self.parts),
        ]
        return " ".join(words)


@dataclass(frozen=True)
class Answer:
    """standing: None where the rows do not cover the question, or cannot be compared; then `refusal` says why."""

    question: Question
    standing: Standing | None
    refusal: str = ""

    def lines(self) -> list[str]:
        """The answer as text."""
        if self.standing is None:
            return [self.question.title, f"  {self.verdict}"]
        found, unit = self.standing, self.question.unit
        any_mean = next(iter(found.means.values()))
        counted = f"  parts: {any_mean.parts}; draws of presses on each: {any_mean.draws} or more"
        said = {name: f"  the paper: {what}" for name, what in self.question.judgements.items()}
        listed = [
            f"  {name:<10} {mean.value:8.4f}{unit}{_span(mean)}{said.get(name, '')}"
            for name, mean in found.means.items()
        ]
        then = [f"     {self.then}"] if self.then else []
        return [self.question.title, counted, *listed, f"  -> {self.verdict}", *then]

    @property
    def verdict(self) -> str:
        """The method, or why the rows do not decide."""
        if self.refusal:
            return f"undecided: {self.refusal}"
        if self.standing is None:
            return f"the rows do not cover this; `{self.question.command}` gives them"
        found = self.standing
        if found.best is not None:
            return found.best
        between = f" between {' and '.join((next(iter(found.means)), *found.rivals))}" if found.rivals else ""
        return f"undecided{between}: {found.why}"

    @property
    def then(self) -> str:
        """The method to take where rows do not decide: the default of `gelgate fit` where it is close to the best."""
        if self.standing is None or not self.standing.rivals:
            return ""
        means = self.standing.means
        first = next(iter(means))
        behind = {
            name: abs(means[first].value - means[name].value) for name in (first, *self.standing.rivals)
        }
        if (
            first != DEFAULT_METHOD
            and self.question.higher_is_better
            and behind.get(DEFAULT_METHOD, 1) <= CLOSE
        ):
            why = f"it is the default of `gelgate fit`, {behind[DEFAULT_METHOD]:.3f} below the highest mean"
            return f"Take {DEFAULT_METHOD} then: {why}."
        best = "highest" if self.question.higher_is_better else "lowest"
        also = "is the default of `gelgate fit`, and " if first == DEFAULT_METHOD else ""
        return f"Take {first} then: it {also}has the {best} mean."


def _span(mean: Mean) -> str:
    """The interval; nothing where too few draws give none."""
    return f"  [{mean.low:.4f}, {mean.high:.4f}]" if mean.has_interval else ""


def by_method(rows: Sequence[Row], measure: str) -> dict[str, Sample]:
    """The sample of each method; rows without the measure are left out.

    Errors: ConfigError for two rows of the same method, part and seed with different settings and results: a fraction
    above the cap of a pool learns the same presses as another.
    """
    found: dict[str, dict[tuple[str, int], float]] = {}
    drawn: dict[str, set[str]] = {}
    results: dict[tuple[str, str, int], str | None] = {}
    for row in rows:
        values, pair = found.setdefault(row["method"], {}), (row["part"], row["seed"])
        result = row.get("scores_sha256")
        if pair in values and (result is None or result != results[row["method"], *pair]):
            raise ConfigError(
                f"two rows of {row['study']} have {row['method']} on {row['part']} with seed {row['seed']} and other "
                "settings, so they cannot be compared; give rows that one command made"
            )
        if row.get(measure) is not None:
            values[pair] = float(row[measure])
            results[row["method"], *pair] = result
        if is_drawn(row):
            drawn.setdefault(row["method"], set()).add(row["part"])
    return {
        method: Sample(values, frozenset(part for part, _ in values) - drawn.get(method, set()))
        for method, values in found.items()
    }


def gains(rows: Sequence[Row], measure: str, column: str, before: object, after: object) -> Samples:
    """Compute how much a measure rises from one condition to another, on the same part and seed."""
    old, new = (by_method([r for r in rows if r.get(column) == value], measure) for value in (before, after))
    return {method: new[method].minus(old[method]) for method in old.keys() & new.keys()}


def _at_few(rows: Sequence[Row]) -> Samples:
    shots = {int(row["shots"]) for row in rows if row.get("shots") is not None and row["shots"] <= FEW}
    return by_method([r for r in rows if r.get("shots") == max(shots)], "aupro_001") if shots else {}


def _at_all(rows: Sequence[Row], measure: str = "aupro_001") -> Samples:
    shares = {row["fraction"] for row in rows if row.get("fraction") is not None}
    return by_method([r for r in rows if r.get("fraction") == max(shares)], measure) if shares else {}


def _at_most_bad(rows: Sequence[Row]) -> Samples:
    """Choose the largest share that all methods have: with few damaged presses a large bank has no row of it."""
    of_share = {share: [r for r in rows if r["bad"] == share] for share in {r["bad"] for r in rows}}
    methods = [{r["method"] for r in of_share[share]} for share in of_share]
    complete = [
        share for share, found in zip(of_share, methods, strict=True) if found == set().union(*methods)
    ]
    return by_method(of_share[max(complete or of_share)], "aupro_001")


def _head_time(rows: Sequence[Row]) -> Samples:
    """Processor time and not the clock: cells of one study run while the machine does other work as well."""
    timed = [
        {**row, _HEAD_MS: 1e3 * row["cpu_score_s"] / (row["test_nominal"] + row["test_defective"])}
        for row in rows
        if row.get("cpu_score_s") is not None and row.get("test_nominal") is not None
    ]
    return _at_all(timed, _HEAD_MS)


_HEAD_MS = "head_ms"


def _gain(measure: str, column: str, before: object, after: object) -> Callable[[Sequence[Row]], Samples]:
    return lambda rows: gains(rows, measure, column, before, after)


_GAIN = (-1.0, 1.0)

QUESTIONS = (
    Question(
        "few-presses",
        f"few presses: AU-PRO@0.01 with {FEW} presses or fewer",
        "good-fraction", _at_few, "few nominal contacts",
    ),
    Question(
        "localisation",
        "localisation at low resolution: AU-PRO@0.01 with the largest share of presses",
        "good-fraction", _at_all, "LR localization",
    ),
    Question(
        "cross-position",
        "another position, none of its presses: AU-PRO@0.01 of both positions",
        "cross-position",
        lambda rows: by_method([r for r in rows if r["target_fraction"] == 0], "aupro_001"),
        "zero-shot cross-pos.",
    ),
    Question(
        "cross-position",
        f"another position, gain in AU-PRO@0.01 by {FEW_SHOT:.0%} of its presses",
        "cross-position", _gain("aupro_001", "target_fraction", 0.0, FEW_SHOT), "few-shot cross-pos. gain", _GAIN,
    ),
    Question(
        "high-resolution",
        "high resolution: AU-PRO@0.01 in tiles, in the field of view of both resolutions",
        "resolution",
        lambda rows: by_method([r for r in rows if r["view"] == "hr_tiled"], "aupro_001_common"),
    ),
    Question(
        "high-resolution",
        "high resolution: gain in AU-PRO@0.01 over low resolution, same field of view and masks",
        "resolution", _gain("aupro_001_common", "view", "lr", "hr_tiled"), "HR benefit", _GAIN,
    ),
    Question(
        "high-resolution",
        "high resolution: gain by its detail alone, over low resolution scaled up and tiled",
        "resolution", _gain("aupro_001_common", "view", "lr_tiled", "hr_tiled"), span=_GAIN,
    ),
    Question(
        "no-fixture",
        f"no fixture: AU-PRO@0.01 on {', '.join(no_fixture())} with the largest share of presses",
        "good-fraction", _at_all, parts=no_fixture(),
    ),
    Question(
        "bad-presses",
        "damaged presses among the nominal ones: AU-PRO@0.01 with the largest share of them that every method has",
        "bad-presses", _at_most_bad,
    ),
    Question(
        "least-time",
        "least time: processor milliseconds of the head per press, the largest share of presses in the bank",
        "good-fraction", _head_time, span=(0.0, math.inf), higher_is_better=False, unit=" ms",
    ),
)  # fmt: skip

NEEDS = tuple(dict.fromkeys(question.need for question in QUESTIONS))
"""What `--need` takes."""


def answer_question(question: Question, rows: Sequence[Row]) -> Answer:
    """The answer of rows of one mode, backbone and split; rows with an error count as missing."""
    own = [row for row in rows if row["study"] == question.study and row.get("error") is None]
    own = [row for row in own if not question.parts or row["part"] in question.parts]
    try:
        samples = question.values(own) if own else {}
    except ConfigError as error:
        return Answer(question, None, str(error))
    samples = {method: sample for method, sample in samples.items() if sample.values}
    if not samples:
        return Answer(question, None)
    return Answer(question, ranking(samples, higher_is_better=question.higher_is_better, span=question.span))


def recommended(rows: Sequence[Row], needs: Sequence[str] = ()) -> list[Answer]:
    """The answers to some needs, or to all."""
    asked = [question for need in needs or NEEDS for question in QUESTIONS if question.need == need]
    return [answer_question(question, rows) for question in asked]


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of all studies."""
    sections = [
        "# Which method to take\n",
        "The answers of `gelgate lab recommend` from these rows. Each method has its mean with a 95 % interval: "
        "over the "
        "parts, or over the draws of presses where there is one part. A method is the answer if the interval of its "
        "advantage over each other one is above zero. Where none is, a sentence says what to take then. The last "
        f"column is the judgement of Table 4 of: {source()}.\n",
    ]
    for title, group in by_setup(only_scored(rows)):
        records = group.astype(object).where(group.notna(), None).to_dict("records")
        answers = [answer for answer in recommended(records) if answer.standing is not None or answer.refusal]
        sections += [f"## {title}\n", *map(_section, answers)]
    return Page("\n".join(sections))


def _section(answer: Answer) -> str:
    question = answer.question
    then = f" {answer.then}" if answer.then else ""
    title = f"### {question.title[0].upper() + question.title[1:]}\n\n**{answer.verdict}**{then}\n"
    if answer.standing is None:
        return title
    means = answer.standing.means
    any_mean = next(iter(means.values()))
    lines = [
        [
            name,
            f"{mean.value:.4f}{question.unit}",
            f"{mean.low:.4f} to {mean.high:.4f}" if mean.has_interval else "-",
            question.judgements.get(name, "-"),
        ]
        for name, mean in means.items()
    ]
    return (
        f"{title}\nParts: {any_mean.parts}; draws of presses on each: {any_mean.draws} or more.\n\n"
        f"{table(['method', 'mean', '95 % interval', 'the paper'], lines)}"
    )
