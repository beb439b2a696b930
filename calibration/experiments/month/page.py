"""The page of a month and its curves, from rows alone."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calibration.experiments.harness.figures import svg
from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.month.run import ARMS, NOT_ASKED, PASSES_DAMAGE, Row, is_early
from calibration.folders import write_atomically
from edge.core.binomial import rate_limits

if TYPE_CHECKING:
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
    days, presses = rows[0]["days"], rows[0]["month_presses"]
    parts = sorted({row["part"] for row in rows})
    which = f"{rows[0]['set']} parts {', '.join(map(str, parts))}: {presses} presses in {days} days each"
    minutes = sum(row["cpu_s"] for row in rows) / 60
    totals = [[name, *(count(_of(rows, arm)) for arm in ARMS)] for name, count in _LINES.items()]
    return "\n".join(
        [
            _INTRO,
            f"`{command}`: {which}; {minutes:.0f} minutes of one core.\n",
            f"![False alarms and escapes by day]({link})\n",
            markdown_table(["", *ARMS], totals),
            *(f"- `{arm}`: {what}." for arm, what in ARMS.items()),
            "\n## What escaped, what was blamed, what was said\n",
            markdown_table(["", *ARMS], _details(rows)),
            _WORLD.rstrip(),
            "",
        ]
    )


def _of(rows: Iterable[Row], arm: str) -> list[Row]:
    return [row for row in rows if row["arm"] == arm]


def _total(rows: Iterable[Row], name: str) -> int:
    return sum(int(row[name]) for row in rows)


def _rate(wrong: int, of: int) -> str:
    if not of:
        return "-"
    low, high = rate_limits(wrong, of)
    return f"{wrong} of {of} ({wrong / of:.1%}; {low:.1%} to {high:.1%})"


_LINES: Final[Mapping[str, Callable[[list[Row]], object]]] = {
    "false alarms": lambda own: _rate(_total(own, "false_alarms"), _total(own, "sound")),
    "escapes": lambda own: _rate(_total(own, "escapes"), _total(own, "not_sound")),
    "pieces that stay unsure": lambda own: _total(own, "unsure"),
    "pieces without a verdict": lambda own: _total(own, "no_verdict"),
    "presses asked for again": lambda own: _total(own, "pressed_again"),
    "gel wiped because the station said so": lambda own: _total(own, "wiped"),
    "gels used": lambda own: sum(
        1 + max(row["gel"] for row in own if row["part"] == part) for part in {row["part"] for row in own}
    ),
    "presses that the person was asked about": lambda own: _total(own, "asked"),
    "answers that were wrong": lambda own: _total(own, "answered_wrongly"),
    f"days after the third with more than {_MOST_FALSE:.0%} false alarms": lambda own: _count_bad_days(own),
    "days whose bundle states no promise": lambda own: sum(row["promise"] is None for row in own),
    "days that end with a bundle not proven on the gel": lambda own: sum(
        row["unproven"] is not None for row in own
    ),
    "nights with a new bundle, of those that it was asked for": lambda own: (
        f"{sum(row['not_learnt'] is None for row in own)} of {sum(row['not_learnt'] != NOT_ASKED for row in own)}"
    ),
    "shadows that took over": lambda own: sum(row["not_adopted"] is None for row in own),
}


def _count_bad_days(own: list[Row]) -> str:
    days = sorted({row["day"] for row in own if row["day"] >= _FROM_DAY})
    later = [[row for row in own if row["day"] == day] for day in days]
    bad = sum(_total(day, "false_alarms") > _MOST_FALSE * _total(day, "sound") for day in later)
    return f"{bad} of {len(later)}"


def _details(rows: Sequence[Row]) -> list[list[str]]:
    lines = []
    shown = {"escaped": "escaped", "causes": "cause of false alarms", "alarms": "alarms raised"}
    for name, what in shown.items():
        cells = []
        for arm in ARMS:
            counts: Counter[str] = sum((Counter(row[name]) for row in _of(rows, arm)), Counter())
            cells.append(", ".join(f"{key} {number}" for key, number in counts.most_common()) or "none")
        lines.append([what, *cells])
    refused = [_list_refusals(_of(rows, arm)) for arm in ARMS]
    return [*lines, ["bundles refused", *refused]]


def _list_refusals(own: list[Row]) -> str:
    """Count why new bundles were not written, and shadows dropped."""
    counts: Counter[str] = Counter()
    for row in own:
        shadow, learnt = row["not_adopted"], row["not_learnt"]
        if shadow not in (None, NOT_ASKED) and not is_early(shadow):
            counts[
                "a shadow that passes known damage" if PASSES_DAMAGE in shadow else "a shadow that fails more"
            ] += 1
        if learnt not in (None, NOT_ASKED):
            counts["a learnt one, not written"] += 1
    return ", ".join(f"{what} {number}" for what, number in counts.most_common()) or "none"


def figure(rows: Sequence[Row]) -> "Figure":
    """Draw false alarms by day, the sum of escapes, and the questions' use, one line for each station."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(6.4, 6.6), layout="constrained", facecolor="white")
    panels = made.subplots(3, 1, sharex=True)
    days = np.arange(1, rows[0]["days"] + 1)
    for arm in ARMS:
        own = [[row for row in _of(rows, arm) if row["day"] == day] for day in days]
        sound = np.array([_total(one, "sound") for one in own])
        false = np.array([_total(one, "false_alarms") for one in own])
        escapes = np.cumsum([_total(one, "escapes") for one in own])
        unsure = np.array([_total(one, "unsure") for one in own])
        colour, dashes = _LINES_OF[arm]
        style: dict[str, Any] = {"color": colour, "linestyle": dashes, "label": arm, "linewidth": 1.4}
        panels[0].plot(days, 100 * false / np.maximum(sound, 1), **style)
        panels[1].step(days, escapes, where="post", **style)
        panels[2].plot(days, unsure, **style)
    not_sound = np.cumsum(
        [_total([r for r in _of(rows, "frozen") if r["day"] == d], "not_sound") for d in days]
    )
    panels[1].step(
        days, not_sound, where="post", color="#8d8b84", linewidth=1, label="damaged or wrong so far"
    )
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
