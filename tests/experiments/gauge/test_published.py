"""The published worked examples, with the published numbers.

AIAG, Measurement Systems Analysis, 4th edition, chapter III: the study of ten parts, three appraisers and three trials
(tables III-B 6a to 8), and the attribute study of fifty parts (tables III-C 1 to 8). Fleiss, Psychological Bulletin 76
(1971). Cohen, Educational and Psychological Measurement 20 (1960). The numbers are facts of these sources.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.experiments.gauge.gauge import Share, cohen_kappa, fleiss_kappa, gauge_by_anova

A = (
    (0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36),
    (0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25),
    (0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31),
)
B = (
    (0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68),
    (0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62),
    (0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50),
)
C = (
    (0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49),
    (-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77),
    (-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16),
)


def aiag() -> NDArray[np.float64]:
    """float64 (10, 3, 3): pieces, operators, repeats."""
    return np.array([A, B, C]).transpose(2, 0, 1)


def test_the_table_of_variance_is_the_published_one() -> None:
    """Table III-B 7: sums of squares, degrees of freedom, mean squares, F."""
    rows = {row.name: row for row in gauge_by_anova(aiag()).sources}

    assert (rows["operators"].ss, rows["operators"].df) == (pytest.approx(3.1673, abs=5e-5), 2)
    assert (rows["pieces"].ss, rows["pieces"].df) == (pytest.approx(88.3619, abs=5e-5), 9)
    assert (rows["interaction"].ss, rows["interaction"].df) == (pytest.approx(0.3590, abs=5e-5), 18)
    assert (rows["repeatability"].ss, rows["repeatability"].df) == (pytest.approx(2.7589, abs=5e-5), 60)
    assert (rows["total"].ss, rows["total"].df) == (pytest.approx(94.6471, abs=5e-5), 89)
    assert rows["interaction"].f == pytest.approx(0.434, abs=5e-4)
    assert rows["repeatability"].ms == pytest.approx(0.04598, abs=5e-6)


def test_the_components_are_the_published_ones() -> None:
    """Table III-B 8: the interaction is pooled; standard deviations and shares."""
    gauge = gauge_by_anova(aiag())
    published = {
        "EV": (0.199933, 18.4),
        "AV": (0.226838, 20.9),
        "GRR": (0.302373, 27.9),
        "PV": (1.042327, 96.0),
    }

    assert gauge.is_pooled
    assert gauge.sd["INT"].value == 0.0
    for name, (sd, percent) in published.items():
        found = gauge.sd[name].value, round(gauge.percent[name].value, 1)
        assert found == (pytest.approx(sd, abs=2e-6), percent)
    assert gauge.ndc.value == 4


def decisions(*counts: tuple[str, str, int]) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """Two series with these numbers of pairs."""
    first, second = np.array([pair for *pair, number in counts for _ in range(number)]).T
    return first, second


@pytest.mark.parametrize(
    ("bad_bad", "bad_good", "good_bad", "good_good", "kappa"),
    [
        (44, 6, 3, 97, 0.86),  # A and B
        (42, 5, 9, 94, 0.79),  # B and C
        (43, 7, 8, 92, 0.78),  # A and C
        (45, 5, 3, 97, 0.88),  # A and the reference
        (45, 2, 3, 100, 0.92),  # B and the reference
        (42, 9, 6, 93, 0.77),  # C and the reference
    ],
)
def test_kappas_of_the_attribute_study_are_the_published_ones(
    bad_bad: int, bad_good: int, good_bad: int, good_good: int, kappa: float
) -> None:
    """Tables III-C 3 to 6: cross tables of 150 decisions each."""
    counts = {"fail fail": bad_bad, "fail pass": bad_good, "pass fail": good_bad, "pass pass": good_good}
    found = cohen_kappa(*decisions(*((*words.split(), n) for words, n in counts.items())))

    assert found.value == pytest.approx(kappa, abs=0.005)


@pytest.mark.parametrize(
    ("found", "low", "high"), [(42, 0.71, 0.93), (45, 0.78, 0.97), (40, 0.66, 0.90), (39, 0.64, 0.89)]
)
def test_intervals_of_the_effectiveness_are_the_published_ones(found: int, low: float, high: float) -> None:
    """Table III-C 7: A 42, B 45, C 40 and all of them 39 of 50 parts."""
    assert Share(found, 50).limits == pytest.approx((low, high), abs=0.006)


def test_cohens_kappa_is_that_of_the_paper() -> None:
    """Cohen 1960, table 1: three judgements of 200 patients, kappa 0.492; in shares of all."""
    table = {("a", "a"): 88, ("a", "b"): 14, ("a", "c"): 18, ("b", "a"): 10, ("b", "b"): 40}
    table |= {("b", "c"): 10, ("c", "a"): 2, ("c", "b"): 6, ("c", "c"): 12}
    found = cohen_kappa(*decisions(*((one, other, n) for (one, other), n in table.items())))

    assert (found.observed, found.expected) == pytest.approx((0.70, 0.41))
    assert found.value == pytest.approx(0.492, abs=5e-4)


def test_fleiss_kappa_of_a_worked_example() -> None:
    """Ten things, fourteen raters, five categories: kappa 0.210 (the usual textbook example)."""
    counts = (
        *((0, 0, 0, 0, 14), (0, 2, 6, 4, 2), (0, 0, 3, 5, 6), (0, 3, 9, 2, 0), (2, 2, 8, 1, 1)),
        *((7, 7, 0, 0, 0), (3, 2, 6, 3, 0), (2, 5, 3, 2, 2), (6, 5, 2, 1, 0), (0, 2, 2, 3, 7)),
    )
    found = fleiss_kappa(np.array([[str(k) for k, n in enumerate(row) for _ in range(n)] for row in counts]))

    assert (found.observed, found.expected) == pytest.approx((0.378, 0.213), abs=5e-4)
    assert found.value == pytest.approx(0.210, abs=5e-4)
