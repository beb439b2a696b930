"""When a shadow may take over, and what is said of it."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import event, given
from hypothesis import strategies as st

from edge.core.press import ShadowVerdict
from edge.core.shadow import LEAST_COMPARED, JudgedTwice, Weighing


def press(number: int, verdict: str, other: str, saying: str | None = None) -> JudgedTwice:
    return JudgedTwice(f"P{number}", verdict, other, saying, was_damaged=saying == "damaged")


ENOUGH = [press(1000 + number, "pass", "pass") for number in range(LEAST_COMPARED)]


def test_what_a_shadow_says_is_written_and_read_again() -> None:
    said = ShadowVerdict("a" * 64, "b" * 64, "error", None, 0.1)

    assert ShadowVerdict.decode(said.encode()) == said


@pytest.mark.parametrize(
    ("presses", "sentence"),
    [
        (ENOUGH, ""),
        (ENOUGH[1:], f"both have judged {LEAST_COMPARED - 1} presses, at least {LEAST_COMPARED} are needed"),
        ([*ENOUGH, press(1, "fail", "pass", "damaged")], "it passes damage that was found: P1"),
        ([*ENOUGH, press(1, "unsure", "pass", "damaged")], "it passes damage that was found: P1"),
        ([*ENOUGH, press(1, "error", "pass", "damaged")], "it passes damage that was found: P1"),
        ([*ENOUGH, press(1, "pass", "pass", "damaged")], ""),
        ([*ENOUGH, press(1, "fail", "unsure", "damaged")], ""),
        ([*ENOUGH, press(1, "fail", "pass", "cannot_tell")], ""),
        (
            [*ENOUGH, press(1, "pass", "fail", "good"), press(2, "fail", "fail", "gel")],
            "2 instead of 1 of the 2 presses that people call good do not pass it: P1",
        ),
        (
            [*ENOUGH, press(1, "pass", "error", "good")],
            "1 instead of 0 of the 1 press that people call good",
        ),
        ([*ENOUGH, press(1, "pass", "fail", "good"), press(2, "fail", "pass", "good")], ""),
        ([*ENOUGH, press(1, "fail", "pass")], ""),
        ([press(number, "pass", "error") for number in range(200)], "both have judged 0 presses"),
        ([press(number, "error", "pass") for number in range(200)], "both have judged 0 presses"),
    ],
)
def test_a_shadow_takes_over_only_where_it_is_no_worse(presses: Sequence[JudgedTwice], sentence: str) -> None:
    refusals = Weighing(presses).refusals(has_promise=True)

    assert len(refusals) == bool(sentence)
    assert sentence in "".join(refusals)


FAILING = [press(number, "pass", "fail") for number in range(1, 6)]


@pytest.mark.parametrize(
    ("presses", "is_new_gel", "sentence"),
    [
        (FAILING[:4], False, ""),
        (
            FAILING,
            False,
            "5 presses that nobody called damaged pass the bundle in use alone, 0 the shadow alone, more than by "
            "chance: P1, P2, P3, P4, P5",
        ),
        (FAILING, True, "at least 4 are needed; 5 presses that nobody called damaged"),
        ([*FAILING, press(6, "fail", "pass", "good")], False, ""),
        ([*FAILING[1:], press(1, "pass", "fail", "damaged")], False, ""),
        ([*FAILING[1:], press(1, "pass", "error")], False, "5 presses that nobody called damaged"),
        ([press(1, "fail", "pass")], False, "it alone passes P1, and nobody has said what they were"),
        (
            [press(1, "unsure", "pass"), press(2, "error", "pass")],
            False,
            "it alone passes P1, P2, and nobody",
        ),
        ([press(1, "fail", "pass", "good"), press(2, "pass", "fail")], False, ""),
        ([press(1, "fail", "pass"), *(press(k, "pass", "pass", "good") for k in range(2, 6))], True, ""),
    ],
)
def test_by_itself_it_takes_over_where_people_explain_what_it_alone_passes(
    presses: Sequence[JudgedTwice], is_new_gel: bool, sentence: str
) -> None:
    """A blind one passes whatever failed, and where nobody speaks no damage is known. Nor where it stops the line: by
    chance five of five presses, or eight of nine, on which the two differ speak against it once in 32 and in 51."""
    weighing = Weighing([*ENOUGH, *presses], is_new_gel=is_new_gel, is_by_itself=True)

    assert sentence in "; ".join(weighing.refusals(has_promise=True))
    assert bool(weighing.refusals(has_promise=True)) == bool(sentence)


FALSE = [press(number, "fail", "pass", "good") for number in range(5)]
DOUBTED = JudgedTwice("P9", "fail", "pass", "cannot_tell", was_damaged=True)


@pytest.mark.parametrize(
    ("presses", "is_clear"),
    [
        (FALSE, True),
        ([*FALSE[1:], press(0, "unsure", "pass", "good")], True),
        ([*FALSE, press(8, "pass", "fail", "damaged"), press(9, "fail", "fail", "damaged")], True),
        ([*FALSE, press(5, "fail", "pass"), press(6, "pass", "pass", "good")], True),
        ([press(number, "fail", "pass", "good") for number in range(8)] + [press(9, "pass", "fail")], True),
        (FALSE[1:], False),
        ([*FALSE[1:], press(0, "fail", "pass")], False),
        ([*FALSE[1:], press(0, "fail", "pass", "gel")], False),
        ([*FALSE[1:], press(0, "rejected", "pass", "good")], False),
        ([*FALSE[1:], press(0, "fail", "unsure", "good")], False),
        ([*FALSE, press(9, "pass", "fail")], False),
        ([*FALSE, press(9, "pass", "error")], False),
        ([*FALSE, DOUBTED], False),
        ([*FALSE, press(9, "pass", "pass", "damaged")], True),
        ([*FALSE, press(9, "fail", "pass", "damaged")], False),
    ],
)
def test_it_need_not_wait_if_good_presses_favour_it(presses: Sequence[JudgedTwice], is_clear: bool) -> None:
    """Five of five, or eight of nine, on which the two differ: by chance once in 32 and in 51."""
    refusals = Weighing(presses).refusals(has_promise=True)

    assert (refusals == []) == is_clear


@given(
    st.lists(
        st.builds(
            JudgedTwice,
            st.just("P"),
            st.sampled_from(("pass", "fail", "fail", "unsure")),
            st.sampled_from(("pass", "pass", "fail")),
            st.sampled_from(("good", "good", "damaged", "cannot_tell", None)),
            st.booleans(),
        ),
        max_size=40,
    ),
    st.integers(5, 12),
)
def test_no_damage_that_was_found_passes_before_100_presses(presses: list[JudgedTwice], false: int) -> None:
    """Not even one of which a word that was wrong says that it is good."""
    weighing = Weighing([*presses, *(press(number, "fail", "pass", "good") for number in range(false))])
    lost = [one for one in presses if one.was_damaged and one.verdict != "pass" and one.other == "pass"]

    event(f"takes over: {not weighing.refusals(has_promise=True)}")
    assert not (lost and not weighing.refusals(has_promise=True))


def test_it_waits_where_it_is_not_known_whether_it_finds_a_damage() -> None:
    (refusal,) = Weighing(FALSE, ["P4 is gone"]).refusals(has_promise=True)

    assert "at least 100 are needed" in refusal


def test_without_a_promise_it_does_not() -> None:
    (refusal,) = Weighing(ENOUGH).refusals(has_promise=False)

    assert "it promises no rate of false alarms" in refusal


def test_damage_that_passes_is_named_whatever_was_said_of_it_later() -> None:
    """Contradicted, or missed by both, or gone from the archive: nobody overlooks it. What is gone is for somebody to
    answer for."""
    doubted = JudgedTwice("P1", "fail", "pass", "cannot_tell", was_damaged=True)
    weighing = Weighing(
        [*ENOUGH, doubted, press(2, "pass", "pass", "damaged"), press(3, "fail", "fail", "damaged")],
        ["P4 is gone"],
    )
    by_itself = replace(weighing, is_by_itself=True)

    assert weighing.refusals(has_promise=True) == []
    assert by_itself.refusals(has_promise=True) == ["whether it finds the damage of 1 press is not known"]
    assert weighing.doubts() == ["it passes P1, P2, which somebody called damaged", "P4 is gone"]


def test_both_are_counted_in_one_sentence() -> None:
    weighing = Weighing(
        [
            press(1, "pass", "fail", "good"),
            press(2, "fail", "pass", "good"),
            press(3, "fail", "pass", "gel"),
            press(4, "fail", "fail", "damaged"),
            press(5, "pass", "fail", "damaged"),
            press(6, "unsure", "fail"),
        ]
    )

    assert weighing.describe() == (
        "6 presses judged by both: 2 pass the bundle in use alone, 2 the shadow alone; of 3 that people call good 2 "
        "and 1 do not pass, of 2 that they call damaged 1 and 0 pass"
    )
