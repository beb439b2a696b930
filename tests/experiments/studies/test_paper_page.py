"""The page that compares the studies with the paper: orders, directions and levels from rows and published data."""

from pathlib import Path
from typing import Any

import pandas as pd

from calibration.experiments.harness.published import paper_medians
from calibration.experiments.studies.paper_page import page
from calibration.experiments.studies.report import write_report

PAPER = paper_medians("resolution")
METHODS = ("spade", "padim", "fapm", "inreach")


def rows(*, sign: int = 1, seeds: int = 3, parts: tuple[str, ...] = ("PZ3",)) -> pd.DataFrame:
    """The resolution study as the paper has it, 0.1 higher; sign -1 turns every order and direction around."""
    found: list[dict[str, Any]] = []
    for part in parts:
        for method in METHODS:
            for view, name in (("lr", "lr"), ("hr_tiled", "hr")):
                for seed in range(seeds):
                    values = {
                        measure: 0.1 + sign * PAPER[method, part, measure][name] + 1e-5 * seed
                        for measure in ("aupro_001", "auprc", "pixel_auroc")
                    }
                    found.append(
                        {
                            "key": f"{part}{method}{view}{seed}", "study": "resolution", "part": part, "method": method,
                            "backbone": "tiny", "mode": "corrected", "split": "press", "seed": seed, "view": view,
                            "position": "pos1", "most_presses": 40, "held_out": 20, "presses": 22, "bank_bytes": 1,
                            "cpu_fit_s": 1.0, "cpu_score_s": 1.0, "cpu_measure_s": 1.0, **values,
                            **{f"{measure}_common": value for measure, value in values.items()},
                        }
                    )  # fmt: skip
    return pd.DataFrame(found)


def test_the_same_results_agree() -> None:
    """Every pair of methods has the paper's order, every direction is the paper's, and parts 0.1 higher are easier."""
    text = page(rows()).text

    assert "Of all pairs of methods: 12 agree, 0 differ, 0 undecided." in text
    assert "Of all directions: 12 agree, 0 differ, 0 undecided." in text
    assert "| PZ3 | `lr` | AU-PRO@0.01 | 0.361 | 0.261 | +0.100 | easier |" in text


def test_the_summary_counts_every_setup() -> None:
    """One setup agrees, another differs; the least and the most found with all presses are next to the paper's."""
    full = rows()[lambda frame: frame["view"] == "lr"].assign(study="good-fraction", fraction=1.0, pool=110)
    alike, other = pd.concat([rows(), full]), pd.concat([rows(sign=-1), full.assign(aupro_001=0.05)])
    text = page(pd.concat([alike, other.assign(backbone="other")])).text

    assert (
        "| tiny, corrected, press | 18 agree, 0 differ, 0 undecided | 12 agree, 0 differ, 0 undecided |"
        in text
    )
    assert "| **all** | **18 agree, 12 differ, 6 undecided** | **12 agree, 12 differ, 0 undecided** |" in text
    assert "| PZ3 | 0.050, other, corrected, press | 0.361, tiny, corrected, press | 0.261 |" in text


def test_opposite_results_differ_and_are_listed() -> None:
    """Orders and directions turned around differ; each direction that differs has a line, and parts are harder."""
    text = page(rows(sign=-1)).text

    assert "Of all pairs of methods: 0 agree, 12 differ, 0 undecided." in text
    assert "Of all directions: 0 agree, 12 differ, 0 undecided." in text
    assert text.count("| differ |") == 12
    assert "| harder |" in text
    assert "| easier |" not in text


def test_few_seeds_decide_nothing() -> None:
    """With two seeds every order and direction is undecided."""
    text = page(rows(seeds=2)).text

    assert "Of all pairs of methods: 0 agree, 0 differ, 12 undecided." in text
    assert "Of all directions: 0 agree, 0 differ, 12 undecided." in text


def test_seeds_that_learn_the_same_presses_decide_nothing() -> None:
    """However many they are: with a pool of 22 presses each learns all of them."""
    text = page(rows(seeds=10).assign(most_presses=22)).text

    assert "Of all pairs of methods: 0 agree, 0 differ, 12 undecided." in text
    assert "Of all directions: 0 agree, 0 differ, 12 undecided." in text


def test_parts_that_the_paper_does_not_have_are_left_out(tmp_path: Path) -> None:
    """Rows of a part of one's own have no line; the page is still written, next to the study's."""
    own = rows().assign(part="valve", most_presses=40.0)
    assert "valve" not in page(own).text
    path = tmp_path / "rows.jsonl"
    path.write_text(own.assign(format=1).to_json(orient="records", lines=True))

    names = [written.name for written in write_report(path, tmp_path / "out")]
    assert names == ["resolution.md", "paper.md", "recommend.md", "time.md"]
    text = (tmp_path / "out" / "resolution.md").read_text()
    assert "at most 40 nominal presses" in text
    assert "| valve | tiny | corrected | press |" in text
    assert "the 24 cells of this table took 1 minute of one core" in text
