"""The stable fraction: by the rule from rows, the paper's own in paper mode, or the user's."""

from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from calibration.experiments.harness.evidence import STABLE_WITHIN, stable_from
from calibration.experiments.harness.published import paper_medians, stable_fraction
from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.study import Options
from edge.core.errors import ConfigError


def curve(means: dict[float, float], part: str = "PZ1", measure: str = "aupro_001") -> list[dict[str, Any]]:
    """Rows of two seeds around each mean."""
    return [
        {
            "key": f"{part} {measure} {fraction} {seed}",
            "study": "good-fraction",
            "method": "padim",
            "mode": "corrected",
            "backbone": "b",
            "split": "press",
            "part": part,
            "position": "pos1",
            "fraction": fraction,
            "seed": seed,
            measure: mean + (0.05 if seed else -0.05),
        }
        for fraction, mean in means.items()
        for seed in (0, 1)
    ]


def stable(rows: list[dict[str, Any]]) -> float | None:
    return stable_from(pd.DataFrame(rows))


def test_the_curve_is_flat_from_the_stable_fraction_on() -> None:
    """Every larger fraction is near the last mean; a lucky small one does not count."""
    near = STABLE_WITHIN / 2
    means = {0.1: 0.5, 0.2: 0.8, 0.3: 0.7, 0.4: 0.8 - near, 0.5: 0.8 + near, 1.0: 0.8}

    assert stable(curve(means)) == 0.4
    assert stable(curve({0.5: 0.1, 1.0: 0.8})) == 1.0


def test_the_rule_holds_for_all_parts_and_measures_together() -> None:
    """The slowest curve decides."""
    fast, slow = {0.1: 0.8, 0.5: 0.8, 1.0: 0.8}, {0.1: 0.2, 0.5: 0.8, 1.0: 0.8}

    assert stable(curve(fast)) == 0.1
    assert stable([*curve(fast), *curve(slow, part="PZ2")]) == 0.5
    assert stable([*curve(fast), *curve(slow, measure="pixel_auroc")]) == 0.5


def test_rows_of_the_folder_give_it(tmp_path: Path) -> None:
    """Of the method, mode and backbone; another split serves where its own is missing."""
    rows = Rows(tmp_path / "rows.jsonl")
    for row in curve({0.3: 0.8, 1.0: 0.8}):
        rows.append(row)

    asked = Options(tmp_path, tmp_path)
    assert asked.fraction_of("padim", "corrected", "b", "press") == 0.3
    assert asked.fraction_of("padim", "corrected", "b", "specimen") == 0.3
    for method, backbone in (("spade", "b"), ("padim", "other")):
        with pytest.raises(
            ConfigError, match=rf"stable fraction of {method} \(corrected, {backbone}\) is not known"
        ):
            asked.fraction_of(method, "corrected", backbone, "press")


def test_the_user_and_the_paper_come_first(tmp_path: Path) -> None:
    """In paper mode a method of the paper has the paper's share; a given one is for all."""
    asked = partial(Options, tmp_path, tmp_path / "absent")

    assert asked().fraction_of("padim", "paper", "b", "press") == stable_fraction("padim") == 0.4
    assert asked(fraction=0.7).fraction_of("padim", "paper", "b", "press") == 0.7


def test_the_published_numbers_are_complete() -> None:
    """Four methods on the parts of each study, with every condition; two numbers of its Tables 2 and 3."""
    crossed, fine, fraction = (
        paper_medians(study) for study in ("cross-position", "resolution", "good-fraction")
    )

    assert {part for _, part, _ in crossed} == {"PZ1", "PZ3"}
    assert {part for _, part, _ in fine} == {"PZ3", "PZ4", "PZ5"}
    assert {len(found) for found in (crossed, fine, fraction)} == {24, 36, 60}
    assert {tuple(values) for values in crossed.values()} == {("0", "0.05", "0.1", "0.15")}
    assert {len(values) for values in fraction.values()} == {20}
    assert crossed["spade", "PZ1", "pixel_auroc"]["0"] == 0.9562
    assert fine["fapm", "PZ5", "aupro_001"] == {"lr": 0.2462, "hr": 0.6764}
