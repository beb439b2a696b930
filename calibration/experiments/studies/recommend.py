"""`gelgate lab recommend`: which method to take for a need, from the rows of the studies alone.

The needs are the columns of the seed paper's Table 4, and what else a station may need. An answer has the rows' numbers
with their intervals. Where the rows do not decide, it says so, and what to take then; where they are missing, it names
the command that gives them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.experiments.harness.evidence import Sample, Standing, rank, sample, subtract
from calibration.experiments.harness.page import Page, by_setup, only_scored, render
from calibration.experiments.harness.published import read_published
from calibration.experiments.harness.rows import rows_of_studies
from calibration.experiments.harness.study import require_known
from calibration.fitting.options import DEFAULT_METHOD
from edge.core.errors import ConfigError
from edge.extras import needs

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["NEEDS", "Answer", "Question", "page", "recommend", "recommend_method"]

Samples = Mapping[str, Sample]

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
    values: Callable[["pd.DataFrame"], Samples]
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
        return dict(read_published()["judgements"].get(self.column, {}))

    @property
    def command(self) -> str:
        """The command that gives the rows."""
        return " ".join(
            [f"gelgate lab study {self.study} DATASET -o FOLDER", *(f"--part {part}" for part in self.parts)]
        )


@dataclass(frozen=True)
class Answer:
    """standing: None where the rows do not cover the question, or cannot be compared; then `refusal` says why."""

    question: Question
    standing: Standing | None
    refusal: str = ""

    @property
    def verdict(self) -> str:
        """The method, or why the rows do not decide."""
        if self.refusal:
            return f"undecided: {self.refusal}"
        if self.standing is None:
            return f"the rows do not cover this; `{self.question.command}` gives them"
        standing = self.standing
        if standing.best is not None:
            return standing.best
        between = (
            f" between {' and '.join((next(iter(standing.means)), *standing.rivals))}"
            if standing.rivals
            else ""
        )
        return f"undecided{between}: {standing.why}"

    @property
    def means(self) -> list[str]:
        """The methods with their means, the best first, with intervals and the paper's word where there are any."""
        assert self.standing is not None
        lines, words = [], self.question.judgements
        for name, mean in self.standing.means.items():
            interval = f" [{mean.low:.4f}, {mean.high:.4f}]" if mean.has_interval else ""
            paper = f" (paper: {words[name]})" if name in words else ""
            lines.append(f"{name} {mean.value:.4f}{self.question.unit}{interval}{paper}")
        return lines

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


def by_method(rows: "pd.DataFrame", measure: str) -> Samples:
    """Return the sample of each method; rows without the measure are left out.

    Errors: ConfigError for two rows of the same method, part and seed with different settings and results: a fraction
    above the cap of a pool learns the same presses as another.
    """
    if measure not in rows:
        return {}
    known, pair = rows.dropna(subset=[measure]), ["method", "part", "seed"]
    if "scores_sha256" in known:
        known = known[known["scores_sha256"].isna() | ~known.duplicated([*pair, "scores_sha256"])]
    if (twice := known[known.duplicated(pair)]).size:
        row = twice.iloc[0]
        raise ConfigError(
            f"two rows of {row['study']} have {row['method']} on {row['part']} with seed {row['seed']} and other "
            "settings, so they cannot be compared; give rows that one command made"
        )
    return {str(method): sample(own, measure) for method, own in known.groupby("method", sort=False)}


def _gain(measure: str, column: str, before: object, after: object) -> Callable[["pd.DataFrame"], Samples]:
    """Return what computes how much a measure rises between two conditions, on the same part and seed."""

    def gains(rows: "pd.DataFrame") -> Samples:
        old, new = (by_method(rows[rows[column] == value], measure) for value in (before, after))
        return {method: subtract(new[method], old[method]) for method in new if method in old}

    return gains


def _at_few(rows: "pd.DataFrame") -> Samples:
    """Choose the largest number of presses that counts as few."""
    shots = rows.reindex(columns=["shots"])["shots"]
    return by_method(rows[shots == shots[shots <= FEW].max()], "aupro_001")


def _at_all(rows: "pd.DataFrame", measure: str = "aupro_001") -> Samples:
    """Choose the largest share of presses."""
    share = rows.reindex(columns=["fraction"])["fraction"]
    return by_method(rows[share == share.max()], measure)


def _at_most_bad(rows: "pd.DataFrame") -> Samples:
    """Choose the largest share that all methods have: with few damaged presses a large bank has no row of it."""
    methods = rows.groupby("bad")["method"].nunique()
    return by_method(rows[rows["bad"] == methods.index[methods == methods.max()].max()], "aupro_001")


def _head_time(rows: "pd.DataFrame") -> Samples:
    """Processor time and not the clock: cells of one study run while the machine does other work as well."""
    known = rows.reindex(columns=["cpu_score_s", "test_nominal", "test_defective"]).astype(float)
    tested = known["test_nominal"] + known["test_defective"]
    return _at_all(
        rows.assign(head_ms=1e3 * known["cpu_score_s"] / tested).dropna(subset=["head_ms"]), "head_ms"
    )


_GAIN = (-1.0, 1.0)

_NO_FIXTURE = tuple(read_published()["no_fixture"])

QUESTIONS = (
    Question(
        "few-presses",
        f"Few presses: AU-PRO@0.01 with {FEW} presses or fewer",
        "good-fraction", _at_few, "few nominal contacts",
    ),
    Question(
        "localisation",
        "Localisation at low resolution: AU-PRO@0.01 with the largest share of presses",
        "good-fraction", _at_all, "LR localization",
    ),
    Question(
        "cross-position",
        "Another position, none of its presses: AU-PRO@0.01 of both positions",
        "cross-position",
        lambda rows: by_method(rows[rows["target_fraction"] == 0], "aupro_001"),
        "zero-shot cross-pos.",
    ),
    Question(
        "cross-position",
        f"Another position, gain in AU-PRO@0.01 by {FEW_SHOT:.0%} of its presses",
        "cross-position", _gain("aupro_001", "target_fraction", 0.0, FEW_SHOT), "few-shot cross-pos. gain", _GAIN,
    ),
    Question(
        "high-resolution",
        "High resolution: AU-PRO@0.01 in tiles, in the field of view of both resolutions",
        "resolution",
        lambda rows: by_method(rows[rows["view"] == "hr_tiled"], "aupro_001_common"),
    ),
    Question(
        "high-resolution",
        "High resolution: gain in AU-PRO@0.01 over low resolution, same field of view and masks",
        "resolution", _gain("aupro_001_common", "view", "lr", "hr_tiled"), "HR benefit", _GAIN,
    ),
    Question(
        "high-resolution",
        "High resolution: gain by its detail alone, over low resolution scaled up and tiled",
        "resolution", _gain("aupro_001_common", "view", "lr_tiled", "hr_tiled"), span=_GAIN,
    ),
    Question(
        "no-fixture",
        f"No fixture: AU-PRO@0.01 on {', '.join(_NO_FIXTURE)} with the largest share of presses",
        "good-fraction", _at_all, parts=_NO_FIXTURE,
    ),
    Question(
        "bad-presses",
        "Damaged presses among the nominal ones: AU-PRO@0.01 with the largest share of them that every method has",
        "bad-presses", _at_most_bad,
    ),
    Question(
        "least-time",
        "Least time: processor milliseconds of the head per press, the largest share of presses in the bank",
        "good-fraction", _head_time, span=(0.0, math.inf), higher_is_better=False, unit=" ms",
    ),
)  # fmt: skip

NEEDS = tuple(dict.fromkeys(question.need for question in QUESTIONS))
"""What `--need` takes."""


def recommend(rows: "pd.DataFrame", needs: Sequence[str] = ()) -> list[Answer]:
    """Return the answers to some needs, or to all. rows: of one mode, backbone and split."""
    asked = [question for need in needs or NEEDS for question in QUESTIONS if question.need == need]
    return [_answer(question, only_scored(rows)) for question in asked]


def _answer(question: Question, rows: "pd.DataFrame") -> Answer:
    own = rows[(rows["study"] == question.study) & (rows["part"].isin(question.parts) | (not question.parts))]
    try:
        samples = question.values(own) if len(own) else {}
    except ConfigError as error:
        return Answer(question, None, str(error))
    samples = {method: values for method, values in samples.items() if values}
    if not samples:
        return Answer(question, None)
    return Answer(question, rank(samples, higher_is_better=question.higher_is_better, span=question.span))


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of all studies."""
    setups = {
        title: [answer for answer in recommend(group) if answer.standing is not None or answer.refusal]
        for title, group in by_setup(only_scored(rows))
    }
    return Page(render("recommend", setups=setups))


def recommend_method(
    rows: Annotated[Path, typer.Argument(help="The rows.jsonl of `gelgate lab study`, or its folder.")],
    need: Annotated[
        list[str] | None,
        typer.Option(
            help="few-presses, localisation, cross-position, high-resolution, no-fixture, bad-presses or least-time; "
            "may be given several times. Default: all.",
            show_default=False,
        ),
    ] = None,
    mode: Annotated[
        str | None,
        typer.Option(help="Rows of this mode; needed where they have several.", show_default=False),
    ] = None,
    backbone: Annotated[
        str | None, typer.Option(help="Rows of this backbone, likewise.", show_default=False)
    ] = None,
    split: Annotated[
        str | None, typer.Option(help="Rows of this split, likewise.", show_default=False)
    ] = None,
) -> None:
    """Say which method to take for a need, from rows alone.

    Where the rows do not decide, it says so, and which command would."""
    needs("studies", "recommend")
    import pandas as pd

    require_known("need", need or (), NEEDS)
    chosen = pd.DataFrame(rows_of_studies(rows, partial(typer.echo, err=True)))
    for column, wanted in (("mode", mode), ("backbone", backbone), ("split", split)):
        chosen = _choose(chosen, column, wanted)
    first = chosen.iloc[0]
    typer.echo(f"rows of {first['backbone']}, {first['mode']} mode, split by {first['split']}")
    answers = recommend(chosen, need or ())
    typer.echo(f"\n{render('answers', answers=answers)}", nl=False)


def _choose(rows: "pd.DataFrame", column: str, wanted: str | None) -> "pd.DataFrame":
    """Return the rows with one value in a column. Errors: ConfigError where several are possible, or none has it."""
    choices = sorted(set(rows[column].astype(str)))
    if wanted is None and len(choices) > 1:
        raise ConfigError(
            f"the rows have several values of {column}: {', '.join(choices)}; choose one with --{column}"
        )
    if wanted is not None and wanted not in choices:
        raise ConfigError(f"no row has the {column} '{wanted}'; the rows have {', '.join(choices)}")
    return rows[rows[column].astype(str) == (wanted or choices[0])]
