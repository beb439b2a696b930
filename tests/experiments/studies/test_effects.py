"""Directions of effects by the interval over seeds; tests/docs/test_studies.py compares pages that show them."""

from calibration.experiments.harness.evidence import Sample, compare_directions, direction


def changes(values: list[float], *, are_drawn: bool = True) -> Sample:
    return {("PZ1", seed): (value, are_drawn) for seed, value in enumerate(values)}


def test_a_direction_is_sure_or_undecided() -> None:
    """The interval of the paired difference decides."""
    rising = [0.01 + 0.001 * seed for seed in range(10)]

    assert direction(changes(rising)) == "up"
    assert direction(changes([-value for value in rising])) == "down"
    assert direction(changes([0.01, -0.01] * 5)) == "undecided"
    assert direction(changes([0.8, 0.8])) == "undecided"
    assert direction(changes(rising, are_drawn=False)) == "undecided"


def test_directions_agree_or_differ() -> None:
    """An undecided one does neither."""
    assert compare_directions("up", 0.1, 0.2) == ("up", "agree")
    assert compare_directions("up", 0.2, 0.1) == ("down", "differ")
    assert compare_directions("undecided", 0.1, 0.2) == ("up", "undecided")
    assert compare_directions("up", 0.5, 0.5) == ("undecided", "undecided")
