"""The seed paper's published numbers, from `published.json`, to be printed next to those of the rows."""

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

__all__ = ["paper_medians", "read_published", "stable_fraction"]


@cache
def read_published() -> Mapping[str, Any]:
    """Return what the paper says: its source, parts without a fixture (its Table 1), and judgements (Table 4)."""
    file = resources.files("calibration.experiments.harness").joinpath("published.json")
    paper: Mapping[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return paper


def stable_fraction(method: str) -> float | None:
    """Return the share of the nominal presses at which the paper fixes a method; None for one that it does not have."""
    fraction: float | None = read_published()["stable_fraction"].get(method)
    return fraction


@cache
def paper_medians(study: str) -> Mapping[tuple[str, str, str], Mapping[str, float]]:
    """Return by (method, part, measure) the paper's median at each condition of a study, such as `0.05` or `hr`."""
    return {
        (row["method"], row["part"], row["measure"]): row["values"]
        for row in read_published()["medians"]
        if row["study"] == study
    }
