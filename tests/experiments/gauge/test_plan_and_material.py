"""Plans are random, complete and checked; rows make the largest table without gaps."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from calibration.experiments.gauge.plan import Piece, StudyPlan, make_plan, material, read_plan
from calibration.experiments.gauge.report import markdown, report_sections
from edge.core.errors import ConfigError, DatasetError
from edge.store.study_presses import StudyPress

T0 = 1_780_000_000 * 10**9
Rows = Callable[..., list[StudyPress]]


def text_of(plan: StudyPlan, rows: list[StudyPress]) -> str:
    """As one line."""
    return " ".join(markdown("T", report_sections(material(plan, rows))).split())


def test_a_plan_has_each_press_once_in_blocks_and_its_seed_gives_it_again(plan: StudyPlan) -> None:
    """Within a repeat each operator has one block of all pieces."""
    again = make_plan(plan.pieces, plan.operators, 2, seed=3, time_ns=T0)
    other = make_plan(plan.pieces, plan.operators, 2, seed=4, time_ns=T0)
    blocks = [plan.order[start : start + 4] for start in range(0, 16, 4)]

    assert again.order == plan.order != other.order
    assert all(len({step.operator for step in block}) == 1 for block in blocks)
    assert all({step.piece for step in block} == {"P1", "P2", "P3", "P4"} for block in blocks)
    assert read_plan(plan.text(), "p") == plan


def test_a_name_twice_is_refused() -> None:
    """Two pieces with one name are one in the report."""
    with pytest.raises(ConfigError, match="the piece 'P1' is there twice"):
        make_plan([Piece(name="P1"), Piece(name="P1")], ["A", "B"], 2, 1, T0)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"repeats": 2', '"repeats": 3', "expected each operator with each piece in each repeat, once: 24"),
        ('"repeats": 2', '"repeats": "2"', "repeats: "),
        ('"kind"', '"sort"', "sort: "),
        ("{", "", "Invalid JSON"),
    ],
)
def test_a_plan_that_was_edited_is_refused(plan: StudyPlan, old: str, new: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read_plan(plan.text().replace(old, new, 1), "study.json")

    assert sentence in str(refused.value)
    assert "plan study.json cannot be used" in str(refused.value)


def test_a_complete_study_is_analysed_as_it_is(plan: StudyPlan, rows_of: Rows) -> None:
    """Four pieces, two operators, two repeats, in the plan's order of names."""
    found = material(plan, rows_of(plan))

    assert (found.pieces, found.operators) == (("P1", "P2", "P3", "P4"), ("A", "B"))
    assert found.scores.shape == (4, 2, 2)
    assert (found.missing, found.left_out, found.known) == (0, 0, ["pass", "pass", "fail", "fail"])
    assert found.scores[3].mean() > found.scores[0].mean() + 0.5


def test_missing_presses_are_said_and_leave_a_smaller_table(plan: StudyPlan, rows_of: Rows) -> None:
    """One press of P2 is missing: the analysis is without P2."""
    gap = next(number for number, step in enumerate(plan.order) if step.piece == "P2")
    rows = rows_of(plan, skip=[gap])
    found = material(plan, rows)

    assert (found.pieces, found.missing, found.left_out) == (("P1", "P3", "P4"), 1, 3)
    assert "not complete: 1 press of the plan without a score" in text_of(plan, rows)
    assert "leaves out 3 presses" in text_of(plan, rows)


def test_void_and_rejected_presses_do_not_count_and_are_said(plan: StudyPlan, rows_of: Rows) -> None:
    """The one that was repeated, and the ones without a score."""
    rows = rows_of(plan)
    extra = [
        replace(rows[0], press_id="V" * 26, score=99.0, is_void=True),
        replace(rows[1], press_id="R" * 26, score=None, verdict="rejected", reason="not_settled: it slid"),
    ]
    found = material(plan, [*extra, *rows])

    assert found.scores.max() < 3
    assert (found.void, dict(found.rejected)) == (1, {rows[1].operator: 1})
    assert f"without a score, pressed again: 1 (by operator: {rows[1].operator} 1)" in text_of(
        plan, [*extra, *rows]
    )


@pytest.mark.parametrize(
    ("field", "word"), [("gel_id", "gel"), ("bundle_id", "bundle"), ("serial", "sensor")]
)
def test_a_change_in_the_middle_is_refused(plan: StudyPlan, rows_of: Rows, field: str, word: str) -> None:
    rows = rows_of(plan)
    rows[-1] = replace(rows[-1], **{field: "another"})

    with pytest.raises(DatasetError, match=rf"pressed with more than one {word} \(\w+, another\)"):
        material(plan, rows)


def test_too_few_presses_are_refused(plan: StudyPlan, rows_of: Rows) -> None:
    with pytest.raises(DatasetError, match=r"3 of 16 presses .* have a score.*`gelgate lab msa run` goes on"):
        material(plan, rows_of(plan)[:3])


def test_what_a_study_cannot_show_is_said(plan: StudyPlan, rows_of: Rows) -> None:
    """One verdict alone has no kappa; a drift is told from chance; without known pieces there are no rates."""
    drifting = [replace(row, score=(row.score or 0) + 0.2 * n) for n, row in enumerate(rows_of(plan))]
    unknown = make_plan([Piece(name="P1"), Piece(name="P2")], ["A", "B"], 2, 1, T0)
    for study, rows, words in (
        (plan, rows_of(plan, verdict="pass"), "Every verdict is pass, so agreement is all by chance"),
        (plan, drifting, "The drift is real"),
        (plan, rows_of(plan), "No drift is found beyond chance"),
        (unknown, rows_of(unknown), "name bad pieces in `gelgate lab msa plan --bad`"),
    ):
        assert words in text_of(study, rows)
