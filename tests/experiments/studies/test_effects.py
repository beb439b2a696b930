"""Effects here and in the paper: directions by the interval over seeds, and pages of the data's numbers alone."""

import re
from typing import Any

import pytest

pd = pytest.importorskip("pandas", reason="SKIPPED, NOT TESTED: the extra `studies` brings pandas")

from calibration.experiments.harness.evidence import Sample, compare_directions, direction, effects  # noqa: E402
from calibration.experiments.studies import resolution_study  # noqa: E402
from calibration.experiments.studies.resolution_study import VIEWS  # noqa: E402


def changes(values: list[float], *, are_drawn: bool = True) -> Sample:
    return {("PZ1", seed): (value, are_drawn) for seed, value in enumerate(values)}


def test_a_direction_is_sure_or_undecided() -> None:
    """The interval of the paired difference decides."""
    rising = [0.01 + 0.001 * seed for seed in range(10)]

    assert direction(changes(rising)) == "up"
    assert direction(changes([-value for value in rising])) == "down"
    assert direction(changes([0.01, -0.01] * 5)) == "undecided"
    assert direction(changes([0.8, 0.8])) == "undecided"
    assert direction(changes(rising, are_drawn=False)) == "undecided"


def test_directions_agree_or_differ() -> None:
    """An undecided one does neither."""
    assert compare_directions("up", 0.1, 0.2) == ("up", "agree")
    assert compare_directions("up", 0.2, 0.1) == ("down", "differ")
    assert compare_directions("undecided", 0.1, 0.2) == ("up", "undecided")
    assert compare_directions("up", 0.5, 0.5) == ("undecided", "undecided")


def rows(study: str, condition: str, levels: dict[Any, float], **more: Any) -> "pd.DataFrame":
    """Four methods on PZ3, ten seeds; a condition has its level, AU-PRO of seed 0 is lowest."""
    same = {"study": study, "part": "PZ3", "position": "pos1", "mode": "corrected", "backbone": "tiny"}
    same |= {"split": "press", "held_out": 20, "fraction": 0.5, "presses": 9, "bank_bytes": 1e6}
    same |= {"weights": "random", "cpu_fit_s": 1.0, "cpu_score_s": 2.0, "cpu_measure_s": 3.0, "error": None}
    measures = [f"{measure}{end}" for measure in ("aupro_001", "auprc", "pixel_auroc") for end in ENDS]
    return pd.DataFrame(
        {**same, **more, "method": method, "seed": seed, condition: value}
        | dict.fromkeys(measures, level + seed / 1e4)
        for method in ("spade", "padim", "fapm", "inreach")
        for value, level in levels.items()
        for seed in range(10)
    )


ENDS = ("", "_source", "_target", "_common")
CROSSED = rows("cross-position", "target_fraction", {0.0: 0.2, 0.05: 0.6, 0.15: 0.6}, target="pos2")
FINE = rows("resolution", "view", dict(zip(VIEWS, (0.3, 0.5, 0.4, 0.5, 0.3), strict=True)), most_presses=40)


def test_effects_are_set_next_to_the_papers() -> None:
    """Ours rises everywhere; the paper's AU-PRO of SPADE and InReaCh on PZ3 falls."""
    found = effects(CROSSED, "target_fraction", 0.0, 0.05)
    differing = found[found["direction"] == "differ"]

    assert set(found["here"]) == {"up"}
    assert set(zip(differing["method"], differing["measure"], strict=True)) == {
        ("spade", "AU-PRO@0.01"),
        ("inreach", "AU-PRO@0.01"),
    }


def test_seeds_that_learn_the_same_presses_give_no_direction() -> None:
    """With the cap of the pool as many as are learnt, ten seeds are one bank."""
    text = resolution_study.page(FINE.assign(presses=40)).text

    assert "0 agree, 0 differ, 12 undecided" in text
    assert re.search(r"\| \+0\.1000 +\| undecided +\|", text)
