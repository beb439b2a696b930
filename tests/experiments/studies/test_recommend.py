"""`gelgate lab recommend`: answers from rows alone, which turn with the rows, and say where the rows do not decide."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from command_line import gelgate

from calibration.experiments.harness.rows import Rows
from calibration.experiments.studies.recommend import NEEDS, Answer, page, recommend

METHODS = ("spade", "padim", "fapm")


def recommended(rows: list[dict[str, Any]], needs: list[str]) -> list[Answer]:
    return recommend(pd.DataFrame(rows), needs)


def rows_of(
    study: str,
    levels: Mapping[str, float],
    measure: str = "aupro_001",
    parts: tuple[str, ...] = ("PZ3", "PZ4", "PZ5"),
    **more: Any,
) -> list[dict[str, Any]]:
    """Rows of ten seeds; a method's measure is its level and a small step per seed."""
    return [
        {
            "key": json.dumps([study, method, part, seed, measure, more], sort_keys=True),
            "study": study,
            "part": part,
            "position": "pos1",
            "method": method,
            "mode": "corrected",
            "backbone": "tactile_resnet18",
            "split": "press",
            "seed": seed,
            measure: level + 0.001 * seed,
            **more,
        }
        for part in parts
        for method, level in levels.items()
        for seed in range(10)
    ]


def covering(need: str, levels: Mapping[str, float]) -> list[dict[str, Any]]:
    """Rows that answer the first question of a need with these levels."""
    match need:
        case "few-presses":
            return rows_of("good-fraction", levels, shots=8)
        case "localisation":
            return rows_of("good-fraction", levels, fraction=1.0)
        case "cross-position":
            return rows_of("cross-position", levels, target_fraction=0.0)
        case "high-resolution":
            return rows_of("resolution", levels, "aupro_001_common", view="hr_tiled")
        case "no-fixture":
            return rows_of("good-fraction", levels, parts=("PZ5",), fraction=0.95)
        case "least-time":
            seconds = {m: 1 - v for m, v in levels.items()}
            tested = {"test_nominal": 20, "test_defective": 12}
            return rows_of("good-fraction", seconds, "cpu_score_s", fraction=1.0, **tested)
        case "bad-presses":
            return rows_of("bad-presses", levels, bad=0.1)
    raise AssertionError(need)


@pytest.mark.parametrize("need", NEEDS)
@pytest.mark.parametrize("best", METHODS)
def test_the_answer_turns_with_the_rows(need: str, best: str) -> None:
    """Whichever method has the better numbers is the answer, for every need."""
    rows = covering(need, {method: 0.8 if method == best else 0.6 for method in METHODS})
    standing = recommended(rows, [need])[0].standing

    assert standing is not None
    assert standing.best == best


@pytest.mark.parametrize("need", NEEDS)
def test_rows_that_overlap_do_not_decide(need: str) -> None:
    """Two methods with the same numbers: undecided, with both names."""
    answer = recommended(covering(need, {"spade": 0.8, "padim": 0.8, "fapm": 0.2}), [need])[0]

    assert answer.standing is not None
    assert answer.standing.best is None
    assert "undecided between spade and padim:" in answer.verdict


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        ({"spade": 0.8, "padim": 0.8}, "padim then: it is the default of `gelgate fit`, 0.000 below the highest mean."),
        ({"padim": 0.8, "fapm": 0.8}, "padim then: it is the default of `gelgate fit`, and has the highest mean."),
        ({"spade": 0.8, "fapm": 0.8, "padim": 0.2}, "spade then: it has the highest mean."),
    ],
)  # fmt: skip
def test_an_undecided_answer_says_what_to_take(levels: dict[str, float], expected: str) -> None:
    """The default where it is as good, else the highest mean."""
    answer = recommended(covering("localisation", levels), ["localisation"])[0]

    assert answer.then == f"Take {expected}"


@pytest.mark.parametrize("need", NEEDS)
def test_a_need_that_the_rows_do_not_cover_names_its_command(need: str) -> None:
    """Rows of another study answer nothing."""
    for answer in recommended(rows_of("other", {"spade": 0.5}), [need]):
        assert answer.standing is None
        assert "the rows do not cover this; `gelgate lab study" in answer.verdict


def test_a_gain_is_the_difference_of_two_conditions() -> None:
    """A method that is worse everywhere can gain most."""
    before = rows_of("cross-position", {"spade": 0.6, "padim": 0.1}, target_fraction=0.0)
    after = rows_of("cross-position", {"spade": 0.65, "padim": 0.5}, target_fraction=0.05)
    zero_shot, gain = (answer.standing for answer in recommended([*before, *after], ["cross-position"]))

    assert zero_shot is not None
    assert gain is not None
    assert (zero_shot.best, gain.best) == ("spade", "padim")
    assert gain.means["padim"].value == pytest.approx(0.4)


def test_the_head_is_timed_in_processor_seconds() -> None:
    """A machine that does other work slows the clock of one method more than of another; 3.2 s of 32 presses."""
    rows = [
        row | {"score_ms": 1.0 if row["method"] == "spade" else 50.0}
        for row in covering("least-time", {"spade": -2.2, "padim": 0.2})
    ]
    standing = recommended(rows, ["least-time"])[0].standing

    assert standing is not None
    assert standing.best == "padim"
    assert standing.means["spade"].value == pytest.approx(100, rel=0.01)


def test_all_presses_of_one_part_do_not_decide() -> None:
    """Ten seeds of one bank say nothing about other presses; with a half of the pool they are draws."""
    rows = rows_of(
        "resolution", {"spade": 0.9, "padim": 0.1}, "aupro_001_common", parts=("PZ3",), view="hr_tiled"
    )
    fixed, drawn = (
        recommended(
            [row | {"presses": count, "pool": 110, "most_presses": 12} for row in rows], ["high-resolution"]
        )[0]
        for count in (12, 6)
    )

    assert "learn the same presses" in fixed.verdict
    assert drawn.verdict == "spade"


def test_cells_that_were_refused_are_no_evidence() -> None:
    """A row with an error counts as missing."""
    rows = [
        row | {"error": "cannot be fitted"} for row in covering("localisation", {"spade": 0.9, "padim": 0.1})
    ]

    assert recommended(rows, ["localisation"])[0].standing is None


def written(folder: Path, rows: list[dict[str, Any]]) -> str:
    file = Rows(folder / "rows.jsonl")
    for row in rows:
        file.append(row)
    return str(folder)


def test_rows_of_several_setups_are_not_mixed(tmp_path: Path) -> None:
    """The operator chooses the mode; what the rows do not have is refused."""
    rows = covering("localisation", {"spade": 0.8, "padim": 0.6})
    paper = [
        r | {"mode": "paper", "key": f"{r['key']} paper"} for r in covering("localisation", {"padim": 0.9})
    ]
    folder = written(tmp_path, [*rows, *paper])

    assert (
        "several values of mode: corrected, paper; choose one with --mode"
        in gelgate("lab", "recommend", folder).sentence()
    )
    assert (
        "**spade**"
        in gelgate("lab", "recommend", folder, "--mode", "corrected", "--need", "localisation").out
    )
    assert (
        "no row has the split 'specimen'"
        in gelgate("lab", "recommend", folder, "--mode", "paper", "--split", "specimen").sentence()
    )


def test_rows_of_other_settings_are_not_mixed(tmp_path: Path) -> None:
    """Two rows of one method, part and seed, such as with two fractions, decide nothing; other needs are answered."""
    once = covering("cross-position", {"spade": 0.8, "padim": 0.6})
    again = [row | {"fraction": 0.4, "key": f"{row['key']} 0.4"} for row in once]
    rows = [*once, *again, *covering("localisation", {"spade": 0.8, "padim": 0.6})]

    said = gelgate("lab", "recommend", written(tmp_path, rows)).out
    assert "undecided: two rows of cross-position have spade on PZ3 with seed 0 and other settings" in said
    assert "**spade**" in said
    assert "| undecided: two rows of cross-position" in page(pd.DataFrame(rows)).text


def test_two_rows_with_the_same_result_are_one() -> None:
    """Two fractions above the cap of a pool learn the same presses: the second row adds nothing."""
    once = [
        row | {"scores_sha256": row["key"]}
        for row in covering("high-resolution", {"spade": 0.8, "padim": 0.6})
    ]
    again = [row | {"fraction": 0.8} for row in once]
    standing = recommended([*once, *again], ["high-resolution"])[0].standing

    assert standing is not None
    assert standing.best == "spade"


def test_what_is_no_rows_or_no_need_is_refused(tmp_path: Path) -> None:
    """One sentence, with the nearest known name."""
    assert "there are no rows at" in gelgate("lab", "recommend", tmp_path).sentence()
    assert (
        "did you mean 'few-presses'?"
        in gelgate("lab", "recommend", tmp_path, "--need", "few-pressse").sentence()
    )


def test_bad_presses_are_compared_at_a_share_that_every_method_has() -> None:
    """One method alone has a row of the largest share: the next one is compared."""
    levels = {method: 0.8 if method == "spade" else 0.6 for method in METHODS}
    rows = rows_of("bad-presses", levels, bad=0.05) + rows_of("bad-presses", {"padim": 0.9}, bad=0.1)
    standing = recommended(rows, ["bad-presses"])[0].standing

    assert standing is not None
    assert standing.best == "spade"
