"""The gel's life."""

from datetime import date

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.gel_life import NO_LABEL, GelLabel, GelState, is_past, state_of


@pytest.mark.parametrize(
    ("presses", "state"),
    [
        (0, GelState.GOOD),
        (799, GelState.GOOD),
        (800, GelState.DUE),
        (999, GelState.DUE),
        (1000, GelState.REPLACE),
        (5000, GelState.REPLACE),
    ],
)
def test_states_at_their_edges(presses: int, state: GelState) -> None:
    """Good below 80 % of 1,000 presses, due below the limit, replace from it on."""
    assert state_of(presses) is state


@given(st.integers(0, 3000), st.integers(1, 2000), st.floats(0.01, 1.0), st.integers(0, 500))
def test_a_gel_never_recovers(presses: int, limit: int, warn: float, more: int) -> None:
    order = list(GelState)
    before, later = (state_of(number, limit, warn) for number in (presses, presses + more))
    assert order.index(before) <= order.index(later)


def test_nonsense_is_refused() -> None:
    for make in (
        lambda: state_of(-1),
        lambda: state_of(0, 0),
        lambda: state_of(0, 10, 0.0),
        lambda: state_of(0, 10, 1.1),
    ):
        with pytest.raises(ValueError, match=r"found|not pressed"):
            make()


@pytest.mark.parametrize(
    ("label", "sentence"),
    [
        (
            {"use_by": "2026-02-30"},
            "the use-by date 2026-02-30 is no day of the calendar .*; write that of the package",
        ),
        ({"use_by": "31.01.2027"}, "the use-by date '31.01.2027' is not written as YYYY-MM-DD; write it so"),
        ({"use_by": "20270131"}, "'20270131' is not written as YYYY-MM-DD"),
        ({"use_by": "2027-W05-7"}, "'2027-W05-7' is not written as YYYY-MM-DD"),
        ({"use_by": "٢٠٢٧-01-31"}, "is not written as YYYY-MM-DD"),
        ({"use_by": ""}, "'' is not written as YYYY-MM-DD"),
        (
            {"gel_serial": "G\x1b[2J"},
            r"gel serial 'G.x1b.*' holds control characters; use letters, digits and signs",
        ),
        ({"gel_serial": "G" * 65}, r"gel serial 'G{64}...' has 65 characters, expected at most 64; write"),
        ({"gel_serial": "Г1"}, "gel serial 'Г1' holds a character beyond ASCII; write the Latin letters"),
        ({"gel_serial": " "}, "the gel serial is empty; leave it out where the package names none"),
        ({"gel_type": "with\ndots"}, "gel type 'with.*dots' holds control characters"),
        ({"gel_type": "m" * 65}, "gel type 'm{64}...' has 65 characters"),
    ],
)
def test_what_no_package_says_is_refused(label: dict[str, str], sentence: str) -> None:
    """One sentence: the thing, what was found, what was expected."""
    with pytest.raises(ValueError, match=sentence):
        GelLabel.of(*(label.get(name) for name in ("gel_serial", "gel_type", "use_by")))


def test_a_label_is_what_was_written_without_the_blanks_of_a_scanner() -> None:
    """Nothing is assumed for what is left out."""
    assert GelLabel.of(" G7\n", None, "2027-01-31 ") == GelLabel("G7", None, "2027-01-31")
    assert GelLabel.of(None, None, None) == NO_LABEL


def test_a_gel_is_past_its_date_the_day_after() -> None:
    """It may be used on the last day; without a date it is never past."""
    days = [date(2026, 12, 31), date(2027, 1, 31), date(2027, 2, 1), date(2028, 1, 1)]
    assert [is_past("2027-01-31", day) for day in days] == [False, False, True, True]
    assert not is_past(None, date(9999, 12, 31))
