"""The page and the picture of a run, made from rows alone."""

import re
from typing import Any

import pytest
from tradeoff_rows import row, rows_of_a_run

from calibration.experiments.tradeoff.figure import figure
from calibration.experiments.tradeoff.page import page


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return rows_of_a_run()


def test_the_page_is_one_small_file_without_network(rows: list[dict[str, Any]]) -> None:
    """Below 1 MB, nothing is loaded, and its policy forbids to load anything."""
    text = page(rows)
    assert len(text.encode()) < 1_000_000
    assert not re.search(r"(src|href)=[\"'](?!data:)", text)
    assert set(re.findall(r"https?://[^\"'\s<]+", text)) <= {"http://www.w3.org/2000/svg"}
    assert "default-src 'none'" in text


def test_a_row_cannot_end_the_script(rows: list[dict[str, Any]]) -> None:
    """A name with a closing tag stays data."""
    text = page([rows[0] | {"note": "</script><b>", "dominated_by": []}])
    assert "</script><b>" not in text
    assert "\\u003c/script>" in text


def test_a_point_without_accuracy_is_no_error(rows: list[dict[str, Any]]) -> None:
    """It is in the data as null, and the picture leaves it out."""
    undefined = row("none.t", None, dominated_by=[], is_on_front=False)
    text = page([*rows, undefined])
    assert "null" in text
    assert figure([*rows, undefined]).axes


def test_the_picture_fits_its_points_and_names_the_front(rows: list[dict[str, Any]]) -> None:
    """The axis begins at the fastest point, however fast the machine could be; each point of the front has its name."""
    axes = figure(rows).axes[0]
    low, high = axes.get_xlim()
    assert (
        0.8 * min(one["ms"]["low"] for one in rows)
        < low
        < high
        < 1.3 * max(one["ms"]["high"] for one in rows)
    )
    assert len(axes.texts) == sum(one["is_on_front"] for one in rows)
    assert {text.get_text() for text in axes.texts} == {"SPADE int8", "FAPM int8", "FAPM float32"}
