"""Validation 2 on a small dataset: rows, what few presses of the second position give, splits, and refusals."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import gelgate
from study_dataset import options, study_dataset

from calibration.experiments.harness.material import Material, material
from calibration.experiments.harness.rows import read_rows
from calibration.experiments.harness.study import make_cells
from calibration.experiments.studies.cross_position_study import (
    CrossPosition,
    hold_out_both,
    study_cross_position,
)
from edge.core.errors import DatasetError


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study_dataset(tmp_path_factory.mktemp("crossed"))


@pytest.fixture(scope="module")
def folder(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The output of the study, run twice."""
    asked = options(dataset, tmp_path_factory.mktemp("rows"), splits=("press", "specimen"))
    for _ in range(2):
        study_cross_position(asked)
    return asked.output


@pytest.fixture(scope="module")
def rows(folder: Path) -> list[dict[str, Any]]:
    return read_rows(folder / "rows.jsonl")


def test_there_is_a_row_for_every_share_seed_and_split(rows: list[dict[str, Any]]) -> None:
    """Run twice, each cell has one row, with the presses of both positions that it learnt from."""
    assert len(rows) == 4 * 2 * 2
    assert all("error" not in row for row in rows)
    by_press = [row for row in rows if row["split"] == "press"]
    assert {(row["target_fraction"], row["source_presses"], row["target_presses"]) for row in by_press} == {
        (0.0, 6, 0),
        (0.05, 6, 0),
        (0.1, 6, 1),
        (0.15, 6, 1),
    }
    assert {(row["test_nominal"], row["test_defective"]) for row in by_press} == {(4, 4)}


def test_a_press_of_the_second_position_helps_there(rows: list[dict[str, Any]]) -> None:
    """It rises on the second position alone and on both together; the first position keeps what it had."""
    none, one = (
        [row for row in rows if row["split"] == "press" and row["target_presses"] == count]
        for count in (0, 1)
    )

    def mean(some: list[dict[str, Any]], measure: str) -> float:
        return float(np.mean([row[measure] for row in some]))

    for measure in ("pixel_auroc_target", "pixel_auroc"):
        assert mean(one, measure) > mean(none, measure) + 0.05
    assert mean(one, "pixel_auroc_source") > mean(none, "pixel_auroc_source") - 0.05


def test_a_specimen_that_is_tested_at_one_position_is_learnt_at_none(tmp_path: Path) -> None:
    """Where the positions have other specimens, and so hold out different ones."""
    root = study_dataset(tmp_path / "data")
    for picture in (root / "PZ3" / "pos2" / "rgb_320x240").glob("*_s004_*"):
        picture.unlink()
    asked = options(root, tmp_path / "rows", splits=("specimen",))
    settings = {"target": "pos2", "target_fraction": 0.1}
    cell = make_cells("cross-position", asked, ("PZ3", "pos1"), [settings])[0]
    evaluate = CrossPosition(root, asked.features, asked.taps())
    found = [material(place) for place in evaluate.places(cell)]
    held = hold_out_both(found[0], found[1], cell)
    tested = [specimens(one, apart.test) for one, apart in zip(found, held, strict=True)]
    learnt = [specimens(one, apart.pool) for one, apart in zip(found, held, strict=True)]

    assert tested[0] != tested[1]
    assert all((*tested, *learnt))
    assert (tested[0] | tested[1]) & (learnt[0] | learnt[1]) == set()


def specimens(found: Material, rows: np.ndarray[Any, Any]) -> set[str | None]:
    return {found.presses.specimens[row] for row in rows}


def test_what_has_no_second_position_is_refused(dataset: Path, tmp_path: Path) -> None:
    """The part, the positions that it has, and what the study needs."""
    alone = study_dataset(tmp_path / "alone", positions=("pos1",))
    with pytest.raises(DatasetError, match=r"no part of dataset .* has a second position; this study needs"):
        study_cross_position(options(alone, tmp_path))
    with pytest.raises(DatasetError, match="PZ3 has the one position pos1"):
        study_cross_position(options(alone, tmp_path, parts=("PZ3",)))
    with pytest.raises(
        DatasetError, match="no position 'pos9' other than its source 'pos1'; it has pos1, pos2"
    ):
        study_cross_position(options(dataset, tmp_path, parts=("PZ3",), target="pos9"))


def test_the_command_needs_a_fraction(dataset: Path, tmp_path: Path) -> None:
    """From rows of good-fraction, or the operator's, in percent."""
    study = ("lab", "study", "cross-position", dataset, "-o", tmp_path / "new", "--method", "padim")

    assert (
        "run `gelgate lab study good-fraction` into the same folder, or give --fraction"
        in gelgate(*study).sentence()
    )
    assert (
        "--fraction is a percentage above 0 up to 100, such as 40, found 400"
        in gelgate(*study, "--fraction", 400).sentence()
    )
