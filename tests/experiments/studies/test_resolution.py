"""Validation 3 on a small dataset: the views, the common field of view, the cap, and refusals."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_dataset import options, study_dataset

from calibration.experiments.studies.resolution_study import (
    COMMON,
    VIEWS,
    ViewPlace,
    cap_presses,
    common_map,
    study_resolution,
)
from edge.core.errors import DatasetError


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study_dataset(tmp_path_factory.mktemp("fine"), positions=("pos1",))


@pytest.mark.parametrize("name", VIEWS)
def test_a_bright_place_is_at_its_place_in_the_common_map(name: str) -> None:
    """The middle of row 100, column 50 of the low resolution's crop, in every view."""
    view = VIEWS[name]
    across, down = (1, 1) if view.shape[0] <= 240 else (4, 3)
    x, y = (50 + 48 - view.region.x // across) * across, (100 + 8 - view.region.y // down) * down
    score_map = np.zeros(view.shape, np.float32)
    score_map[y : y + down, x : x + across] = 1
    found = common_map(score_map, view)
    rows, columns = np.indices(found.shape)
    centre = [float((axis * found).sum() / found.sum()) for axis in (rows, columns)]

    assert found.shape == (COMMON.height, COMMON.width)
    assert centre == pytest.approx([100.5 * 3 - 0.5, 50.5 * 4 - 0.5], abs=0.51)


def test_a_view_has_a_row_with_common_measures(dataset: Path, tmp_path: Path) -> None:
    """With the shipped trunk; the pool is capped, the same number of presses everywhere."""
    asked = options(dataset, tmp_path, seeds=1)
    views = ("lr", "hr_tiled", "lr_full")
    rows = study_resolution(replace(asked, views=views, presses=3)).read()

    assert [row["view"] for row in rows] == list(views)
    assert {(row["presses"], row["pool"], row["test_nominal"]) for row in rows} == {(3, 6, 2)}
    assert all(0.5 < row["pixel_auroc_common"] <= 1 for row in rows)
    assert rows[0]["pixel_auroc_common"] != rows[0]["pixel_auroc"]


def test_the_cap_keeps_the_test_presses(dataset: Path, tmp_path: Path) -> None:
    """Both resolutions have the same presses, whatever the cap."""
    kept = {
        (view, most): cap_presses(
            ViewPlace(dataset, tmp_path, "PZ3", "pos1", "tiny", (), view, "press", 3, most)
        )
        for view in ("lr", "hr_tiled")
        for most in (2, 4)
    }
    tested = {
        tuple(presses.pictures.presses[row].path.name for row in held.test)
        for presses, held, _ in kept.values()
    }

    assert len(tested) == 1
    assert {(most, len(held.pool)) for (_, most), (_, held, _) in kept.items()} == {(2, 2), (4, 4)}
    assert all(len(presses.defective) == 2 for presses, _, _ in kept.values())


def test_one_resolution_alone_is_refused(tmp_path: Path) -> None:
    """By name for a part that is asked for, with a way to get both otherwise."""
    root = study_dataset(tmp_path / "coarse", positions=("pos1",))
    for folder in ("rgb", "fault/rgb", "fault/mask"):
        shutil.rmtree(root / "PZ3" / "pos1" / folder)
    with pytest.raises(DatasetError, match=r"no position with both rgb \(1280x720\) and rgb_320x240"):
        study_resolution(options(root, tmp_path, seeds=1))
    with pytest.raises(DatasetError, match=r"PZ3/pos1 of dataset .* has pictures of one resolution only"):
        study_resolution(options(root, tmp_path, seeds=1, parts=("PZ3",)))
