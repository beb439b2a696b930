"""Verdicts."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.errors import NotScorable
from edge.core.imaging.quality import Reason, Rejection
from edge.core.printable import score_texts
from edge.core.verdict import Kind, Verdict, decide

finite = st.floats(-1e6, 1e6)


def test_the_four_kinds() -> None:
    """Below passes, above fails, near is unsure, a rejection carries its reason and no number."""
    assert decide(1.0, 2.0, 0.5) == Verdict(Kind.PASS, 1.0, 2.0, 0.5)
    assert decide(3.0, 2.0, 0.5).kind is Kind.FAIL
    assert decide(1.5, 2.0, 0.5).kind is Kind.UNSURE
    assert decide(2.5, 2.0, 0.5).kind is Kind.UNSURE
    rejection = Rejection(Reason.BLACK, "the frame is black")
    assert Verdict.rejected(rejection).rejection == rejection
    assert Verdict.rejected(rejection).score is None
    assert Verdict.rejected(rejection).kind is Kind.REJECTED


def test_a_score_at_the_threshold_passes() -> None:
    """The threshold is the largest score that nominal presses are allowed; the next number fails."""
    assert decide(2.0, 2.0).kind is Kind.PASS
    assert decide(math.nextafter(2.0, 3.0), 2.0).kind is Kind.FAIL


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_has_no_verdict(bad: float) -> None:
    """NaN compares false with everything and would pass or fail by the direction of a comparison."""
    with pytest.raises(NotScorable):
        decide(bad, 1.0)
    with pytest.raises(NotScorable):
        decide(1.0, bad)
    with pytest.raises(ValueError, match="tolerance"):
        decide(1.0, 1.0, bad)


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="tolerance"):
        decide(1.0, 1.0, -0.1)
    with pytest.raises(ValueError, match="finite"):
        Verdict(Kind.PASS, 1.0, math.nan, 0.0)
    with pytest.raises(ValueError, match="reverse"):
        Verdict(Kind.PASS)
    with pytest.raises(ValueError, match="reverse"):
        Verdict(Kind.REJECTED, 1.0, 1.0, 0.0, Rejection(Reason.BLACK, ""))


@given(finite, finite, st.floats(0, 1e3), st.floats(0, 1e3))
def test_a_higher_score_is_no_better(score: float, threshold: float, tolerance: float, more: float) -> None:
    """Pass, unsure, fail come in this order as the score rises."""
    order = [Kind.PASS, Kind.UNSURE, Kind.FAIL]
    lower, higher = decide(score, threshold, tolerance), decide(score + more, threshold, tolerance)
    assert order.index(lower.kind) <= order.index(higher.kind)


@pytest.mark.parametrize(
    ("score", "threshold", "digits", "form", "texts"),
    [
        (0.46953, 0.1, 4, "f", ("0.4695", "0.1000")),
        (1.00002, 1.0, 4, "f", ("1.00002", "1.00000")),
        (1.00002, 1.0, 4, "g", ("1.00002", "1")),
        (1.0021, 1.0, 2, "f", ("1.002", "1.000")),
        (1.0, 1.0, 2, "f", ("1.00", "1.00")),
        (math.nan, math.nan, 4, "f", ("nan", "nan")),
    ],
)
def test_a_score_is_written_with_the_digits_that_it_needs(
    score: float, threshold: float, digits: int, form: str, texts: tuple[str, str]
) -> None:
    """A fail never reads as its threshold; what cannot differ ends too."""
    assert score_texts(score, threshold, digits, form) == texts
