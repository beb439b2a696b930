"""The verb: what it refuses before any work, what it writes, and what the README shows."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import gelgate
from tradeoff_rows import row, rows_of_a_run

from calibration.experiments.tradeoff.bench_command import read_medians
from calibration.experiments.tradeoff.figure import figure, say_cost, svg
from calibration.experiments.tradeoff.front import read_rows, write_rows
from calibration.experiments.tradeoff.plan import Run, TradeoffArguments
from edge.core.errors import ConfigError

ROOT = Path(__file__).resolve().parents[3]
PADIM = ("--method", "padim", "--backbone", "tactile_resnet18")


def tradeoff_of(*words: object) -> tuple[int, str]:
    """The exit code and everything printed."""
    ended = gelgate("lab", "tradeoff", *words)
    return ended.code, ended.out + ended.err


@pytest.fixture
def finished(dataset: Path, tmp_path: Path) -> Path:
    """A folder that looks like that of a finished run on the dataset with PaDiM alone."""
    run = Run.of(TradeoffArguments(dataset, method=["padim"], backbone=["tactile_resnet18"]))
    rows = [
        row(point.key, 0.6 + 0.01 * k, 15.0 + k, presses=point.presses, dataset_sha256=run.chosen.sha256())
        for k, point in enumerate(run.points)
    ]
    write_rows(tmp_path / "rows.jsonl", rows)
    return tmp_path


def test_rows_that_are_there_are_not_measured_again(finished: Path, dataset: Path) -> None:
    """The picture is made from them, and the front is listed."""
    code, said = tradeoff_of(dataset, "-o", finished, *PADIM)
    assert code == 0, said
    assert "--overwrite measures them again" in said
    assert "| on the front" in said
    assert (finished / "tradeoff.svg").read_bytes() == svg(read_rows(finished / "rows.jsonl"))


def test_what_may_be_a_mistake_in_the_dataset_is_said(
    finished: Path,
    dataset: Path,
    tmp_path: Path,
) -> None:
    """An empty mask, and a copy of a picture; the command goes on."""
    copy = Path(shutil.copytree(dataset, tmp_path / "copy"))
    home = copy / "PZ9/pos1"
    mask = min((home / "fault/mask_320x240").iterdir())
    cv2.imwrite(str(mask), np.zeros((240, 320), np.uint8))
    shutil.copy(home / "rgb_320x240/PZ9_pos1_s001_p01.png", home / "rgb_320x240/PZ9_pos1_s001_p02.png")
    presses = Run.of(TradeoffArguments(copy)).chosen.sha256()
    write_rows(
        finished / "rows.jsonl",
        [found | {"dataset_sha256": presses} for found in read_rows(finished / "rows.jsonl")],
    )

    words = (copy, "-o", finished, *PADIM)
    code, said = tradeoff_of(*words)

    assert code == 0, said
    assert "1 of the 4 defective presses of PZ9/pos1 has an empty mask" in said
    assert "PZ9/pos1 has 1 copy of other pictures" in said


def test_limits_that_nothing_meets_are_one_sentence(finished: Path, dataset: Path) -> None:
    """Exit code 3, the nearest point, no bundle."""
    words = (dataset, "-o", finished, *PADIM, "--within", "1ms")
    code, said = tradeoff_of(*words)
    assert code == 3
    assert "points is within these limits; the nearest is padim.tactile_resnet18.lr.5" in said
    assert not (finished / "bundle").exists()


def test_a_choice_writes_its_bundle_with_both_cards(finished: Path, dataset: Path) -> None:
    """The reasons are printed, and the manifest has accuracy and cost; the measured bank was another one, it says."""
    words = (dataset, "-o", finished, *PADIM, "--presses", "5")
    code, said = tradeoff_of(*words)
    assert code == 0, said
    assert "the limit on presses binds" in said
    assert "warning: the fit gave its bank more room" in said
    manifest = json.loads((finished / "bundle" / "manifest.json").read_text())
    assert manifest["accuracy"]["aupro_fpr01"] > 0
    assert manifest["facts"]["tradeoff"]["machine"]["processor"] == "Test processor"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--within", "fast"), "--within fast is not understood"),
        (("--under", "8"), "--under 8 is not understood"),
        (("--bundle", "b"), "--bundle needs a point"),
        (("--point", "padin.tactile_resnet18.lr.5"), "mean 'padim.tactile_resnet18.lr.5'?"),
        (("--method", "padin"), "no detector is named 'padin'"),
        (("--part", "PZ8"), "no nominal press of PZ8/*"),
    ],
    ids=["time", "size", "bundle", "point", "method", "part"],
)
def test_a_wrong_option_is_one_sentence(
    dataset: Path,
    tmp_path: Path,
    words: tuple[str, ...],
    sentence: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Exit code 3 before any work."""
    monkeypatch.chdir(tmp_path)
    code, said = tradeoff_of(dataset, *words)
    assert code == 3
    assert sentence in said
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "tradeoff" / "rows.jsonl").exists()


def test_rows_of_a_study_are_refused(tmp_path: Path) -> None:
    """Their format has the same number."""
    file = tmp_path / "rows.jsonl"
    file.write_text('{"format": 1, "key": "a", "study": "good-fraction"}\n')
    with pytest.raises(ConfigError, match="not hold the rows of a trade-off"):
        read_rows(file)


def test_rows_come_back_as_they_were_written(tmp_path: Path) -> None:
    """Nothing is lost but the seventh digit, and no temporary file is left."""
    rows = [row("a.t", 0.123456, 12.5), row("b.t", None)]
    write_rows(tmp_path / "rows.jsonl", rows)
    found = read_rows(tmp_path / "rows.jsonl")
    assert found[0]["accuracy"]["image_auroc"]["value"] == 0.123456
    assert found[1]["accuracy"]["image_auroc"] == {"value": None, "low": None, "high": None}
    assert [sorted(one) for one in found] == [sorted(one) for one in rows]
    assert [path.name for path in tmp_path.iterdir()] == ["rows.jsonl"]


def test_the_readme_shows_the_front_of_its_rows() -> None:
    """The picture, below 300 kB, is that of the rows and the bench's page; the sentence under it is theirs."""
    readme = (ROOT / "README.md").read_text()
    picture = ROOT / "docs/images/tradeoff.svg"
    assert 10_000 < picture.stat().st_size < 300_000
    rows: list[dict[str, Any]] = read_rows(ROOT / "docs/studies/tradeoff.jsonl")
    assert len(rows) >= 60
    assert f"{len(rows)} operating points" in svg_text(rows)
    assert say_cost(rows) in readme
    medians = read_medians((ROOT / "docs/performance.md").read_text())
    assert picture.read_bytes() == svg(rows, medians)


def test_a_point_without_accuracy_is_left_out_of_the_picture() -> None:
    rows = rows_of_a_run()
    marks = [len(axes.collections) for axes in figure(rows).axes]
    assert [len(axes.collections) for axes in figure([*rows, row("none.t", None)]).axes] == marks


def svg_text(rows: list[dict[str, Any]]) -> str:
    return " ".join(text.get_text() for text in figure(rows).texts)
