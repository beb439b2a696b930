"""A point chosen within limits, and why."""

import pytest
from tradeoff_rows import row

from calibration.experiments.tradeoff.front import Limits, pick, read_limits
from edge.core.errors import ConfigError

ROWS = [
    row("padim.t.lr.20", 0.75, ms=20, bank_bytes=1_400_000),
    row("spade.t.lr.20", 0.80, ms=24, bank_bytes=6_700_000),
    row("inreach.t.lr.40", 0.85, ms=21, bank_bytes=130_000, presses=40),
    row("fapm.t.lr.5", 0.60, ms=19, bank_bytes=1_900_000, presses=5),
]


def chosen(limits: Limits) -> str:
    return str(pick(ROWS, limits)[0]["key"])


def test_the_most_accurate_point_within_the_limits_is_chosen() -> None:
    assert chosen({"time": 100}) == "inreach.t.lr.40"
    assert chosen({"presses": 20}) == "spade.t.lr.20"
    assert chosen({"presses": 20, "bank": 2}) == "padim.t.lr.20"
    assert chosen({"presses": 20, "time": 19.5}) == "fapm.t.lr.5"


def test_the_faster_of_two_equals_is_chosen() -> None:
    """Equal accuracy: the verdict that comes first."""
    assert pick([row("a.t", 0.7, ms=9), row("b.t", 0.7, ms=8)], {"presses": 20})[0]["key"] == "b.t"


def test_the_reasons_name_what_binds_and_what_was_nearer() -> None:
    """The limit on presses binds, the one on time does not, and the missed point is named with its excess."""
    reasons = "\n".join(pick(ROWS, {"time": 30, "presses": 20})[1])
    assert "3 of 4 points fit" in reasons
    assert "the limit on presses binds: without it inreach.t.lr.40 with AU-PRO 0.850" in reasons
    assert "40 presses where 20 presses is allowed" in reasons
    assert "limit on time binds" not in reasons
    assert "the next that fits: padim.t.lr.20" in reasons


def test_nothing_that_fits_is_one_sentence_with_the_nearest() -> None:
    """The nearest is the one with the smallest excess over any limit."""
    sentence = (
        "^none of 4 points is within these limits; the nearest is fapm.t.lr.5 with AU-PRO 0.600: 19 ms where 18 ms is "
        "allowed, 5 presses where 4 presses is allowed; widen a limit$"
    )
    with pytest.raises(ConfigError, match=sentence):
        pick(ROWS, {"time": 18, "presses": 4})


def test_a_peer_and_an_undefined_accuracy_are_never_chosen() -> None:
    """A peer has no bundle; a point without accuracy has no reason."""
    rows = [row("peer", 0.99) | {"peer": "anomalib"}, row("none.t", None), row("own.t", 0.5)]
    assert pick(rows, {"presses": 99})[0]["key"] == "own.t"
    with pytest.raises(ConfigError, match="nothing to choose"):
        pick(rows[:2], {"presses": 99})


@pytest.mark.parametrize("text", ["20", "ms", "0ms", "-3ms", "20 MB", "1e3ms"])
def test_anything_else_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--within .* is not understood; .* such as --within 20ms"):
        read_limits(text, None, None)
