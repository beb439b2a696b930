"""The picture of a run, made from rows alone."""

from typing import Any

import pytest
from tradeoff_rows import row, rows_of_a_run

from calibration.experiments.tradeoff.bench_command import read_medians
from calibration.experiments.tradeoff.figure import LATER, figure, name_point
from calibration.experiments.tradeoff.front import FIRST, list_front, verdict_ms


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return rows_of_a_run()


def test_a_point_without_accuracy_is_no_error(rows: list[dict[str, Any]]) -> None:
    """The picture leaves it out."""
    marks = [len(axes.collections) for axes in figure(rows).axes]
    assert [len(axes.collections) for axes in figure([*rows, row("none.t", None)]).axes] == marks


def test_the_picture_has_every_point_and_names_the_front(rows: list[dict[str, Any]]) -> None:
    """Fast points have a linear axis, slower ones a panel of their own; each point of the front has its name once."""
    near, far = figure(rows).axes
    times = [verdict_ms(one) for one in rows]
    assert near.get_xlim()[0] == 0
    assert near.get_xlim()[1] == far.get_xlim()[0] < max(times) < far.get_xlim()[1]
    names = [text.get_text() for axes in (near, far) for text in axes.texts]
    assert sorted(names)[:-1] == sorted(
        f"{name_point(one)}\n{one['accuracy'][FIRST]['value']:.3f} in {verdict_ms(one):.0f} ms"
        for one in list_front(rows)
    )


def test_what_comes_after_the_verdict_is_drawn_in_grey(rows: list[dict[str, Any]]) -> None:
    """A bar from the verdict to each later stage, from the page of a bench; the panels above stay as they are."""
    page_of_bench = (
        "| milliseconds | what | count | median | p95 |\n| ------ | ------ | ---- | ---- | ---- |\n"
        "| verdict | settled frame to verdict | 3 | 8.5 | 9 |\n| outbox | to outbox | 3 | 11 | 12 |\n"
        "| subscriber | to a subscriber | 3 | 12.5 | 14 |\n| picture | to its picture | 3 | 21 | 30 |\n"
    )
    medians = read_medians(page_of_bench)
    assert medians == {"verdict": 8.5, "outbox": 11, "subscriber": 12.5, "picture": 21}
    *panels, later = figure(rows, medians).axes
    assert [axes.get_xlim() for axes in panels] == [axes.get_xlim() for axes in figure(rows).axes]
    ends = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in later.patches]
    assert ends == [(8.5, medians[name]) for name in LATER]
    red, green, blue, _ = later.patches[0].get_facecolor()
    assert max(red, green, blue) - min(red, green, blue) < 0.05
