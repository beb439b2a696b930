"""Print the tables of an evaluation as Markdown. The text around them is `evaluation.md.jinja`."""

from collections.abc import Iterable, Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

__all__ = ["evaluation_tables"]

# The parameters for what a method reads and how much it keeps; the evaluation file has all of them.
_SHOWN = (
    "taps",
    "layers",
    "grid_tap",
    "channels",
    "dims",
    "rank",
    "neighbours",
    "block",
    "window_mm",
    "sigma",
)


def evaluation_tables(evaluation: dict[str, Any]) -> str:
    """Return a Markdown table per set: rows of backbone and detector, columns of measures with intervals."""
    environment = Environment(
        loader=PackageLoader("calibration.experiments.backbones", ""),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"columns": _columns, "interval": _interval, "listed": _list_shown}
    return environment.get_template("evaluation.md.jinja").render(evaluation=evaluation)


def _columns(measures: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return every measure that a row has, in the order of their first row."""
    return list(dict.fromkeys(name for row in measures for name in row))


def _list_shown(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {_short(settings[name])}" for name in _SHOWN if settings.get(name) is not None)


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return " and ".join(map(str, value)) or "all"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _interval(measure: Mapping[str, Any] | None) -> str:
    if measure is None or measure["value"] is None:
        return "-"
    span = measure.get("over_images")
    return f"{measure['value']:.3f}" + (f" ({span[0]:.3f} to {span[1]:.3f})" if span else "")
