"""The pages of docs/studies are made from the rows next to them, and their figures are small."""

import re
from pathlib import Path

import pandas as pd
import pytest
from scripts import load_script

from calibration.experiments.harness.page import Page
from calibration.experiments.harness.rows import frame
from calibration.experiments.studies.paper_page import page as paper_page
from calibration.experiments.studies.recommend import page as recommend_page
from calibration.experiments.studies.report import PAGES

PLACEMENT = load_script("docs/placement_page.py")
STUDIES = Path(__file__).resolve().parents[2] / "docs" / "studies"
MOST_BYTES = 300_000


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    return frame(STUDIES / "rows.jsonl")


def of(rows: pd.DataFrame, study: str) -> Page:
    return PAGES[study](rows[rows["study"] == study].dropna(axis=1, how="all"))


@pytest.mark.parametrize("study", ["good-fraction", "cross-position", "resolution", "bad-presses"])
def test_a_study_s_page_is_that_of_its_rows(study: str, rows: pd.DataFrame) -> None:
    """The committed page is what `gelgate lab report` writes, and every figure that it names is there."""
    found = of(rows, study)

    assert (STUDIES / f"{study}.md").read_text(encoding="utf-8") == found.text
    assert {name for name in found.figures if not (STUDIES / name).is_file()} == set()


def test_the_comparison_with_the_paper_is_that_of_the_rows(rows: pd.DataFrame) -> None:
    assert (STUDIES / "paper.md").read_text(encoding="utf-8") == paper_page(rows).text


def test_the_recommendations_are_those_of_the_rows(rows: pd.DataFrame) -> None:
    assert (STUDIES / "recommend.md").read_text(encoding="utf-8") == recommend_page(rows).text


def test_the_page_about_placement_is_that_of_its_rows() -> None:
    """The same part in a fixture and by hand."""
    fixture, by_hand = (frame(STUDIES / "placement" / name / "rows.jsonl") for name in ("fixture", "by_hand"))

    assert (STUDIES / "placement.md").read_text(encoding="utf-8") == PLACEMENT.page(fixture, by_hand)


def test_every_picture_is_small_and_shown() -> None:
    shown = set(
        re.findall(
            r"\]\(([^)]+\.svg)\)", "".join(p.read_text(encoding="utf-8") for p in STUDIES.glob("*.md"))
        )
    )

    assert {path.name for path in STUDIES.glob("*.svg")} == shown
    assert max(path.stat().st_size for path in STUDIES.glob("*.svg")) <= MOST_BYTES
