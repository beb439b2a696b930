"""docs/acquire.md shows the tables that the measured rows give."""

from pathlib import Path

import pytest
from acquisition_tables import read_rows, tables

PAGE = Path(__file__).resolve().parents[2] / "docs" / "acquire.md"


@pytest.mark.parametrize("which", [0, 1])
def test_the_page_has_the_measured_tables(which: int) -> None:
    """Every line; after another run the page is not what was measured until it is changed."""
    assert "\n".join(tables(read_rows())[which]) in PAGE.read_text(encoding="utf-8")


def test_the_rows_are_a_thousand_acquisitions_of_twenty_parts() -> None:
    """Each once."""
    found = read_rows()
    assert len(found) == len({(row["design"], row["part"], row["order"]) for row in found}) == 1000
    assert len({row["part"] for row in found}) == 20
