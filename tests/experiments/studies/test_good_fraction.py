"""Validation 1 on a small dataset: rows, continuation, both splits, the paper's mode, and refusals."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from command_line import gelgate
from study_dataset import options, study_dataset

from calibration.experiments.harness.material import Material, overrides_for
from calibration.experiments.harness.pictures import LR_VIEW, PressPictures
from calibration.experiments.harness.presses import StudyPresses
from calibration.experiments.harness.rows import read_rows
from calibration.experiments.harness.study import check_same, make_cells
from calibration.experiments.studies.good_fraction_study import study_good_fraction
from calibration.experiments.studies.resolution_study import ViewPlace
from calibration.fitting.trunks import open_trunk
from edge.core.errors import ConfigError, DatasetError

METHODS = ("subspace", "padim")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study_dataset(tmp_path_factory.mktemp("presses"))


@pytest.fixture(scope="module")
def rows(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    asked = options(
        dataset, tmp_path_factory.mktemp("rows"), methods=METHODS, splits=("press", "specimen"), seeds=2
    )
    return study_good_fraction(replace(asked, fractions=(0.5, 1.0), shots=(1, 4, 32))).read()


def chosen(rows: list[dict[str, Any]], **wanted: object) -> list[dict[str, Any]]:
    return [row for row in rows if all(row.get(name) == value for name, value in wanted.items())]


def test_there_is_a_row_for_every_cell(rows: list[dict[str, Any]]) -> None:
    """Two methods, two splits, two seeds, two fractions and three numbers of shots, at the first position."""
    assert len(rows) == 2 * 2 * 2 * 5
    assert {(row["part"], row["position"]) for row in rows} == {("PZ3", "pos1")}


def test_presses_and_pool_are_in_the_row(rows: list[dict[str, Any]]) -> None:
    """Two of eight presses are held out, and the two defective ones are scored with them."""
    half = chosen(rows, split="press", fraction=0.5)
    assert {(r["presses"], r["pool"], r["test_nominal"], r["test_defective"]) for r in half} == {(3, 6, 2, 2)}
    assert {r["presses"] for r in chosen(rows, split="press", shots=4)} == {4}
    assert {r["specimens"] for r in chosen(rows, split="specimen", fraction=1.0)} == {3}


def test_the_seed_does_not_matter_where_nothing_is_random(dataset: Path, tmp_path: Path) -> None:
    """With all presses the published PCA subspace is one computation; with half of them it is not."""
    rows = study_good_fraction(
        options(dataset, tmp_path, modes=("paper",), fractions=(0.5, 1.0), shots=())
    ).read()

    assert len({row["scores_sha256"] for row in chosen(rows, fraction=1.0)}) == 1
    assert len({row["scores_sha256"] for row in chosen(rows, fraction=0.5)}) == 2


def test_a_study_continues_with_more_seeds(dataset: Path, tmp_path: Path) -> None:
    """The rows of the first seed stay as they were; two processes do the rest."""
    study_good_fraction(options(dataset, tmp_path, seeds=1, fractions=(1.0,), shots=()))
    before = read_rows(tmp_path / "rows.jsonl")
    study_good_fraction(options(dataset, tmp_path, seeds=3, jobs=2, fractions=(1.0,), shots=()))
    after = read_rows(tmp_path / "rows.jsonl")

    assert after[: len(before)] == before
    assert sorted(row["seed"] for row in after) == [0, 1, 2]


def test_one_and_two_processes_give_the_same_measures(dataset: Path, tmp_path: Path) -> None:
    """Only the costs differ."""
    found = []
    for jobs in (1, 2):
        asked = options(dataset, tmp_path / str(jobs), jobs=jobs, cache=tmp_path / "features")
        done = study_good_fraction(replace(asked, fractions=(0.5, 1.0), shots=())).read()
        found.append({row["key"]: (row["scores_sha256"], row["aupro_001"]) for row in done})

    assert found[0] == found[1]


def test_rows_of_other_pictures_are_not_continued(dataset: Path, tmp_path: Path) -> None:
    """A changed dataset gives other results; mixed rows would hide it."""
    copy = Path(shutil.copytree(dataset, tmp_path / "data"))
    study_good_fraction(options(copy, tmp_path / "out", seeds=1, fractions=(1.0,), shots=()))
    picture = min((copy / "PZ3/pos1/rgb_320x240").iterdir())
    cv2.imwrite(str(picture), np.full((240, 320, 3), 99, np.uint8))

    with pytest.raises(ConfigError, match="has rows of PZ3/pos1 from other pictures"):
        study_good_fraction(options(copy, tmp_path / "out", seeds=2, fractions=(1.0,), shots=()))


def test_rows_of_the_other_mode_are_added(dataset: Path, tmp_path: Path) -> None:
    """The published methods read deeper layers, so the trunk is cut after another one; its weights are the same."""
    study_good_fraction(options(dataset, tmp_path, seeds=1, fractions=(1.0,), shots=()))
    asked = options(dataset, tmp_path, methods=("padim",), modes=("paper",), seeds=1)
    rows = study_good_fraction(replace(asked, fractions=(1.0,), shots=())).read()

    assert [row["mode"] for row in rows] == ["corrected", "paper"]
    assert len({row["trunk_sha256"] for row in rows}) == 2


@pytest.mark.parametrize("view", ["lr", "hr_tiled"])
def test_rows_of_another_trunk_are_not_continued(tmp_path: Path, view: str) -> None:
    """Cuts of the same one are, as the view shows them to it."""
    place = ViewPlace(tmp_path, tmp_path, "PZ3", "pos1", "tactile_resnet18", (), view, "press", 2, 3)
    trunks = [place.show(open_trunk("tactile_resnet18", (tap,))) for tap in ("layer1", "layer3")]
    now = [
        Material(
            place, StudyPresses("PZ3", "pos1", PressPictures((), LR_VIEW), 0), trunks[0], cast(Any, None)
        )
    ]
    row = {"part": "PZ3", "position": "pos1", "backbone": "tactile_resnet18", "view": view, "split": "press"}
    row |= {"held_out": 2, "most_presses": 3}
    check_same([row | {"trunk_sha256": trunk.sha256[:16]} for trunk in trunks], now, tmp_path)

    with pytest.raises(ConfigError, match=r"has rows of PZ3/pos1 from another trunk \(0123456789abcdef, now"):
        check_same([row | {"trunk_sha256": "0123456789abcdef"}], now, tmp_path)


def test_empty_masks_are_a_sentence(dataset: Path, tmp_path: Path) -> None:
    """Before any cell runs."""
    copy = Path(shutil.copytree(dataset, tmp_path / "data"))
    for path in (copy / "PZ3/pos1/fault/mask_320x240").iterdir():
        cv2.imwrite(str(path), np.zeros((240, 320), np.uint8))

    with pytest.raises(DatasetError, match="the masks of all 2 defective presses of PZ3/pos1 are empty"):
        study_good_fraction(options(copy, tmp_path / "out", fractions=(1.0,), shots=()))
    assert not (tmp_path / "out/rows.jsonl").exists()


def test_likely_mistakes_are_said(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One empty mask, and a copy of a picture: the study runs, and says both."""
    copy = Path(shutil.copytree(dataset, tmp_path / "data"))
    home = copy / "PZ3/pos1"
    cv2.imwrite(str(home / "fault/mask_320x240/PZ3_pos1_s005_p01.png"), np.zeros((240, 320), np.uint8))
    shutil.copy(home / "rgb_320x240/PZ3_pos1_s001_p01.png", home / "rgb_320x240/PZ3_pos1_s002_p02.png")

    study_good_fraction(options(copy, tmp_path / "out", seeds=1, fractions=(1.0,), shots=()))

    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if "1 of the 2 defective presses of PZ3/pos1 has an empty mask" in line]
    assert [line for line in said if "copy of other pictures, such as 'PZ3_pos1_s002_p02.png'" in line]
    assert len(said) == 2


def test_an_output_that_is_a_file_is_refused_before_any_work(dataset: Path, tmp_path: Path) -> None:
    """Extraction takes minutes; the path is looked at first."""
    (tmp_path / "rows").write_text("notes")
    with pytest.raises(ConfigError, match="rows' is a file; name a folder"):
        options(dataset, tmp_path / "rows")


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--part", "PZ9"], "has no part 'PZ9'; "),
        (["--position", "pos7"], "has no press of PZ3/pos7; it has PZ3/pos1, PZ3/pos2"),
        (["--method", "padin"], "no method is named 'padin'; did you mean 'padim'?"),
        (["--mode", "papers"], "no mode is named 'papers'"),
        (["--split", "piece"], "no split is named 'piece'"),
        (["--backbone", "resnet"], "no backbone is named 'resnet'"),
        (["--fractions", "5:120:5"], "--fractions are percentages above 0 up to 100"),
        (["--fractions", "ten"], "--fractions are percentages above 0 up to 100"),
        (["--fractions", "10:5:1"], "--fractions are percentages above 0 up to 100"),
        (["--shots", "0"], "--shots are whole numbers of at least 1"),
        (["--fractions", "none", "--shots", "none"], "neither fractions nor shots are given"),
        (["--held-out", "8"], "has 8 nominal presses, and 8 are held out for the test"),
        (["--cache", "DATASET"], "is not empty and holds no cache of features"),
    ],
)
def test_bad_options_are_one_sentence(dataset: Path, tmp_path: Path, asked: list[str], said: str) -> None:
    """The exit code is that of a wrong configuration, and no row is written."""
    words = [str(dataset) if word == "DATASET" else word for word in asked]
    done = gelgate(
        "lab", "study", "good-fraction", str(dataset), "-o", str(tmp_path / "out"), "--held-out", "2", *words
    )

    assert done.code == 3
    assert said in done.err
    assert done.err.count("gelgate: ") == 1
    assert not (tmp_path / "out/rows.jsonl").exists()


def test_the_command_leaves_rows_and_says_where(dataset: Path, tmp_path: Path) -> None:
    """And `report` makes the page from them."""
    words = [
        "--held-out",
        "2",
        "--method",
        "subspace",
        "--seeds",
        "1",
        "--fractions",
        "50,100",
        "--shots",
        "32",
    ]
    done = gelgate("lab", "study", "good-fraction", str(dataset), "-o", str(tmp_path), *words)
    assert done.code == 0
    assert f"rows: {tmp_path / 'rows.jsonl'}" in done.out
    assert "cells: 3 of 3" in done.err
    assert (
        "1 of 3 cells have no score, such as: 32 presses are asked for, the pool of PZ3/pos1 has 6"
        in done.err
    )

    assert gelgate("lab", "report", str(tmp_path), "-o", str(tmp_path / "report")).code == 0
    assert "| subspace |" in (tmp_path / "report/good-fraction.md").read_text()


def test_the_published_inreach_reads_the_stages_of_a_smaller_backbone() -> None:
    """Its thirteen taps exist in a Wide-ResNet-50-2 alone; the other methods read what they publish."""
    changed = overrides_for("inreach", "paper", "tactile_resnet18")
    assert changed == {"taps": ("layer1", "layer2", "layer3"), "grid_tap": "layer2"}
    assert overrides_for("padim", "paper", "tactile_resnet18") == {}
    assert overrides_for("inreach", "corrected", "tactile_resnet18") == {}


def test_the_paper_mode_runs_with_the_shipped_backbone(dataset: Path, tmp_path: Path) -> None:
    """All four methods, on the same features."""
    asked = options(
        dataset, tmp_path, methods=("spade", "padim", "fapm", "inreach"), modes=("paper",), seeds=1
    )
    found = study_good_fraction(replace(asked, fractions=(1.0,), shots=())).read()

    assert {row["method"]: "error" in row for row in found} == dict.fromkeys(asked.methods, False)
    assert {row["method"]: row["changed"] for row in found if "changed" in row} == {
        "inreach": "taps layer1, layer2, layer3; grid_tap layer2"
    }


def test_cells_of_one_seed_come_before_those_of_the_next(tmp_path: Path) -> None:
    """An interrupted study has complete curves of fewer seeds."""
    asked = options(tmp_path, tmp_path / "rows", methods=METHODS, seeds=3)
    cells = make_cells("good-fraction", asked, ("PZ1", "pos1"), [{"fraction": 0.5}, {"shots": 1}])

    assert [cell.seed for cell in cells] == [0] * 4 + [1] * 4 + [2] * 4
    assert len({cell.key for cell in cells}) == 12
