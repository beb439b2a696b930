"""The gel's life."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.gel_life import GelState, state_of


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
    """More presses never make the state better."""
    order = list(GelState)
    before, later = (state_of(number, limit, warn) for number in (presses, presses + more))
    assert order.index(before) <= order.index(later)


def test_nonsense_is_refused() -> None:
    """Negative presses, no limit, a warning beyond the limit."""
    for make in (
        lambda: state_of(-1),
        lambda: state_of(0, 0),
        lambda: state_of(0, 10, 0.0),
        lambda: state_of(0, 10, 1.1),
    ):
        with pytest.raises(ValueError, match=r"found|not pressed"):
            make()
