"""Ours and the paper's results next to each other: order of the methods, direction of effects, level of the parts."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from calibration.experiments.harness.effects import (
    COMPARED,
    Agreement,
    Effect,
    agreement,
    count_agreements,
    direction,
    direction_of_paper,
    effects,
    medians,
    write_condition,
)
from calibration.experiments.harness.intervals import is_drawn
from calibration.experiments.harness.page import (
    Page,
    by_setup,
    directions_table,
    only_scored,
    percent,
    section,
    table,
)
from calibration.experiments.harness.published import paper_medians, source, stable_fraction
from calibration.experiments.harness.stable import stable_from
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
    names: dict[str, str]
    """Its conditions, ours to the paper's (empty: the same)."""
    shown: tuple[str | float, ...]
    """The conditions of ours at which orders and levels are compared."""
    steps: tuple[tuple[str | float, str | float, str], ...]
    """The effects that are compared, as pairs of our conditions."""

    def paper_name(self, ours: str | float) -> str:
        """Return what the paper's data call a condition of ours."""
        return self.names.get(write_condition(ours), write_condition(ours))


_STUDIES = (
    _Study(
        good_fraction_study.STUDY,
        "fraction",
        {},
        (0.05, 0.2, 1.0),
        ((0.05, 1.0, "all presses of the pool instead of a twentieth"),),
    ),
    _Study(
        cross_position_study.STUDY,
        "target_fraction",
        {},
        (0.0, 0.05),
        (
            (0.0, 0.05, "the first presses of a second position"),
            (0.05, 0.15, "more presses of the second position"),
        ),
    ),
    _Study(
        resolution_study.STUDY,
        "view",
        {"hr_tiled": "hr"},
        ("lr", "hr_tiled"),
        (("lr", "hr_tiled", "high resolution in tiles instead of low resolution"),),
    ),
)


def page(rows: "pd.DataFrame") -> Page:
    """The page. rows: of all studies."""
    introduction = [
        "# The paper's results and ours\n",
        f"{source()}: it pressed real parts and had Wide-ResNet-50-2 with ImageNet weights. So orders and directions "
        "can be compared, and levels say how hard the parts are. Nothing is tuned to agree. An order or a direction of "
        "ours is *undecided* where the 95 % interval of the mean difference over seeds includes zero, where there are "
        "fewer than three seeds, or where every seed learns the same presses.\n",
    ]
    scored, sections, counts = only_scored(rows), [], []
    every: tuple[list[Agreement], list[Agreement]] = [], []
    for title, group in by_setup(scored):
        orders: list[Agreement] = []
        directions: list[Agreement] = []
        found = [part for part in _setup(group, orders, directions) if part]
        if found:
            sections += [f"## {title}\n", *found]
            counts.append([_short(group), count_agreements(orders), count_agreements(directions)])
            every[0].extend(orders)
            every[1].extend(directions)
    counts.append(["**all**", *(f"**{count_agreements(group)}**" for group in every)])
    heading = ["setup", "orders of two methods", "directions of an effect"]
    summary = f"## Summary\n\n{table(heading, counts)}"
    return Page("\n".join([*introduction, summary, *_summary_of_levels(scored), *sections]))


def _short(rows: "pd.DataFrame") -> str:
    """The name of a setup without its weights."""
    return ", ".join(str(rows[name].iloc[0]) for name in ("backbone", "mode", "split"))


def _summary_of_levels(rows: "pd.DataFrame") -> Iterator[str]:
    """AU-PRO@0.01 of each part with all presses, in the setups that find least and most, next to the paper's."""
    lines, name = [], good_fraction_study.STUDY
    paper, full = paper_medians(name), rows[rows["study"] == name]
    full = full[full["fraction"] == 1.0] if "fraction" in full else full
    for part, group in full.groupby("part"):
        theirs = [
            values["1"] for key, values in paper.items() if key[1:] == (part, _MEASURE) and "1" in values
        ]
        ours = sorted(
            (float(own.groupby("method")[_MEASURE].median().mean()), _short(own))
            for _, own in by_setup(group)
        )
        if theirs:
            ends = [f"{level:.3f}, {setup}" for level, setup in (ours[0], ours[-1])]
            lines.append([part, *ends, f"{np.mean(theirs):.3f}"])
    if lines:
        yield (
            f"The level is {COMPARED[_MEASURE]} with all presses, the mean over the methods. Where the parts are "
            "simulated, masks are exact and a gel has few faults, while people drew the paper's masks on real presses. "
            "So all setups are compared: where even random weights are above the paper, the presses are easier, and "
            f"the trunk is not the reason.\n\n{table(['part', 'least here', 'most here', 'paper'], lines)}"
        )


def _setup(rows: "pd.DataFrame", orders: list[Agreement], directions: list[Agreement]) -> Iterator[str]:
    """The sections of one setup. orders, directions: every comparison is appended."""
    yield _plateaus(rows[rows["study"] == good_fraction_study.STUDY])
    for study in _STUDIES:
        group = rows[rows["study"] == study.name]
        if len(group):
            yield _orders(group, study, orders)
            yield _levels(group, study)
            yield from _effects(group, study, directions)


def _plateaus(rows: "pd.DataFrame") -> str:
    """The plateau of each method next to the paper's."""
    lines = []
    for method, group in rows.groupby("method"):
        ours = stable_from(group.astype(object).where(group.notna(), None).to_dict("records"))
        paper = stable_fraction(str(method))
        if ours is not None and paper is not None:
            word = "equal" if ours == paper else "earlier here" if ours < paper else "later here"
            lines.append([method, percent(ours), percent(paper), word])
    text = "### Plateau\n\nThe share of the nominal presses from which on accuracy stays the same."
    return section(text, ["method", "here", "paper", ""], lines)


def _orders(rows: "pd.DataFrame", study: _Study, orders: list[Agreement]) -> str:
    """The order of the methods at each part and condition, with the pairs that have the same order."""
    paper, lines = paper_medians(study.name), []
    every: list[Agreement] = []
    rows = rows[rows[study.column].isin(study.shown)]
    for (part, condition), group in rows.groupby(["part", study.column]):
        name = study.paper_name(condition)
        theirs = {
            method: paper[method, part, _MEASURE][name]
            for method in sorted(set(group["method"]))
            if name in paper.get((method, part, _MEASURE), {})
        }
        if len(theirs) < 2:
            continue
        pairs = list(_pairs(group, theirs))
        every += pairs
        ours = {m: float(group[group["method"] == m][_MEASURE].median()) for m in theirs}
        lines.append(
            [part, f"`{write_condition(condition)}`", _order(ours), _order(theirs), count_agreements(pairs)]
        )
    orders += every
    title = f"### {study.name}: order of the methods by {COMPARED[_MEASURE]}"
    heading = ["part", study.column.replace("_", " "), "here", "paper", "pairs"]
    return section(f"{title}\n\nOf all pairs of methods: {count_agreements(every)}.", heading, lines)


def _pairs(rows: "pd.DataFrame", theirs: dict[str, float]) -> Iterator[Agreement]:
    """Say whether each pair of methods has the paper's order."""
    seeds = {m: dict(zip(g["seed"], g[_MEASURE], strict=True)) for m, g in rows.groupby("method")}
    drawn = {row["method"] for row in rows.to_dict("records") if is_drawn(row)}
    for first, second in combinations(theirs, 2):
        ours, _ = direction(seeds[first], seeds[second], are_drawn=bool(drawn & {first, second}))
        yield agreement(ours, direction_of_paper(theirs[first], theirs[second]))


def _order(values: dict[str, float]) -> str:
    ranked = sorted(values, key=lambda method: -values[method])
    return ", ".join(f"{method} {values[method]:.3f}" for method in ranked)


def _levels(rows: "pd.DataFrame", study: _Study) -> str:
    """Say whether the simulated parts are easier or harder than the paper's, over the methods of both."""
    paper, ours, lines = paper_medians(study.name), medians(rows, study.column), []
    for part in sorted(set(rows["part"])):
        for condition in study.shown:
            for measure in COMPARED:
                pairs = [
                    (own[write_condition(condition)], paper[key][study.paper_name(condition)])
                    for key, own in ours.items()
                    if key[1:] == (part, measure)
                    and write_condition(condition) in own
                    and study.paper_name(condition) in paper.get(key, {})
                ]
                if pairs:
                    here, theirs = np.mean(pairs, axis=0)
                    word = "easier" if here > theirs else "harder"
                    shown = [f"{here:.3f}", f"{theirs:.3f}", f"{here - theirs:+.3f}"]
                    lines.append([part, f"`{write_condition(condition)}`", COMPARED[measure], *shown, word])
    heading = ["part", study.column.replace("_", " "), "measure", "here", "paper", "difference", "ours is"]
    text = f"### {study.name}: level of the parts\n\nMeans over the methods of the medians."
    return section(text, heading, lines)


def _effects(rows: "pd.DataFrame", study: _Study, directions: list[Agreement]) -> Iterator[str]:
    for before, after, title in study.steps:
        names = study.paper_name(before), study.paper_name(after)
        found = effects(rows, study.column, before, after, paper_medians(study.name), names)
        known = [effect for effect in found if effect.paper is not None]
        directions += [effect.agreement for effect in known if effect.agreement is not None]
        if known:
            yield f"### {study.name}: {title}\n\n{_differing(known)}"


def _differing(found: Sequence[Effect]) -> str:
    """The counts, and those of the effects that have another direction here."""
    counts = count_agreements(effect.agreement for effect in found)
    differ = [effect for effect in found if effect.agreement == "differ"]
    if differ:
        return f"Of all directions: {counts}. Those that differ:\n\n{directions_table(differ)}"
    return f"Of all directions: {counts}.\n"
