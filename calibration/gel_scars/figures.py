"""The figures of simulated worn gels: which cause the alarms were given, with exact binomial intervals."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from calibration.gel_scars.runs import Alarm, Truth
from edge.core.binomial import rate_limits
from edge.core.gel_scars.causes import Cause

__all__ = ["MEANINGS", "Rate", "rate", "table"]

MEANINGS: Final[dict[Truth, str]] = {
    "scar": "a scar, the part is sound",
    "damage": "damage, without it the press passes",
    "both": "a scar and damage, each alone",
    "wear": "ordinary wear, the part is sound",
}
"""What raised an alarm, in words."""


@dataclass(frozen=True)
class Rate:
    """number of `of`, and the limits of the rate: each is crossed with a probability of 10 % at most."""

    number: int
    of: int
    low: float
    high: float

    def __str__(self) -> str:
        share = f"{self.number / self.of:.1%}" if self.of else "-"
        return f"{share} ({self.number} of {self.of}; {self.low:.1%} to {self.high:.1%})"


def rate(number: int, of: int) -> Rate:
    """Clopper and Pearson, one-sided at 90 % each way. Without trials nothing is known: 0 to 1."""
    if of == 0:
        return Rate(0, 0, 0.0, 1.0)
    return Rate(number, of, *rate_limits(number, of))


def table(alarms: Sequence[Alarm], presses: int) -> str:
    """Markdown: all alarms by what raised them, then scars and damage by placing, and by kind."""
    head = "| alarm raised by | alarms | `gel` | `unsure` | `part` |\n|---|---|---|---|---|"
    rows = [_row(MEANINGS[truth], [one for one in alarms if one.truth == truth]) for truth in MEANINGS]
    return "\n".join(
        [
            f"{presses} presses, {len(alarms)} alarms; limits hold with 90 % each.",
            "",
            head,
            *rows,
            "",
            *_named_gel("placing", alarms, lambda one: one.placing),
            "",
            *_named_gel("kind of damage, or scars so far", alarms, lambda one: one.what),
        ]
    )


def _row(name: str, alarms: Sequence[Alarm]) -> str:
    counts = Counter(one.cause for one in alarms)
    cells = [str(rate(counts[cause.value], len(alarms))) for cause in (Cause.GEL, Cause.UNSURE, Cause.PART)]
    return f"| {name} | {len(alarms)} | {' | '.join(cells)} |"


def _named_gel(what: str, alarms: Iterable[Alarm], key: Callable[[Alarm], str]) -> list[str]:
    """How many of the scar and of the damage alarms were named gel."""
    groups: dict[str, Counter[tuple[str, bool]]] = {}
    for one in alarms:
        groups.setdefault(key(one), Counter())[one.truth, one.cause == Cause.GEL] += 1
    rows = [f"| {what} | scar alarms named `gel` | damage alarms named `gel` |", "|---|---|---|"]
    for name in sorted(groups):
        found = groups[name]
        cells = [
            f"{found[truth, True]} of {found[truth, True] + found[truth, False]}"
            for truth in ("scar", "damage")
        ]
        rows.append(f"| {name} | {' | '.join(cells)} |")
    return rows
