"""The seed paper's published numbers, from `published.json`, to be printed next to those of the rows."""

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

__all__ = ["judgements", "no_fixture", "paper_medians", "source", "stable_fraction"]


@cache
def _data() -> Mapping[str, Any]:
    text = (
        resources.files("calibration.experiments.harness")
        .joinpath("published.json")
        .read_text(encoding="utf-8")
    )
    found: Mapping[str, Any] = json.loads(text)
    return found


def source() -> str:
    """The paper's title and where it was published."""
    return str(_data()["source"])


def stable_fraction(method: str) -> float | None:
    """The share of the nominal presses at which the paper fixes a method; None for a method that it does not have."""
    found = _data()["stable_fraction"].get(method)
    return None if found is None else float(found)


def no_fixture() -> tuple[str, ...]:
    """The parts that the paper presses without a fixture (its Table 1)."""
    return tuple(_data()["no_fixture"])


def judgements(column: str) -> Mapping[str, str]:
    """Return what the paper says of each method in a column of its Table 4, such as `strong advantage`."""
    found: Mapping[str, str] = _data()["judgements"][column]
    return found


@cache
def paper_medians(study: str) -> Mapping[tuple[str, str, str], Mapping[str, float]]:
    """(method, part, measure) to the paper's median at each condition of a study, such as `0.05` or `hr`."""
    return {
        (row["method"], row["part"], row["measure"]): row["values"]
        for row in _data()["medians"]
        if row["study"] == study
    }
