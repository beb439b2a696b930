"""The page of the cross-position study, from its rows."""

from functools import partial
from typing import TYPE_CHECKING

from calibration.studies.cross_position_study import STUDY
from calibration.studies.effects import COMPARED, effects, medians
from calibration.studies.figures import shares_figure, svg
from calibration.studies.page import Page
from calibration.studies.page_parts import (
    by_setup,
    cells_table,
    compared_table,
    cost_table,
    effects_table,
    figure_name,
    only_scored,
    paper_note,
    refusals,
    seeds_of,
    split_table,
    table,
)
from calibration.studies.published import published

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]

_ALONE = ("aupro_001_source", "aupro_001_target")


def page(rows: "pd.DataFrame") -> Page:
    """The page. rows: of this study."""
    scored = only_scored(rows)
    setups = list(by_setup(scored))
    figures = {figure_name(STUDY, group): partial(_figure, group) for _, group in setups}
    sections = [_head(rows), cells_table(rows, "target_fraction")]
    for (title, group), name in zip(setups, figures, strict=True):
        sections += [_setup(title, group), f"![{title}]({name})\n"]
    sections += [
        split_table(scored, "target_fraction"),
        refusals(rows),
        cost_table(scored, "target_fraction", _percent),
    ]
    return Page("\n".join(section for section in sections if section), figures)


def _figure(rows: "pd.DataFrame") -> str:
    label = "share of the second position's nominal presses, %"
    return svg(shares_figure(rows, "target_fraction", label))


def _head(rows: "pd.DataFrame") -> str:
    pairs = sorted(
        {(p, s, t) for p, s, t in zip(rows["part"], rows["position"], rows["target"], strict=True)}
    )
    where = "; ".join(f"{part}: {source} to {target}" for part, source, target in pairs)
    return (
        "# Does a bank of one position serve another?\n\n"
        f"{where}. Each bank has a method's stable fraction of the first position's nominal presses and a share of the "
        f"second's; {int(rows['held_out'].max())} nominal presses of each position and all defective ones are scored. "
        f"Medians over {seeds_of(rows, 'target_fraction')} seeds.\n\n{paper_note()}"
    )


def _setup(title: str, rows: "pd.DataFrame") -> str:
    paper, ours = published(STUDY), medians(rows, "target_fraction")
    shares = sorted(rows["target_fraction"].unique())
    conditions = [(f"{share:g}", f"{share:g}", _percent(share)) for share in shares]
    fractions = ", ".join(f"{m} {_percent(g['fraction'].max())}" for m, g in rows.groupby("method"))
    parts = [f"## {title}\n\nShare of the first position: {fractions}.\n"]
    parts += [compared_table(ours, paper, measure, conditions) for measure in COMPARED]
    for before, after in _steps(shares):
        names = f"{before:g}", f"{after:g}"
        found = effects(rows, "target_fraction", before, after, paper, names)
        parts.append(
            effects_table(found, f"From {_percent(before)} to {_percent(after)} of the second position")
        )
    return "\n".join([*parts, _each_alone(rows, shares)])


def _steps(shares: list[float]) -> list[tuple[float, float]]:
    """From none to the first share, and from there to the last."""
    pairs = list(zip(shares, [*shares[1:2], *shares[-1:]], strict=False))
    return [(before, after) for before, after in pairs if before < after]


def _each_alone(rows: "pd.DataFrame", shares: list[float]) -> str:
    """AU-PRO of each position alone: whether the second gains, and whether the first loses."""
    found = medians(rows, "target_fraction", _ALONE)
    lines = [
        [
            method,
            part,
            measure.rpartition("_")[2],
            *(f"{by[f'{s:g}']:.4f}" if f"{s:g}" in by else "-" for s in shares),
        ]
        for (method, part, measure), by in sorted(found.items())
    ]
    return "AU-PRO@0.01 of each position alone.\n\n" + table(
        ["method", "part", "position", *map(_percent, shares)], lines
    )


def _percent(share: float) -> str:
    return f"{100 * share:g} %"
