"""The Pareto front of accuracy and of the time that the line waits for, and the best point within limits, from rows."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.harness.rows import read_rows as read_lines
from calibration.folders import write_atomically
from edge.core.errors import ConfigError

__all__ = [
    "FIRST",
    "WAITED",
    "Limits",
    "Row",
    "list_front",
    "only_known",
    "pick",
    "read_limits",
    "read_rows",
    "table",
    "value_of",
    "verdict_ms",
    "write_rows",
]

Row = dict[str, Any]


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write all rows or none; numbers with six digits. Errors: GelgateError."""
    write_atomically(path, "".join(json.dumps(_round(row), allow_nan=False) + "\n" for row in rows).encode())


def _round(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _round(one) for name, one in value.items()}
    return float(f"{value:.6g}") if isinstance(value, float) else value


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a finished run. Errors: ConfigError for a file without them."""
    rows = read_lines(path)
    # A study's rows have the same format number, and not these columns.
    if not rows or any("dataset_sha256" not in row for row in rows):
        raise ConfigError(
            f"'{path}' does not hold the rows of a trade-off; give the rows.jsonl of a finished run"
        )
    return rows


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


def only_known(rows: Iterable[Row]) -> list[Row]:
    """Leave out the points whose accuracy is undefined."""
    return [row for row in rows if row["accuracy"][FIRST]["value"] is not None]


def value_of(row: Row) -> float:
    """Return the accuracy of a point."""
    return float(row["accuracy"][FIRST]["value"])


def list_front(rows: Sequence[Row]) -> list[Row]:
    """Return the points that no other one dominates, the fastest first; never one without accuracy.

    A point is dominated by one that is as accurate and faster, or more accurate and at most `MARGIN` slower.
    """
    points = [(row, round(value_of(row), DIGITS)) for row in only_known(rows)]
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


_UNITS_MS: Final = {"us": 1e-3, "ms": 1.0, "s": 1e3}
_UNITS_MB: Final = {"b": 1e-6, "kb": 1e-3, "mb": 1.0, "gb": 1e3}
_QUANTITY = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([a-zA-Z]+)\s*")


def _quantity(option: str, text: str, units: dict[str, float], example: str) -> float:
    match = _QUANTITY.fullmatch(text)
    factor = units.get(match[2].lower()) if match else None
    if match is None or factor is None or float(match[1]) <= 0:
        raise ConfigError(
            f"{option} {text} is not understood; write a number above 0 and a unit ({', '.join(units)}), such as "
            f"{option} {example}"
        )
    return float(match[1]) * factor


Limits = Mapping[str, float]
"""What a point may cost at most, by the name of a cost."""

_COSTS: Final[Mapping[str, tuple[Callable[[Row], float], str]]] = {
    "time": (verdict_ms, "{:.3g} ms"),
    "bank": (lambda row: row["bank_bytes"] / 1e6, "{:.3g} MB"),
    "presses": (lambda row: float(row["presses"]), "{:.0f} presses"),
}
"""What a point costs: the median time to its verdict, the bank as stored, and presses of the fit."""


def read_limits(within: str | None, under: str | None, presses: int | None) -> Limits:
    """Return the limits of texts such as `20ms` and `8MB`. Errors: ConfigError."""
    given = {
        "time": within and _quantity("--within", within, _UNITS_MS, "20ms"),
        "bank": under and _quantity("--under", under, _UNITS_MB, "8MB"),
        "presses": presses,
    }
    return {name: float(most) for name, most in given.items() if most}


def _excess(row: Row, limits: Limits) -> dict[str, float]:
    """Return how many times over each limit the point is; only those that it exceeds."""
    ratios = {name: _COSTS[name][0](row) / most for name, most in limits.items()}
    return {name: times for name, times in ratios.items() if times > 1}


def pick(rows: Sequence[Row], limits: Limits) -> tuple[Row, list[str]]:
    """The most accurate point within the limits (AU-PRO), the faster one among equals, and sentences that explain it.

    Peers have no bundle and are not chosen. Errors: ConfigError where nothing fits.
    """
    own = [row for row in only_known(rows) if not row.get("peer")]
    if not own:
        raise ConfigError("no point has a defined AU-PRO: there is nothing to choose from")
    fitting = [row for row in own if not _excess(row, limits)]
    if not fitting:
        nearest = min(own, key=lambda row: (max(_excess(row, limits).values()), -value_of(row)))
        raise ConfigError(
            f"none of {len(own)} points is within these limits; the nearest is {nearest['key']} with AU-PRO "
            f"{value_of(nearest):.3f}: {_too_much(nearest, limits)}; widen a limit"
        )
    best = _best(fitting)
    return best, list(_why(own, fitting, best, limits))


def _best(rows: Sequence[Row]) -> Row:
    return max(rows, key=lambda row: (value_of(row), -verdict_ms(row)))


def _why(own: Sequence[Row], fitting: Sequence[Row], best: Row, limits: Limits) -> Iterator[str]:
    accuracy = best["accuracy"][FIRST]
    interval = "" if accuracy["low"] is None else f" ({accuracy['low']:.3f} to {accuracy['high']:.3f})"
    yield (
        f"{best['key']}: AU-PRO {value_of(best):.3f}{interval}, {verdict_ms(best):.3g} ms to the verdict, bank "
        f"{best['bank_bytes'] / 1e6:.3g} MB, {best['presses']} presses"
    )
    yield f"{len(fitting)} of {len(own)} points fit; this one is the most accurate of them"
    better = [row for row in own if _excess(row, limits) and value_of(row) > value_of(best)]
    for row in sorted(better, key=lambda row: max(_excess(row, limits).values()))[:2]:
        yield f"nearer to perfect, but not within: {row['key']}, AU-PRO {value_of(row):.3f}, {_too_much(row, limits)}"
    yield from list(_binding(own, best, limits)) or [
        "no limit binds: without any of them the choice is the same"
    ]
    others = [row for row in fitting if row is not best]
    if others:
        second = _best(others)
        yield f"the next that fits: {second['key']}, AU-PRO {value_of(second):.3f}, {verdict_ms(second):.3g} ms"


def _binding(own: Sequence[Row], best: Row, limits: Limits) -> Iterator[str]:
    """The limits without which another point would be chosen."""
    for name in limits:
        others = {other: most for other, most in limits.items() if other != name}
        freed = _best([row for row in own if not _excess(row, others)])
        if freed is not best:
            yield (
                f"the limit on {name} binds: without it {freed['key']} with AU-PRO {value_of(freed):.3f} would be "
                f"chosen ({_too_much(freed, limits)})"
            )


def _too_much(row: Row, limits: Limits) -> str:
    return ", ".join(
        f"{text.format(cost(row))} where {text.format(limits[name])} is allowed"
        for name, (cost, text) in _COSTS.items()
        if name in _excess(row, limits)
    )
