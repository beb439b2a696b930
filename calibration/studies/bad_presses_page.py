"""The page of the bad-presses study, from its rows."""

from typing import TYPE_CHECKING

from calibration.studies.effects import COMPARED, effects, medians
from calibration.studies.page import Page
from calibration.studies.page_parts import (
    by_setup,
    cells_table,
    compared_table,
    cost_table,
    only_scored,
    refusals,
    seeds_of,
    split_table,
    table,
)

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]


def page(rows: "pd.DataFrame") -> Page:
    """The page. rows: of this study."""
    scored = only_scored(rows)
    head = (
        "# What do damaged presses among the nominal ones cost?\n\n"
        f"Parts {', '.join(sorted(rows['part'].unique()))}. Each bank is of a share of the nominal presses; damaged "
        f"presses take the place of some. Medians over {seeds_of(rows, 'bad')} seeds.\n"
    )
    setups = [_setup(title, group) for title, group in by_setup(scored)]
    sections = [head, cells_table(rows, "bad"), *setups, split_table(scored, "bad"), refusals(rows)]
    sections += [cost_table(scored, "bad", _percent)]
    return Page("\n".join(section for section in sections if section))


def _setup(title: str, rows: "pd.DataFrame") -> str:
    shares = sorted(rows["bad"].unique())
    conditions = [(f"{share:g}", "", _percent(share)) for share in shares]
    tables = [compared_table(medians(rows, "bad"), {}, measure, conditions) for measure in COMPARED]
    found = effects(rows, "bad", shares[0], shares[-1], {}, ("", ""), ("aupro_001",))
    lines = [[e.method, e.part, f"{e.difference:+.4f}", e.ours] for e in found]
    change = f"Change of AU-PRO@0.01 from {_percent(shares[0])} to {_percent(shares[-1])}.\n"
    heading = ["method", "part", "mean difference", "direction"]
    used = ", ".join(f"{m} {_percent(g['fraction'].max())}" for m, g in rows.groupby("method"))
    share = f"Share of the nominal presses: {used}.\n"
    return "\n".join([f"## {title}\n", share, *tables, change, table(heading, lines)])


def _percent(share: float) -> str:
    return f"{100 * share:g} %"
