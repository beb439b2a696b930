"""docs/acquire.md shows the table that the measured rows give."""

from pathlib import Path

import numpy as np
import pytest
from acquisition_tables import FRESH, read_rows, seen_as_broken, tables

PAGE = Path(__file__).resolve().parents[2] / "docs" / "acquire.md"


def test_the_page_has_the_measured_table() -> None:
    """Every line; after another run the page is not what was measured until it is changed."""
    assert "\n".join(tables(read_rows())[0]) in PAGE.read_text(encoding="utf-8")


def test_the_rows_are_a_thousand_acquisitions_of_twenty_parts() -> None:
    """Each once."""
    found = read_rows()
    assert len(found) == len({(row["design"], row["part"], row["order"]) for row in found}) == 1000
    assert len({row["part"] for row in found}) == 20


def test_an_exact_promise_is_seen_as_broken_by_chance() -> None:
    """The closed form against the same thing drawn: of 22 and 100 equal presses, ten or more lie above all the 22."""
    learnt, fresh = np.split(np.random.default_rng(0).random((20_000, 22 + FRESH)), [22], axis=1)
    drawn = np.mean((fresh > learnt.max(axis=1, keepdims=True)).mean(axis=1) > 0.0994)

    assert seen_as_broken(22, 0.0994) == pytest.approx(0.125, abs=0.002)
    assert seen_as_broken(22, 0.0994) == pytest.approx(drawn, abs=0.01)


def test_without_a_press_a_promise_is_always_seen_as_broken() -> None:
    """And a promise of one half from 22 presses nearly never."""
    assert seen_as_broken(0, 0.1) == 1.0
    assert seen_as_broken(22, 0.5) < 1e-4
