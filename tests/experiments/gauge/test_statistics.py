"""Gauge R&R, agreement and drift: known variances are found, and what has no meaning is said."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from calibration.experiments.gauge.gauge import (
    Share,
    cohen_kappa,
    count_shares,
    drift,
    fleiss_kappa,
    gauge_by_anova,
)


def simulated(
    rng: np.random.Generator, sd: tuple[float, float, float, float], shape: tuple[int, int, int]
) -> NDArray[np.float64]:
    """Random effects of pieces, operators, interaction and error."""
    p, o, _ = shape
    piece, operator, both, error = sd
    return np.asarray(
        piece * rng.standard_normal((p, 1, 1))
        + operator * rng.standard_normal((1, o, 1))
        + both * rng.standard_normal((p, o, 1))
        + error * rng.standard_normal(shape)
    )


def test_known_variances_are_found_in_a_large_study() -> None:
    """Sixty pieces, forty operators, five repeats: within some percent."""
    gauge = gauge_by_anova(simulated(np.random.default_rng(2), (3.0, 1.0, 0.5, 0.8), (60, 40, 5)))

    assert not gauge.is_pooled
    assert gauge.sd["EV"].value == pytest.approx(0.8, rel=0.03)
    assert gauge.sd["INT"].value == pytest.approx(0.5, rel=0.06)
    assert gauge.sd["AV"].value == pytest.approx(1.0, rel=0.25)
    assert gauge.sd["PV"].value == pytest.approx(3.0, rel=0.2)


def test_the_interval_of_repeatability_is_the_exact_one() -> None:
    """SS / chi-square: the closed form."""
    scores = simulated(np.random.default_rng(3), (3.0, 1.0, 2.0, 0.8), (6, 3, 2))
    gauge = gauge_by_anova(scores)
    row = next(row for row in gauge.sources if row.name == "repeatability")
    exact = np.sqrt(row.ss / stats.chi2.ppf([0.975, 0.025], row.df))

    assert not gauge.is_pooled
    assert gauge.sd["EV"][1:] == pytest.approx(tuple(exact), rel=0.02)


def test_intervals_hold_what_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 200 simulated studies, the true share of gauge R&R lies in the 95 % interval of at least 182."""
    from calibration.experiments.gauge import gauge as module

    monkeypatch.setattr(module, "DRAWS", 2_000)
    sd = (2.0, 0.6, 0.4, 0.5)
    truth = 100 * np.sqrt((0.6**2 + 0.4**2 + 0.5**2) / (2.0**2 + 0.6**2 + 0.4**2 + 0.5**2))
    rng = np.random.default_rng(4)
    found = [gauge_by_anova(simulated(rng, sd, (10, 3, 3))).percent["GRR"] for _ in range(200)]

    assert sum(one.low <= truth <= one.high for one in found) >= 182


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_another_zero_and_unit_change_no_share(seed: int, shift: float, scale: float) -> None:
    """Shares and categories are those of the same scores in other units."""
    scores = simulated(np.random.default_rng(seed), (2.0, 0.6, 0.4, 0.5), (5, 3, 2))
    one, other = gauge_by_anova(scores), gauge_by_anova(scale * scores + shift)

    for name, share in one.percent.items():
        assert other.percent[name] == pytest.approx(share, rel=1e-4, abs=1e-6)


NOISE = np.random.default_rng(0).standard_normal((2, 2, 2))


@pytest.mark.parametrize(
    ("work", "sentence"),
    [
        (lambda: gauge_by_anova(NOISE[:1]), "found 1 x 2 x 2"),
        (lambda: gauge_by_anova(NOISE[:, :1]), "found 2 x 1 x 2"),
        (lambda: gauge_by_anova(NOISE[..., :1]), "found 2 x 2 x 1"),
        (
            lambda: gauge_by_anova(np.full((3, 2, 2), 0.5)),
            r"all scores are 0.5, so nothing varies; check that the pieces",
        ),
    ],
)
def test_what_has_no_statistic_is_refused(work: Callable[[], object], sentence: str) -> None:
    """Fewer than two of anything, scores that do not vary: one sentence."""
    with pytest.raises(ValueError, match=sentence):
        work()


VERDICTS = np.array(
    [
        [["pass", "pass"], ["pass", "pass"]],
        [["pass", "fail"], ["pass", "pass"]],
        [["fail", "fail"], ["fail", "unsure"]],
        [["fail", "fail"], ["pass", "fail"]],
    ]
)
KNOWN = ["pass", "pass", "fail", "fail"]


def test_agreement_is_counted_by_piece_and_errors_by_decision() -> None:
    """Worked by hand; unsure is no miss on a bad piece, no false alarm is hidden, and it is not right either."""
    a, b = (count_shares(VERDICTS[:, operator], KNOWN) for operator in (0, 1))
    both = count_shares(VERDICTS.reshape(4, -1), KNOWN)

    assert (a.same.found, b.same.found, both.same.found) == (3, 2, 1)
    assert both.effectiveness == Share(1, 4)
    assert count_shares(VERDICTS[:, 0], None)[1:] == (None, None, None)
    assert (a.effectiveness, b.effectiveness) == (Share(3, 4), Share(2, 4))
    assert (a.misses, b.misses) == (Share(0, 4), Share(1, 4))
    assert a.false_alarms == Share(1, 4)


def test_kappa_is_one_for_agreement_and_near_zero_by_chance() -> None:
    """And its standard error is that of many series by chance, for Cohen's and for Fleiss' kappa."""
    rng = np.random.default_rng(6)
    cohen = [
        cohen_kappa(rng.choice(["a", "b"], 60, p=[0.3, 0.7]), rng.choice(["a", "b"], 60)) for _ in range(400)
    ]
    fleiss = [fleiss_kappa(rng.choice(["a", "b"], (20, 5), p=[0.25, 0.75])) for _ in range(400)]

    assert cohen_kappa(np.array(["a", "b", "a"]), np.array(["a", "b", "a"])).value == 1.0
    for found in (cohen, fleiss):
        values, errors = np.array([(one.value, one.standard_error) for one in found]).T
        assert values.mean() == pytest.approx(0, abs=0.02)
        assert values.std() == pytest.approx(errors.mean(), rel=0.15)


def cells(presses: int) -> list[int]:
    return [number % 10 for number in range(presses)]


def test_a_drift_is_found_through_pieces_that_differ() -> None:
    """Ten pieces with scores far apart: the line of 0.004 a press is found with its interval."""
    rng = np.random.default_rng(7)
    scores = [10.0 * (n % 10) + 0.004 * n + 0.05 * rng.standard_normal() for n in range(90)]
    found = drift(scores, cells(90))

    assert found is not None
    assert found.p < 0.05
    assert found.total.low < 0.004 * 89 < found.total.high
    assert found.sd == pytest.approx(0.05, rel=0.25)


def test_the_test_for_drift_is_the_covariance_analysis() -> None:
    """The same slope and p as least squares with a mean for each cell; scipy's distribution."""
    rng = np.random.default_rng(8)
    scores, order = rng.standard_normal(30), np.arange(30.0)
    design = np.column_stack([np.eye(10)[cells(30)], order])
    solution, residual, *_ = np.linalg.lstsq(design, scores, rcond=None)
    error = np.sqrt(residual[0] / 19 * np.linalg.inv(design.T @ design)[-1, -1])
    found = drift(list(scores), cells(30))

    assert found is not None
    assert found.total.value == pytest.approx(solution[-1] * 29)
    assert found.p == pytest.approx(2 * float(stats.t.sf(abs(solution[-1] / error), 19)), rel=1e-6)
    assert found.p > 0.05
