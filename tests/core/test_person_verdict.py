"""What people say of presses: what holds, what it shows, and which presses they are asked about."""

import math

import pytest

from edge.core.person_verdict import (
    Agreement,
    Asked,
    PersonVerdict,
    choose_questions,
    find_broken_promise,
    settle,
)


def said(person: str, saying: str, kind: str | None = None) -> PersonVerdict:
    return PersonVerdict("01", 0, person, saying, kind)


@pytest.mark.parametrize(
    ("verdicts", "holds"),
    [
        ([], None),
        ([said("kim", "good")], "good"),
        ([said("kim", "good"), said("kim", "damaged", "burr")], "damaged"),  # the newest word of one person
        ([said("kim", "good"), said("lee", "damaged")], "cannot_tell"),
        ([said("kim", "good"), said("lee", "damaged"), said("lee", "good")], "good"),
        ([said("lee", "good"), said("kim", "damaged"), said(" KIM", "damaged")], "cannot_tell"),  # one person
        ([said("kim", "damaged"), said("lee", "cannot_tell")], "damaged"),
        ([said("kim", "cannot_tell")], "cannot_tell"),
        ([said("kim", "good"), said("lee", "gel")], "cannot_tell"),
        ([said("kim", "damaged"), said("lee", "good"), said("ann", "good")], "good"),  # two against one
        ([said("kim", "damaged"), said("lee", "good"), said("lee", "good")], "cannot_tell"),
        ([said(name, "good") for name in "abc"] + [said(name, "damaged") for name in "de"], "cannot_tell"),
    ],
)
def test_people_who_contradict_each_other_settle_nothing_unless_twice_as_many_say_the_same(
    verdicts: list[PersonVerdict], holds: str | None
) -> None:
    """Whoever cannot tell contradicts nobody."""
    settled = settle(verdicts)

    assert (settled and settled.saying) == holds


def test_the_kind_is_that_of_the_word_that_holds() -> None:
    settled = settle([said("kim", "damaged", "burr"), said("lee", "cannot_tell")])

    assert settled is not None
    assert (settled.kind, settled.person) == ("burr", "kim")


def test_of_two_people_who_agree_the_newest_kind_holds() -> None:
    """Whoever spoke first of all may have spoken last too."""
    settled = settle(
        [said("kim", "damaged", "burr"), said("lee", "damaged", "crack"), said("kim", "damaged", "dent")]
    )

    assert settled is not None
    assert (settled.kind, settled.person) == ("dent", "kim")


def test_false_alarms_and_escapes_are_of_the_presses_that_people_judged() -> None:
    """Ten presses by hand: yield 6 of 10, one of two judged fails was good, one of three judged passes was damaged. 90
    % limits of Clopper and Pearson by hand: 1 of 2 from 1 - 0.9^(1/2) = 5 % to 95 %; 1 of 3 from 1 - 0.9^(1/3) = 3 %
    to the root of (1-x)^3 + 3x(1-x)^2 = 0.1, 80 %."""
    agreement = Agreement()
    for verdict, saying in (
        *(("pass", None),) * 3,
        ("pass", "good"),
        ("pass", "gel"),
        ("pass", "damaged"),
        ("fail", "good"),
        ("unsure", "damaged"),
        ("rejected", "good"),
        ("error", "damaged"),
    ):
        agreement.add(verdict, saying)

    assert agreement.describe() == (
        "10 presses, yield 60.0%; false alarms: 1 of 2 judged fails (5% to 95%); "
        "escapes: 1 of 3 judged passes (3% to 80%)"
    )
    assert "not known, nobody judged a fail" in Agreement().describe()


def asked(n: int, verdict: str, ratio: float) -> Asked:
    return Asked(f"{n:04d}", n, verdict, ratio, "bolt")


def test_the_presses_closest_to_the_threshold_are_asked_for_a_pass_and_another_that_are_drawn() -> None:
    """Twice too high is as far as half; what is answered is not asked again; of five one is a pass of any score, and
    one is not."""
    presses = [
        asked(1, "fail", 1.4),
        asked(2, "fail", 1.05),
        asked(3, "unsure", 1.0),
        asked(4, "fail", 1.3),
        asked(5, "fail", 1.5),
        asked(6, "pass", 0.2),
        asked(7, "fail", 1.01),
        *(asked(number, "fail", 3.0) for number in range(10, 40)),
    ]

    chosen = choose_questions(presses, {"0007"}, 5)

    assert [one.press_id for one in chosen[:4]] == ["0002", "0003", "0004", "0006"]
    assert chosen[4].score_ratio == 3.0
    assert choose_questions(presses, {"0007"}, 2) == [presses[1], presses[2]]
    assert choose_questions(presses, set(), 0) == []


@pytest.mark.parametrize("is_pass_first", [True, False])
def test_the_questions_of_a_day_are_the_same_ones_until_all_are_answered(is_pass_first: bool) -> None:
    """Ten, two of them drawn passes, in whatever order people answer; the next day has others."""
    presses = [asked(number, "pass", 0.3 + number / 1000) for number in range(400)]
    presses += [asked(number, "fail", 1.0 + number / 1000) for number in range(400, 500)]
    first, today, shown = choose_questions(presses, (), 10), set[str](), set[str]()
    while questions := choose_questions(presses, today, 10 - len(today), None, today):
        shown |= {one.press_id for one in questions}
        far = sorted(questions, key=lambda one: (one.score_ratio or 0) < 0.65)
        today.add(far[-1 if is_pass_first else 0].press_id)

    assert shown == today == {one.press_id for one in first}
    assert sum((one.score_ratio or 0) < 0.65 for one in first) == 2
    assert shown.isdisjoint(one.press_id for one in choose_questions(presses, today, 10))


def test_on_a_gel_on_which_nothing_is_proven_its_presses_are_drawn_whatever_their_score() -> None:
    """All fail there, and those close to the threshold are not the usual ones; passes of before are not asked for."""
    old = [asked(n, "pass", 0.99) for n in range(1, 5)]
    new = [asked(n, "fail", 1 + n / 100) for n in range(10, 40)]

    chosen = choose_questions([*old, *new], {"0011"}, 10, new_gel_ns=10)

    assert len(chosen) == 10
    assert {one.press_id for one in chosen} <= {one.press_id for one in new} - {"0011"}
    assert sum(one.score_ratio for one in chosen) / 10 > 1.15  # the lowest ten give 1.15


def test_what_is_drawn_does_not_hang_on_the_random_part_of_an_id() -> None:
    """A month that is simulated again asks about the same presses."""

    def draw(factor: int) -> list[int]:
        presses = [Asked(f"{n:04d}{n * factor % 11:02d}", n, "pass", 0.5, "bolt") for n in range(40)]
        return [one.time_ns for one in choose_questions(presses, set(), 10, new_gel_ns=0)]

    assert draw(3) == draw(7)


def test_a_score_without_a_ratio_is_asked_for_last() -> None:
    assert asked(1, "fail", math.inf).doubt == asked(1, "pass", 0.0).doubt == -math.inf


@pytest.mark.parametrize(
    ("failed", "words", "is_broken"),
    [
        (10, ["good"], True),
        (10, ["damaged"], False),
        (10, ["gel", "cannot_tell"], False),
        (10, ["good", "damaged", "damaged"], False),
        (3, ["good", "good"], True),
        (3, ["good"], False),
        (1, ["good"], False),
        (0, ["good"], False),
    ],
)
def test_more_failing_good_presses_break_a_promise(failed: int, words: list[str], is_broken: bool) -> None:
    """Of ten presses, 3 % are promised. One good of three fails shows a tenth of .12, two of two a third of it."""
    presses = [asked(n, "fail" if n < failed else "pass", 1.1) for n in range(10)]
    said = {f"{n:04d}": [PersonVerdict(f"{n:04d}", 1, "kim", word)] for n, word in enumerate(words)}

    sentence = find_broken_promise(presses, said, 0.03)

    assert (sentence is not None) == is_broken


def test_a_broken_promise_says_by_how_many_words() -> None:
    presses = [asked(n, "fail", 1.1) for n in range(10)]
    said = {
        "0001": [PersonVerdict("0001", 1, "kim", "good")],
        "0002": [PersonVerdict("0002", 1, "lee", "gel")],
    }

    assert find_broken_promise(presses, said, 0.03) == (
        "more sound parts fail than the bundle promises (3%): people call 1 of 2 presses of the last day good that did "
        "not pass; learn from them (`gelgate bundle learn`)"
    )
