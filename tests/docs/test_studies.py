"""What docs/studies.md says is made from the rows in docs/studies."""

import re
from pathlib import Path

import pandas as pd
import pytest

from calibration.experiments.harness.rows import frame
from calibration.experiments.studies.paper_page import page as paper_page
from calibration.experiments.studies.recommend import page as recommend_page
from calibration.experiments.studies.report import PAGES

STUDIES = Path(__file__).resolve().parents[2] / "docs" / "studies"


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    return frame(STUDIES / "rows.jsonl")


@pytest.mark.parametrize("study", ["good-fraction", "cross-position", "resolution", "bad-presses"])
def test_a_study_s_page_can_be_made_from_its_rows(study: str, rows: pd.DataFrame) -> None:
    """`gelgate lab report docs/studies` writes it, with the figures that it names."""
    found = PAGES[study](rows[rows["study"] == study].dropna(axis=1, how="all"))

    assert set(re.findall(r"\]\(([^)]+\.svg)\)", found.text)) == set(found.figures)
    assert found.text.count("\n## ") >= 2


def test_the_comparison_with_the_paper_is_that_of_the_rows(rows: pd.DataFrame) -> None:
    """docs/studies.md has its summary as the rows give it; a step without a difference names none."""
    found = paper_page(rows).text
    summary = found.partition("## Summary\n")[2].partition("\n## ")[0].strip()

    assert "| **all** " in summary
    assert summary in (STUDIES.parent / "studies.md").read_text(encoding="utf-8")
    assert "mean difference" not in found.partition("## Summary")[2]


def test_the_recommendations_can_be_made_from_the_rows(rows: pd.DataFrame) -> None:
    """Each setup of the rows has its answers."""
    found = recommend_page(rows).text

    assert found.count("\n## ") == len(rows[["backbone", "mode", "split"]].drop_duplicates())
    assert "tactile_resnet18, corrected mode, split by press" in found
