"""Probabilities and quantiles against scipy."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from calibration.metrics import distributions as d

DF = st.floats(0.5, 500)


@settings(deadline=None)
@given(st.floats(1e-3, 1e4), DF, DF)
def test_the_tail_of_f(value: float, df1: float, df2: float) -> None:
    """As scipy's survival function."""
    assert d.f_above(value, df1, df2) == pytest.approx(
        float(stats.f.sf(value, df1, df2)), rel=1e-7, abs=1e-290
    )


@settings(deadline=None)
@given(st.floats(1e-3, 1e3) | st.floats(-1e3, -1e-3), DF)
def test_the_tails_of_t(value: float, df: float) -> None:
    """Both together."""
    assert d.t_two_sided(value, df) == pytest.approx(
        2 * float(stats.t.sf(abs(value), df)), rel=1e-7, abs=1e-290
    )


@settings(deadline=None)
@given(st.floats(0.6, 0.999), st.floats(1, 500))
def test_the_quantile_of_t(probability: float, df: float) -> None:
    """By bisection."""
    assert d.t_quantile(probability, df) == pytest.approx(
        float(stats.t.ppf(probability, df)), rel=1e-6, abs=1e-7
    )


def test_the_ends_of_a_distribution() -> None:
    """0 and infinity."""
    assert (d.f_above(0, 3, 4), d.f_above(float("inf"), 3, 4), d.t_two_sided(float("inf"), 4)) == (1, 0, 0)
