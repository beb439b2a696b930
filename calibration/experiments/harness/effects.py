"""Ours and the paper's numbers next to each other: medians over seeds, and whether an effect has the same direction."""

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from calibration.experiments.harness.evidence import Sample, summarised
from calibration.experiments.harness.intervals import is_drawn

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "COMPARED",
    "Agreement",
    "Direction",
    "Effect",
    "agreement",
    "count_agreements",
    "direction",
    "direction_of_paper",
    "effects",
    "medians",
]

COMPARED: Mapping[str, str] = {"pixel_auroc": "AUROC", "auprc": "AUPRC", "aupro_001": "AU-PRO@0.01"}
"""The measures of the paper's Tables 2 and 3, with their headings."""

Direction = Literal["up", "down", "undecided"]
Agreement = Literal["agree", "differ", "undecided"]

Medians = Mapping[tuple[str, str, str], Mapping[str, float]]
"""(method, part, measure) to the median at each condition, as `calibration.experiments.harness.published.published`."""


@dataclass(frozen=True)
class Effect:
    """How a measure changes between two conditions, here and in the paper (None: not in the paper)."""

    method: str
    part: str
    measure: str
    ours: Direction
    difference: float
    paper: Direction | None

    @property
    def agreement(self) -> Agreement | None:
        return None if self.paper is None else agreement(self.ours, self.paper)


def medians(rows: "pd.DataFrame", condition: str, measures: Iterable[str] = COMPARED) -> Medians:
    """Medians over seeds. condition: the column that varies; numbers are written as `0.05`."""
    found: dict[tuple[str, str, str], dict[str, float]] = {}
    for measure in measures:
        for (method, part, value), group in rows.dropna(subset=[measure]).groupby(
            ["method", "part", condition]
        ):
            found.setdefault((method, part, measure), {})[write_condition(value)] = float(
                group[measure].median()
            )
    return found


def write_condition(value: Hashable) -> str:
    """A condition as text."""
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def direction(
    before: Mapping[int, float], after: Mapping[int, float], *, are_drawn: bool = True
) -> tuple[Direction, float]:
    """The direction of the mean difference over seeds, `undecided` if its 95 % interval includes zero; and the mean.

    before, after: seed to value. are_drawn: whether the seeds learn different presses; if not, or with fewer than three
    of them, it is undecided.
    """
    paired = {("", seed): after[seed] - value for seed, value in before.items() if seed in after}
    if not paired:
        return "undecided", float("nan")
    mean = summarised(Sample(paired, frozenset() if are_drawn else frozenset([""])))
    if not mean.has_interval or mean.low <= 0 <= mean.high:
        return "undecided", mean.value
    return ("up" if mean.value > 0 else "down"), mean.value


def direction_of_paper(before: float, after: float) -> Direction:
    """The direction of the paper's median; equal medians are undecided."""
    return "undecided" if before == after else "up" if after > before else "down"


def agreement(ours: Direction, paper: Direction) -> Agreement:
    """Say whether two directions are the same."""
    if "undecided" in (ours, paper):
        return "undecided"
    return "agree" if ours == paper else "differ"


def effects(
    rows: "pd.DataFrame",
    condition: str,
    before: Any,
    after: Any,
    paper: Medians,
    names: tuple[str, str],
    measures: Sequence[str] = tuple(COMPARED),
) -> list[Effect]:
    """The effect of a condition on every method, part and measure.

    before, after: values of the column. names: what the paper's data call them.
    """
    found = []
    for (method, part), group in rows[rows[condition].isin([before, after])].groupby(["method", "part"]):
        are_drawn = any(is_drawn(row) for row in group.to_dict("records"))
        for measure in measures:
            old, new = (_by_seed(group[group[condition] == value], measure) for value in (before, after))
            ours, difference = direction(old, new, are_drawn=are_drawn)
            theirs = paper.get((method, part, measure))
            known = None if theirs is None else direction_of_paper(*(theirs[name] for name in names))
            if np.isfinite(difference):
                found.append(Effect(method, part, measure, ours, difference, known))
    return found


def count_agreements(agreements: Iterable[Agreement | None]) -> str:
    """Write `7 agree, 2 differ, 3 undecided`; None is not in the paper."""
    every = list(agreements)
    return ", ".join(f"{every.count(name)} {name}" for name in ("agree", "differ", "undecided"))


def _by_seed(rows: "pd.DataFrame", measure: str) -> dict[int, float]:
    return {int(s): float(v) for s, v in zip(rows["seed"], rows[measure], strict=True) if np.isfinite(v)}
