"""Damaged presses among the nominal ones: how many, which are scored, and refusals."""

from pathlib import Path

import numpy as np
import pytest
from study_cells import quiet
from study_dataset import study_dataset

from calibration.experiments.harness.study import Options
from calibration.experiments.studies.bad_presses_study import (
    BAD_SHARES,
    halve,
    mix_presses,
    page,
    study_bad_presses,
)
from edge.core.errors import DatasetError


def test_no_damaged_press_is_learnt_and_scored() -> None:
    """The halves are the same in every cell, and together they are all."""
    bad, tested = halve(np.arange(100, 107))

    assert set(bad) & set(tested) == set()
    assert sorted([*bad, *tested]) == list(range(100, 107))
    assert (len(bad), len(tested)) == (3, 4)
    with pytest.raises(DatasetError, match="needs two defective presses"):
        halve(np.array([100]))


@pytest.mark.parametrize(("share", "count"), [(0.0, 0), (0.001, 1), (0.05, 1), (0.10, 2)])
def test_damaged_presses_take_the_place_of_nominal_ones(share: float, count: int) -> None:
    """20 presses, whatever the share; at least one is damaged where any is."""
    rows = mix_presses(np.arange(20), np.arange(100, 103), share, seed=1)

    assert len(set(rows)) == 20
    assert int((rows >= 100).sum()) == count
    assert (
        not np.array_equal(rows, mix_presses(np.arange(20), np.arange(100, 103), share, seed=2)) or not count
    )


def test_more_than_there_are_is_refused() -> None:
    with pytest.raises(DatasetError, match="50% of 20 presses are 10 damaged ones; 3 can be learnt from"):
        mix_presses(np.arange(20), np.arange(100, 103), 0.5, seed=0)


def test_the_study_has_rows_and_a_page(tmp_path: Path) -> None:
    """One damaged press of six makes the damage harder to find."""
    pd = pytest.importorskip("pandas", reason="SKIPPED, NOT TESTED: the extra `studies` brings pandas")
    dataset = study_dataset(tmp_path / "data", positions=("pos1",))
    asked = Options(
        dataset=dataset,
        output=tmp_path / "rows",
        methods=("subspace",),
        seeds=1,
        held_out=2,
        fraction=1.0,
        show=quiet,
    )
    rows = study_bad_presses(asked).read()
    text = page(pd.DataFrame(rows)).text

    assert [(row["bad"], row["bad_presses"], row["presses"]) for row in rows] == [
        (share, min(1, share * 100), 6) for share in BAD_SHARES
    ]
    assert {row["test_defective"] for row in rows} == {1}
    assert f" PZ3  | {rows[0]['aupro_001']:.4f} | {rows[1]['aupro_001']:.4f} |" in text
    assert "Share of the nominal presses: subspace 100 %." in text
