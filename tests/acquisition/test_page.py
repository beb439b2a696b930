"""docs/acquire.md shows the table that the measured rows give."""

from pathlib import Path

import numpy as np
import pytest
from acquisition_tables import FRESH, read_rows, seen_as_broken, tables

PAGE = Path(__file__).resolve().parents[2] / "docs" / "acquire.md"


def test_the_page_has_the_measured_table() -> None:
    """Every line, of a thousand acquisitions of twenty parts, each once."""
    found = read_rows()
    assert "\n".join(tables(found)[0]) in PAGE.read_text(encoding="utf-8")
    assert len(found) == len({(row["design"], row["part"], row["order"]) for row in found}) == 1000
    assert len({row["part"] for row in found}) == 20


def test_an_exact_promise_is_seen_as_broken_by_chance() -> None:
    """The closed form against the same thing drawn: of 22 and 100 equal presses, ten or more lie above all the 22."""
    learnt, fresh = np.split(np.random.default_rng(0).random((20_000, 22 + FRESH)), [22], axis=1)
    drawn = np.mean((fresh > learnt.max(axis=1, keepdims=True)).mean(axis=1) > 0.0994)

    assert seen_as_broken(22, 0.0994) == pytest.approx(drawn, abs=0.01)
    assert seen_as_broken(0, 0.1) == 1.0
