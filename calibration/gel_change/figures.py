"""The figures of a new gel as tables: the mean over parts of each way, with each method."""

from collections.abc import Sequence

import numpy as np

from calibration.gel_change.study import AGAIN, BEFORE, WAYS, Figures

__all__ = ["table"]


def table(figures: Sequence[Figures]) -> str:
    """Markdown: a section for each method, a row for each way."""
    methods = list(dict.fromkeys(one.method for one in figures))
    parts = len({one.part for one in figures})
    said = f"{parts} parts, each on two gels; means over parts, and the most that one part loses."
    return "\n".join(
        [said, *(line for method in methods for line in _of_method(figures, method)), "", *_words()]
    )


def _of_method(figures: Sequence[Figures], method: str) -> list[str]:
    head = f"| {method} | AU-PRO up to 1 % | lost to `{AGAIN}` | most lost | image AUROC | false alarms | detected |"
    own = [one for one in figures if one.method == method]
    rows = [_row(own, way) for way in WAYS if any(one.way == way for one in own)]
    return ["", head, "|---|---|---|---|---|---|---|", *rows]


def _row(own: Sequence[Figures], way: str) -> str:
    rows = [one for one in own if one.way == way]
    again = {one.part: one.aupro for one in own if one.way == AGAIN}
    lost = [
        reference - one.aupro
        for one in rows
        if one.aupro is not None and (reference := again.get(one.part)) is not None
    ]
    cells = [
        _mean([one.aupro for one in rows]),
        "-" if way in (BEFORE, AGAIN) or not lost else f"{np.mean(lost):+.3f}",
        "-" if way in (BEFORE, AGAIN) or not lost else f"{max(lost):+.3f}",
        _mean([one.auroc for one in rows]),
        _mean([one.false_alarms for one in rows]),
        _mean([one.detected for one in rows]),
    ]
    return f"| {way} | {' | '.join(cells)} |"


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.3f}" if known else "-"


def _words() -> list[str]:
    return [f"- `{way}`: {what}." for way, what in WAYS.items()]
