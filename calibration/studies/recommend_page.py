"""Which method to take for each need, as a page: the answers of `gelgate lab recommend` for every setup of the rows."""

from typing import TYPE_CHECKING

from calibration.studies.page import Page, by_setup, only_scored, table
from calibration.studies.published import source
from calibration.studies.recommend import Answer, recommended

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]


def page(rows: "pd.DataFrame") -> Page:
    """The page. rows: of all studies."""
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
