"""Picks the most accurate point within limits, and says why."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from calibration.experiments.tradeoff.rows import Row
from edge.core.errors import ConfigError

__all__ = ["Limits", "Pick", "pick", "size", "time_ms"]

_UNITS_MS: Final = {"us": 1e-3, "ms": 1.0, "s": 1e3}
_UNITS_BYTES: Final = {"b": 1.0, "kb": 1e3, "mb": 1e6, "gb": 1e9}
_QUANTITY = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([a-zA-Z]+)\s*")


def time_ms(text: str) -> float:
    """Milliseconds of a text such as `20ms`. Errors: ConfigError."""
    return _quantity("--within", text, _UNITS_MS, "20ms")


def size(text: str) -> float:
    """Bytes of a text such as `8MB`. Errors: ConfigError."""
    return _quantity("--under", text, _UNITS_BYTES, "8MB")


def _quantity(option: str, text: str, units: dict[str, float], example: str) -> float:
    match = _QUANTITY.fullmatch(text)
    factor = units.get(match[2].lower()) if match else None
    if match is None or factor is None or float(match[1]) <= 0:
        raise ConfigError(
            f"{option} {text} is not understood; write a number above 0 and a unit ({', '.join(units)}), such as "
            f"{option} {example}"
        )
    return float(match[1]) * factor


@dataclass(frozen=True)
class Limits:
    """What a point may cost; None where there is no limit."""

    within_ms: float | None = None
    """The upper end of the interval of a press's median time."""
    under_bytes: float | None = None
    """The bank as stored."""
    presses: int | None = None
    """Nominal presses of the fit."""

    def excess(self, row: Row) -> dict[str, float]:
        """Return how many times over each limit the point is; only those that it exceeds."""
        found = {
            limit.name: limit.cost(row) / most
            for limit in _LIMITS
            if (most := getattr(self, limit.field)) is not None
        }
        return {name: times for name, times in found.items() if times > 1}

    def without(self, name: str) -> "Limits":
        """Return the limits without one."""
        fields = {limit.field: getattr(self, limit.field) for limit in _LIMITS if limit.name != name}
        return Limits(**fields)

    @property
    def names(self) -> list[str]:
        return [limit.name for limit in _LIMITS if getattr(self, limit.field) is not None]


@dataclass(frozen=True)
class _Limit:
    name: str
    field: str
    cost: Callable[[Row], float]
    text: Callable[[float], str]


_LIMITS: Final = (
    _Limit("time", "within_ms", lambda row: float(row["ms"]["high"]), lambda x: f"{x:.3g} ms"),
    _Limit("bank", "under_bytes", lambda row: float(row["bank_bytes"]), lambda x: f"{x / 1e6:.3g} MB"),
    _Limit("presses", "presses", lambda row: float(row["presses"]), lambda x: f"{x:.0f} presses"),
)


@dataclass(frozen=True)
class Pick:
    """row: the chosen point, None where nothing fits. reasons: sentences that explain it."""

    row: Row | None
    reasons: tuple[str, ...]


def pick(rows: Sequence[Row], limits: Limits) -> Pick:
    """The most accurate point within the limits (AU-PRO), the faster one among equals, and why.

    Peers have no bundle and are not chosen.
    """
    own = [row for row in rows if not row.get("peer") and _value(row) > -math.inf]
    fitting = [row for row in own if not limits.excess(row)]
    if not fitting:
        return Pick(None, tuple(_nothing(own, limits)))
    best = _best(fitting)
    return Pick(best, tuple(_why(own, fitting, best, limits)))


def _value(row: Row) -> float:
    value = row["accuracy"]["aupro_fpr01"]["value"]
    return -math.inf if value is None else float(value)


def _best(rows: Sequence[Row]) -> Row:
    return max(rows, key=lambda row: (_value(row), -row["ratio"]["median"]))


def _why(own: Sequence[Row], fitting: Sequence[Row], best: Row, limits: Limits) -> Iterator[str]:
    accuracy = best["accuracy"]["aupro_fpr01"]
    interval = "" if accuracy["low"] is None else f" ({accuracy['low']:.3f} to {accuracy['high']:.3f})"
    yield (
        f"{best['key']}: AU-PRO {accuracy['value']:.3f}{interval}, {best['ms']['median']:.3g} ms a press "
        f"({best['ms']['low']:.3g} to {best['ms']['high']:.3g}, p95 {best['ms']['p95']:.3g}), bank "
        f"{best['bank_bytes'] / 1e6:.3g} MB, {best['presses']} presses"
    )
    yield f"{len(fitting)} of {len(own)} points fit; this one is the most accurate of them"
    yield from _explain_refused(own, best, limits)
    binding = list(_binding(own, best, limits))
    yield from binding or ["no limit binds: without any of them the choice is the same"]
    others = [row for row in fitting if row is not best]
    if others:
        second = _best(others)
        yield f"the next that fits: {second['key']}, AU-PRO {_value(second):.3f}, {second['ms']['median']:.3g} ms"


def _explain_refused(own: Sequence[Row], best: Row, limits: Limits) -> Iterator[str]:
    """The more accurate points that are nearest to fitting."""
    better = [row for row in own if limits.excess(row) and _value(row) > _value(best)]
    for row in sorted(better, key=lambda row: max(limits.excess(row).values()))[:2]:
        yield f"nearer to perfect, but not within: {row['key']}, AU-PRO {_value(row):.3f}, {_too_much(row, limits)}"


def _binding(own: Sequence[Row], best: Row, limits: Limits) -> Iterator[str]:
    """The limits without which another point would be chosen."""
    for name in limits.names:
        freed = _best([row for row in own if not limits.without(name).excess(row)])
        if freed is not best:
            yield (
                f"the limit on {name} binds: without it {freed['key']} with AU-PRO {_value(freed):.3f} would be chosen "
                f"({_too_much(freed, limits)})"
            )


def _nothing(own: Sequence[Row], limits: Limits) -> Iterator[str]:
    if not own:
        yield "no point has a defined AU-PRO: there is nothing to choose from"
        return
    nearest = min(own, key=lambda row: (max(limits.excess(row).values()), -_value(row)))
    yield (
        f"none of {len(own)} points is within these limits; the nearest is {nearest['key']} with AU-PRO "
        f"{_value(nearest):.3f}: {_too_much(nearest, limits)}; widen a limit"
    )


def _too_much(row: Row, limits: Limits) -> str:
    excess = limits.excess(row)
    return ", ".join(
        f"{limit.text(limit.cost(row))} where {limit.text(getattr(limits, limit.field))} is allowed"
        for limit in _LIMITS
        if limit.name in excess
    )
