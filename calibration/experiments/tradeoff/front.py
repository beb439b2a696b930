"""The Pareto front of accuracy and of the time that the line waits for, from rows alone."""

from collections.abc import Sequence
from typing import Final

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.tradeoff.rows import Row

__all__ = ["FIRST", "WAITED", "list_front", "table", "verdict_ms"]

FIRST: Final = "aupro_fpr01"
"""The measure by which the front is decided."""

MARGIN: Final = 0.05
"""A press that takes 5 % longer is not slower: stages of one run differ by about that."""

DIGITS: Final = 3
"""Accuracies that are printed alike are alike."""

WAITED: Final = ("decode", "trunk", "head")
"""The line waits for these stages. Rows of version 0.2.0 have the picture as well, which leaves after the verdict."""


def verdict_ms(row: Row) -> float:
    """Return the milliseconds from the settled frame to the verdict: the medians of the stages, added."""
    return sum(float(row["stages"][name]["median"]) for name in WAITED)


def list_front(rows: Sequence[Row]) -> list[Row]:
    """Return the points that no other one dominates, the fastest first; never one without accuracy.

    A point is dominated by one that is as accurate and faster, or more accurate and at most `MARGIN` slower.
    """
    points = [
        (row, round(value, DIGITS)) for row in rows if (value := row["accuracy"][FIRST]["value"]) is not None
    ]
    front = [
        row
        for row, value in points
        if not any(_dominates(other, better, row, value) for other, better in points)
    ]
    return sorted(front, key=verdict_ms)


def _dominates(other: Row, better: float, row: Row, value: float) -> bool:
    ms, limit_ms = verdict_ms(other), verdict_ms(row)
    return (better >= value and ms < limit_ms) or (better > value and ms <= limit_ms * (1 + MARGIN))


def table(rows: Sequence[Row]) -> str:
    """Write the points of the front, the fastest first."""
    heading = ["on the front", "AU-PRO", "interval", "ms to the verdict", *WAITED, "floor", "bank MB"]
    return markdown_table(heading, map(_list_costs, list_front(rows))).rstrip()


def _list_costs(row: Row) -> list[str]:
    accuracy = row["accuracy"][FIRST]
    interval = "-" if accuracy["low"] is None else f"{accuracy['low']:.3f} to {accuracy['high']:.3f}"
    stages = (row["stages"][name]["median"] for name in WAITED)
    times = [f"{ms:.1f}" for ms in (verdict_ms(row), *stages, row["floor"]["ms"])]
    return [row["key"], f"{accuracy['value']:.3f}", interval, *times, f"{row['bank_bytes'] / 1e6:.2f}"]
