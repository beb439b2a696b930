"""The page in a real browser: headless Chromium."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import BROWSER_MS
from tradeoff_rows import rows_of_a_run

from calibration.experiments.tradeoff.front import list_front, verdict_ms
from calibration.experiments.tradeoff.page import FIRST, page


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """The page of a run, opened; at the end there was no message on the console and no error."""
    file = tmp_path / "tradeoff.html"
    file.write_text(page(rows_of_a_run()))
    tab = browser.new_page(viewport={"width": 1320, "height": 1000})
    tab.set_default_timeout(BROWSER_MS)
    said: list[str] = []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("request", lambda request: said.append(request.url) if request.url.startswith("http") else None)
    tab.goto(file.as_uri())
    yield tab
    tab.close()
    assert said == []


def test_a_point_under_the_pointer_shows_its_card(opened: Any) -> None:
    """Its command, its hash, its stages stacked, and its intervals."""
    in_one_piece = [row for row in rows_of_a_run() if row["view"] == "hr"]
    row = max(in_one_piece, key=lambda row: row["accuracy"][FIRST]["value"])  # no other point covers it
    assert row["command"] not in opened.locator("#card").inner_text()
    opened.locator(f'.point[data-key="{row["key"]}"] .mark').hover(force=True)
    card = opened.locator("#card")
    card.get_by_text(row["content_sha256"]).wait_for()
    assert row["command"] in card.inner_text()
    assert row["content_sha256"] in card.inner_text()
    assert card.locator(".stack i").count() == 3
    assert "896x672" in card.inner_text()


def test_a_filter_hides_points_and_all_come_back(opened: Any) -> None:
    """Without PaDiM only the others are drawn; the front is that of the points shown."""
    rows = rows_of_a_run()
    others = [row for row in rows if row["method"] != "padim"]
    opened.locator('#by-method input[value="padim"]').uncheck(force=True)
    assert opened.locator(".point").count() == len(others)
    assert opened.locator('.point[data-key^="padim."]').count() == 0
    assert opened.locator(".point.on-front").count() == len(list_front(others, FIRST))
    opened.get_by_role("button", name="Show all").click()
    opened.wait_for_function("n => document.querySelectorAll('.point').length === n", arg=len(rows))


def test_limits_hide_what_costs_more(opened: Any) -> None:
    """At most 19 ms, 4 MB and 10 presses; no point at all is a sentence."""
    opened.locator("#within").fill("19")
    opened.locator("#under").fill("4")
    opened.locator("#presses").fill("1")
    fitting = [
        row
        for row in rows_of_a_run()
        if verdict_ms(row) <= 19 and row["bank_bytes"] <= 4e6 and row["presses"] <= 10
    ]
    assert fitting
    assert opened.locator(".point").count() == len(fitting)
    opened.locator("#within").fill("0.001")
    assert "No point fits these filters" in opened.locator("#plot").text_content()
