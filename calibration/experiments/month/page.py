"""The page of a month and its curves, from rows alone."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calibration.experiments.harness.figures import svg
from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.month.run import ARMS, NOT_ASKED, PASSES_DAMAGE, Row, is_early
from calibration.folders import write_atomically
from edge.core.binomial import rate_limits

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["figure", "page", "write_page"]

_LINES_OF: Final = {"frozen": ("#b93a5b", "-"), "learning": ("#1f5fa8", "--")}
_FROM_DAY: Final = 4
_MOST_FALSE: Final = 0.02
_INTRO: Final = """# A month on the line

A reference, printed by `gelgate lab month` from its rows: what goes wrong in a month of presses, day by day, at a
station whose bundle stays as it was fitted, and at one that learns from a person who answers a few questions a day.
"""
_WORLD: Final = """## What happens

Each part is random, fitted with 24 pieces (8 of them pressed twice) of one batch on a new gel. All sizes are assumed:

- **Gel.** A grain or a hair settles every 60 presses, and stays until it is wiped: each morning, and where the station
  says so. A scratch, a dent or a rubbed place comes every 400 presses and stays. The coat wears. In the middle of the
  month another gel is mounted, and where `gel_scar` or `gel_mark` is there again at the press after the gel was wiped,
  once a day at most, or each 100 presses. Each gel has a tint, a coat and a stiffness of its own.
- **Lamps** lose a fifth of their light. **Operator:** place (sd 0.15 mm), turn (1 degree) and depth (4 %) wander; the
  gel is free for 0.3 to 1.6 s between presses. **Batches:** every three days, relief up to 4 % and size up
  to 0.3 % different, tool marks of 1 to 3 um.
- **Damage.** 1 % of the pieces, of six kinds that the fit does not render; one piece in 500 is of another part.
- **The person** answers ten of the station's questions a day, one for each five presses where a day has fewer than 50;
  3 % of the answers are wrong. Nobody [carries the bundle over](gel.md#carry-a-bundle-over) to the other gel.

The station is real from the camera's bytes on, with its settings by default, without threads and with the line's clock;
messages go to memory. A press that it asks for again is made, up to three of a piece. A new bundle is a shadow the next
day, asked to take over in the morning and in the evening; as long as it
[waits](operations.md#the-page-at-the-station), no other one is learnt unless the station asks for it.

A piece counts by the verdict of its last press. A *false alarm* is a sound piece that does not pass in the end,
whatever the verdict is. An *escape* is a damaged piece, or one of another part, that passes.
"""


def write_page(rows: Sequence[Row], path: Path, figure_path: Path, command: str) -> None:
    """Write the page, and its figure beside it. Errors: GelgateError."""
    link = (
        Path(figure_path.name) if figure_path.parent == path.parent else figure_path.relative_to(path.parent)
    )
    write_atomically(figure_path, svg(figure(rows)).encode())
    write_atomically(path, page(rows, link.as_posix(), command).encode())


def page(rows: Sequence[Row], link: str, command: str) -> str:
    """Write Markdown. rows: of one set and number of presses. link: to the figure."""
    import pandas as pd

    every = pd.DataFrame(rows)
    arms = [every[every["arm"] == arm] for arm in ARMS]
    parts = ", ".join(map(str, sorted(every["part"].unique())))
    which = (
        f"{rows[0]['set']} parts {parts}: {rows[0]['month_presses']} presses in {rows[0]['days']} days each"
    )
    return "\n".join(
        [
            _INTRO,
            f"`{command}`: {which}; {every['cpu_s'].sum() / 60:.0f} minutes of one core.\n",
            f"![False alarms and escapes by day]({link})\n",
            markdown_table(["", *ARMS], [[name, *map(count, arms)] for name, count in _LINES.items()]),
            *(f"- `{arm}`: {what}." for arm, what in ARMS.items()),
            "\n## What escaped, what was blamed, what was said\n",
            markdown_table(["", *ARMS], [[name, *map(count, arms)] for name, count in _DETAILS.items()]),
            _WORLD.rstrip(),
            "",
        ]
    )


def _rate(own: "pd.DataFrame", what: str, among: str) -> str:
    wrong, of = int(own[what].sum()), int(own[among].sum())
    if not of:
        return "-"
    low, high = rate_limits(wrong, of)
    return f"{wrong} of {of} ({wrong / of:.1%}; {low:.1%} to {high:.1%})"


def _count_bad_days(own: "pd.DataFrame") -> str:
    days = own[own["day"] >= _FROM_DAY].groupby("day")[["false_alarms", "sound"]].sum()
    return f"{(days['false_alarms'] > _MOST_FALSE * days['sound']).sum()} of {len(days)}"


Count = Callable[["pd.DataFrame"], object]
"""Counts something in the rows of one station."""

_LINES: Final[Mapping[str, Count]] = {
    "false alarms": lambda own: _rate(own, "false_alarms", "sound"),
    "escapes": lambda own: _rate(own, "escapes", "not_sound"),
    "pieces that stay unsure": lambda own: own["unsure"].sum(),
    "pieces without a verdict": lambda own: own["no_verdict"].sum(),
    "presses asked for again": lambda own: own["pressed_again"].sum(),
    "gel wiped because the station said so": lambda own: own["wiped"].sum(),
    "gels used": lambda own: (1 + own.groupby("part")["gel"].max()).sum(),
    "presses that the person was asked about": lambda own: own["asked"].sum(),
    "answers that were wrong": lambda own: own["answered_wrongly"].sum(),
    f"days after the third with more than {_MOST_FALSE:.0%} false alarms": _count_bad_days,
    "days whose bundle states no promise": lambda own: own["promise"].isna().sum(),
    "days that end with a bundle not proven on the gel": lambda own: own["unproven"].notna().sum(),
    "nights with a new bundle, of those that it was asked for": lambda own: (
        f"{own['not_learnt'].isna().sum()} of {(own['not_learnt'] != NOT_ASKED).sum()}"
    ),
    "shadows that took over": lambda own: own["not_adopted"].isna().sum(),
}


def _list(counts: Counter[str]) -> str:
    return ", ".join(f"{what} {number}" for what, number in counts.most_common()) or "none"


def _count_refusals(own: "pd.DataFrame") -> Counter[str]:
    """Count why new bundles were not written, and shadows dropped."""
    counts: Counter[str] = Counter()
    for shadow, learnt in own[["not_adopted", "not_learnt"]].fillna(NOT_ASKED).to_numpy():
        if shadow != NOT_ASKED and not is_early(shadow):
            is_blind = PASSES_DAMAGE in shadow
            counts[f"a shadow that {'passes known damage' if is_blind else 'fails more'}"] += 1
        if learnt != NOT_ASKED:
            counts["a learnt one, not written"] += 1
    return counts


_DETAILS: Final[Mapping[str, Count]] = {
    "escaped": lambda own: _list(sum(map(Counter, own["escaped"]), Counter())),
    "cause of false alarms": lambda own: _list(sum(map(Counter, own["causes"]), Counter())),
    "alarms raised": lambda own: _list(sum(map(Counter, own["alarms"]), Counter())),
    "bundles refused": lambda own: _list(_count_refusals(own)),
}


def figure(rows: Sequence[Row]) -> "Figure":
    """Draw false alarms by day, the sum of escapes, and the questions' use, one line for each station."""
    import pandas as pd
    from matplotlib.figure import Figure

    names = ["sound", "false_alarms", "escapes", "unsure", "not_sound"]
    sums = pd.DataFrame(rows).groupby(["arm", "day"])[names].sum()
    made = Figure(figsize=(6.4, 6.6), layout="constrained", facecolor="white")
    panels = made.subplots(3, 1, sharex=True)
    for arm in ARMS:
        own, (colour, dashes) = sums.loc[arm], _LINES_OF[arm]
        style: dict[str, Any] = {"color": colour, "linestyle": dashes, "label": arm, "linewidth": 1.4}
        panels[0].plot(own.index, 100 * own["false_alarms"] / own["sound"].clip(lower=1), **style)
        panels[1].step(own.index, own["escapes"].cumsum(), where="post", **style)
        panels[2].plot(own.index, own["unsure"], **style)
    wrong, style = sums.loc["frozen", "not_sound"].cumsum(), {"color": "#8d8b84", "linewidth": 1}
    panels[1].step(wrong.index, wrong, where="post", label="damaged or wrong so far", **style)
    panels[0].axhline(100 * _MOST_FALSE, color="#8d8b84", linewidth=0.8, linestyle=":")
    titles = ("false alarms, % of sound pieces", "escapes so far", "pieces that stay unsure")
    changed = (rows[0]["days"] + 1) // 2 + 0.5
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=9, loc="left")
        panel.grid(alpha=0.3, linewidth=0.5)
        panel.set_ylim(bottom=0)
        panel.spines[["top", "right"]].set_visible(False)
        panel.axvline(changed, color="#22272b", linewidth=0.8, linestyle="--")
    panels[1].legend(fontsize=8, frameon=False)
    panels[2].set_xlabel("day; the dashed line: another gel")
    return made
