"""The page and the picture of a run, made from rows alone."""

import re
from typing import Any
from xml.etree import ElementTree

import pytest
from tradeoff_rows import row, rows_of_a_run

from calibration.experiments.tradeoff.figure import figure, svg
from calibration.experiments.tradeoff.page import page, table, view_name


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


def test_the_page_has_every_point_with_its_command_and_hash(rows: list[dict[str, Any]]) -> None:
    """As written in the rows."""
    text = page(rows)
    assert all(f'"key":"{one["key"]}"' in text for one in rows)
    assert all(one["command"] in text for one in rows)
    assert rows[0]["content_sha256"] in text


def test_a_point_without_accuracy_is_no_error(rows: list[dict[str, Any]]) -> None:
    """It is in the data as null, and the picture leaves it out."""
    undefined = row("none.t", None, dominated_by=[], is_on_front=False)
    text = page([*rows, undefined])
    assert "null" in text
    assert figure([*rows, undefined]).axes


def test_the_picture_is_small_and_the_same_every_time(rows: list[dict[str, Any]]) -> None:
    """Well-formed SVG below 300 kB without a date."""
    drawn = svg(rows)
    assert drawn == svg(rows)
    assert len(drawn) < 300_000
    assert ElementTree.fromstring(drawn).tag.endswith("svg")
    assert b"date" not in drawn.lower()


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


def test_the_table_lists_the_front_fastest_first(rows: list[dict[str, Any]]) -> None:
    """One line per point on the front, and a heading."""
    front = [one for one in rows if one["is_on_front"]]
    lines = table(rows).splitlines()
    assert len(lines) == len(front) + 1
    assert lines[1].startswith(min(front, key=lambda one: one["ms"]["median"])["key"])


def test_a_busy_machine_is_named(rows: list[dict[str, Any]]) -> None:
    """Milliseconds of a run next to other work are not those of the machine: page and picture say so."""
    busy = [one | {"machine": one["machine"] | {"load_at_start": 15.5}} for one in rows]
    sentence = "The machine was busy (load 15.5 on 2 cores)"
    assert sentence in page(busy)
    assert sentence in " ".join(text.get_text() for text in figure(busy).texts)
    assert "was busy" not in page(rows)


def test_a_view_has_a_name_for_people() -> None:
    """Size, and the overlap of tiles."""
    assert view_name("lr") == "224x224"
    assert view_name("hr_tiles_56") == "896x672 in tiles, overlap 56"
