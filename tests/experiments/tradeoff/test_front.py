"""Which points are on the front."""

from hypothesis import given
from hypothesis import strategies as st
from tradeoff_rows import row

from calibration.experiments.tradeoff.front import list_front, verdict_ms


def front(accuracy: list[float | None], times: list[float]) -> list[int]:
    """The points on the front, by their place."""
    rows = [row(str(k), value, ms) for k, (value, ms) in enumerate(zip(accuracy, times, strict=True))]
    return sorted(int(one["key"]) for one in list_front(rows))


def test_a_point_that_is_worse_in_both_is_dominated() -> None:
    """The fast one and the accurate one stay; the one that is slower than the first and no better goes."""
    assert front([0.5, 0.8, 0.5], [10, 20, 15]) == [0, 1]


def test_a_difference_within_the_noise_is_no_difference() -> None:
    """4 % faster with less accuracy is not on the front, 10 % faster is; nor is what is printed alike and slower."""
    assert front([0.5, 0.8], [9.6, 10]) == [1]
    assert front([0.5, 0.8], [9.0, 10]) == [0, 1]
    assert front([0.8004, 0.7996], [20, 10]) == [1]


def test_an_undefined_accuracy_is_never_on_the_front() -> None:
    assert front([None, 0.1], [1, 10]) == [1]


def test_the_picture_of_an_older_row_is_not_waited_for() -> None:
    """Rows of version 0.2.0 have the picture among their stages."""
    old = row(ms=20.0)
    old["stages"]["overlay"] = {"median": 24.0, "p95": 30.0}
    assert round(verdict_ms(old), 6) == 20


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0.5, 5)), min_size=1, max_size=8))
def test_some_point_is_always_on_the_front(points: list[tuple[float, float]]) -> None:
    accuracy, times = zip(*points, strict=True)
    assert front(list(accuracy), list(times))
