"""Ours and the paper's results next to each other: order of the methods, direction of effects, level of the parts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any

from calibration.experiments.harness.evidence import (
    compare_directions,
    count_agreements,
    direction,
    effects,
    sample,
    subtract,
    write_condition,
)
from calibration.experiments.harness.page import SETUP, Page, by_setup, only_scored, render
from calibration.experiments.harness.published import paper_medians
from calibration.experiments.studies import cross_position_study, good_fraction_study, resolution_study

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]

_MEASURE = "aupro_001"


@dataclass(frozen=True)
class _Study:
    """A study with published medians."""

    name: str
    column: str
    """What it varies."""
    shown: tuple[str | float, ...]
    """The conditions of ours at which orders are compared."""
    steps: tuple[tuple[str | float, str | float, str], ...]
    """The effects that are compared, as pairs of our conditions."""
    names: Mapping[str, str] = field(default_factory=dict)
    """What the paper calls conditions of ours, where it is another word."""

    def paper(self, measure: str, condition: str | float) -> dict[tuple[str, str], float]:
        """Return the paper's median of each method and part at a condition of ours."""
        name = self.names.get(text := write_condition(condition), text)
        medians = paper_medians(self.name).items()
        return {key[:2]: values[name] for key, values in medians if key[2] == measure and name in values}


_STUDIES = (
    _Study(
        good_fraction_study.STUDY,
        "fraction",
        (0.05, 0.2, 1.0),
        ((0.05, 1.0, "all presses of the pool instead of a twentieth"),),
    ),
    _Study(
        cross_position_study.STUDY,
        "target_fraction",
        (0.0, 0.05),
        (
            (0.0, 0.05, "the first presses of a second position"),
            (0.05, 0.15, "more presses of the second position"),
        ),
    ),
    _Study(
        resolution_study.STUDY,
        "view",
        ("lr", "hr_tiled"),
        (("lr", "hr_tiled", "high resolution in tiles instead of low resolution"),),
        {"hr_tiled": "hr"},
    ),
)


def page(rows: "pd.DataFrame") -> Page:
    """Make the page. rows: of all studies."""
    import pandas as pd

    scored, setups = only_scored(rows), []
    for title, group in by_setup(scored):
        studies = [
            _compare(own, study) for study in _STUDIES if len(own := group[group["study"] == study.name])
        ]
        if any(found["is_known"] for found in studies):
            setups.append({"title": title, "studies": studies})
    counts = [[setup["title"], *_count([setup])] for setup in setups]
    counts.append(["**all**", *(f"**{text}**" for text in _count(setups))])
    heading = ["setup", "orders of two methods", "directions of an effect"]
    summary, levels = pd.DataFrame(counts, columns=heading), _span_levels(scored)
    return Page(render("paper", summary=summary, levels=levels, setups=setups))


def _count(setups: list[dict[str, Any]]) -> list[str]:
    studies = [found for setup in setups for found in setup["studies"]]
    return [
        count_agreements(each for found in studies for each in found[name])
        for name in ("pairs", "directions")
    ]


def _compare(rows: "pd.DataFrame", study: _Study) -> dict[str, Any]:
    """Compare the rows of one study and setup with the paper: orders of methods, directions."""
    orders, pairs = _list_orders(rows, study)
    steps = []
    for before, after, title in study.steps:
        effect_table = effects(rows, study.column, before, after, study.names)
        if len(known := effect_table[effect_table["paper"] != "-"]):
            columns = ["method", "part", "measure", "mean difference"]
            differing = known.loc[known["direction"] == "differ", columns].to_numpy()
            steps.append(
                {
                    "title": title,
                    "directions": list(known["direction"]),
                    "differing": [" ".join(map(str, row)) for row in differing],
                }
            )
    return {
        "name": study.name,
        "orders": orders,
        "pairs": pairs,
        "steps": steps,
        "directions": [word for step in steps for word in step["directions"]],
        "is_known": bool(len(orders) or steps),
    }


def _span_levels(rows: "pd.DataFrame") -> "pd.DataFrame":
    """Return AU-PRO of each part with all presses, in the setups that find least and most, and the paper's."""
    import pandas as pd

    study, lines = _STUDIES[0], []
    theirs = pd.Series(study.paper(_MEASURE, 1.0)).groupby(level=1).mean()
    full = rows[rows["study"] == study.name]
    full = full[full["fraction"] == 1.0] if "fraction" in full else full
    for part, group in full.groupby("part"):
        levels = group.groupby([*SETUP, "method"])[_MEASURE].median().groupby(level=SETUP).mean()
        ours = sorted((float(level), ", ".join(setup)) for setup, level in levels.items())
        if part in theirs:
            ends = [f"{level:.3f}, {setup}" for level, setup in (ours[0], ours[-1])]
            lines.append([part, *ends, f"{theirs[part]:.3f}"])
    return pd.DataFrame(lines, columns=["part", "least here", "most here", "paper"])


def _list_orders(rows: "pd.DataFrame", study: _Study) -> tuple["pd.DataFrame", list[str]]:
    """Return the order of the methods at each part and condition, and whether each pair of methods has the paper's."""
    import pandas as pd

    lines, every = [], list[str]()
    for (part, condition), group in rows[rows[study.column].isin(study.shown)].groupby(
        ["part", study.column]
    ):
        by_method = dict(list(group.groupby("method")))
        paper = study.paper(_MEASURE, condition)
        theirs = {method: paper[method, part] for method in by_method if (method, part) in paper}
        if len(theirs) < 2:
            continue
        values = {method: sample(by_method[method], _MEASURE) for method in theirs}
        pairs = [
            compare_directions(direction(subtract(values[b], values[a])), theirs[a], theirs[b])[1]
            for a, b in combinations(theirs, 2)
        ]
        ours = {method: float(by_method[method][_MEASURE].median()) for method in theirs}
        orders = [_write_order(one) for one in (ours, theirs)]
        counts = "/".join(str(pairs.count(word)) for word in ("agree", "differ", "undecided"))
        lines.append([part, f"`{write_condition(condition)}`", *orders, counts])
        every += pairs
    varied = study.column.replace("_", " ")
    return pd.DataFrame(lines, columns=["part", varied, "here", "paper", "agree/differ/undecided"]), every


def _write_order(values: Mapping[str, float]) -> str:
    ranked = sorted(values, key=lambda method: -values[method])
    return ", ".join(f"{method} {values[method]:.3f}" for method in ranked)
