"""`gelgate evaluate` on the smallest bundle and a dataset whose scores can be worked by hand."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tiny
from command_line import gelgate

from calibration.evaluate.report import as_json, as_table, draw_sheet
from calibration.evaluate.scoring import Evaluation, evaluate_bundle
from calibration.folders import write_atomically
from calibration.progress import progress
from edge.core.drawn_regions import DrawnRegion, DrawnRegions
from edge.core.errors import DatasetError, GelgateError
from edge.core.registration.pose import Pose
from edge.model.bundle_writer import write_bundle
from edge.model.manifest import Provenance, ToleranceEntry

PASS, FAIL = [20, 120, 50], [185, 25, 30]
"""Colours of the verdicts in pictures of a station."""


def frame(path: Path, square: bool, rng: np.random.Generator) -> None:
    """A 48x40 grey frame with noise; a defect is a bright 8x8 cell of the region's grid."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = rng.integers(120, 136, (40, 48, 3), dtype=np.uint8)
    if square:
        pixels[12:20, 16:24] = 230
    cv2.imwrite(str(path), pixels)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """MVTec folders: 6 good presses of three specimens, 4 defective ones of two."""
    root = tmp_path / "bolt"
    rng = np.random.default_rng(0)
    for specimen in (1, 2, 3):
        for press in (1, 2):
            frame(root / "test" / "good" / f"bolt_test_s{specimen:03d}_p{press:02d}.png", False, rng)
    for specimen in (4, 5):
        for press in (1, 2):
            name = f"bolt_test_s{specimen:03d}_p{press:02d}"
            frame(root / "test" / "dent" / f"{name}.png", True, rng)
            mask = np.zeros((40, 48), np.uint8)
            mask[12:20, 16:24] = 255
            (root / "ground_truth" / "dent").mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(root / "ground_truth" / "dent" / f"{name}_mask.png"), mask)
    return root


def bundle(folder: Path, presses: tuple[str, ...] = (), **changes: object) -> Path:
    _, files = tiny.tiny_files(provenance=Provenance(created="2026-01-01", presses=presses), **changes)
    return write_bundle(folder / "bundle", files)


def run(at: Path, dataset: Path, **changes: object) -> Evaluation:
    options: dict[str, object] = {"part": "*", "position": "*", "limit": 0.01, "replicates": 50, "seed": 0}
    return evaluate_bundle(at, dataset, show=progress, **(options | changes))  # type: ignore[arg-type]


@pytest.fixture
def evaluation(tmp_path: Path, dataset: Path) -> Evaluation:
    return run(bundle(tmp_path, threshold=0.1), dataset)


def test_bright_squares_are_found_exactly(evaluation: Evaluation) -> None:
    """The one cell that differs is the mask: every measure is 1, no false alarm at 0.1, no miss."""
    values = {m.name: m.value for m in evaluation.measures}
    assert values == pytest.approx(dict.fromkeys(values, 1.0))
    assert (evaluation.false_alarms, evaluation.misses) == (0, 0)
    assert len(evaluation.scored) == 10


def test_a_press_fails_where_the_gateway_would_fail_it(tmp_path: Path, dataset: Path) -> None:
    """A good press at the threshold passes; within the tolerance of it no press passes or fails."""

    def judged(tolerance: float) -> Evaluation:
        folder = tmp_path / f"within {tolerance}"
        folder.mkdir()
        wide = ToleranceEntry(score=tolerance, score_map=1.0, relative=0.0, measured=0.0)
        return run(bundle(folder, threshold=largest, tolerance=wide), dataset)

    largest = max(s.anomaly_score for s in run(bundle(tmp_path), dataset).scored if not s.press.is_defective)
    exact, wide = judged(0.0), judged(100.0)
    assert (exact.false_alarms, exact.misses, exact.unsure) == (0, 0, (0, 0))
    assert (wide.false_alarms, wide.misses, wide.unsure) == (0, 0, (6, 4))
    assert "6 good and 4 defective ones are unsure" in as_table(wide)


@pytest.mark.parametrize("position", ["*", "test"])
def test_a_name_in_train_and_test_means_the_one_in_train(
    tmp_path: Path, dataset: Path, position: str
) -> None:
    """MVTec folders count from 000 in both; the file in train was fitted, and the one in test is scored."""
    rng = np.random.default_rng(1)
    for place in ("train", "test"):
        frame(dataset / place / "good" / "000.png", False, rng)
    evaluation = run(bundle(tmp_path, ("good/000.png",)), dataset, position=position)
    scored = [s.press.path.parts[-3] for s in evaluation.scored if s.press.path.name == "000.png"]
    assert (evaluation.left_out, scored) == (int(position == "*"), ["test"])
    of_test = run(bundle(tmp_path / "other", ("good/000.png",), position="test"), dataset, position="test")
    assert of_test.left_out == 1


def test_another_part_or_position_is_refused(tmp_path: Path, dataset: Path) -> None:
    """A bundle of bolt/crest is not scored on bolt/test unless asked; what the dataset has is listed."""
    at = bundle(tmp_path)
    with pytest.raises(
        DatasetError, match=r"no press of bolt/crest; it has bolt/test; the bundle is of bolt/crest"
    ):
        run(at, dataset, part=None, position=None)
    with pytest.raises(DatasetError, match=r"no press of nut/\*; it has bolt/test"):
        run(at, dataset, part="nut", position="*")
    assert len(run(at, dataset, part=None, position="test").scored) == 10
    assert len(run(at, dataset, part="*", position="*").scored) == 10


def test_fitted_presses_are_left_out(tmp_path: Path, dataset: Path) -> None:
    """A press named in the bundle's provenance is not scored; the other presses of its specimen are counted as seen."""
    evaluation = run(bundle(tmp_path, ("bolt_test_s001_p01.png",)), dataset)
    assert evaluation.left_out == 1
    assert "1 presses left out, because the bundle was fitted on presses of these names; only names are" in (
        as_table(evaluation)
    )
    assert evaluation.seen_specimens == 1
    assert "bolt_test_s001_p01.png" not in [s.press.path.name for s in evaluation.scored]
    (tmp_path / "short").mkdir()
    as_fit_names_it = run(bundle(tmp_path / "short", ("good/bolt_test_s001_p01.png",)), dataset)
    assert as_fit_names_it.left_out == 1
    everything = tuple(p.name for p in (dataset / "test").rglob("*.png"))
    (tmp_path / "all").mkdir()
    with pytest.raises(DatasetError, match="held out"):
        run(bundle(tmp_path / "all", everything), dataset)


def test_reports(tmp_path: Path, evaluation: Evaluation) -> None:
    """The table names every measure; the JSON has one entry per press and no absolute path; the sheet has
    the pictures of a station, sound presses above and below damaged ones."""
    table = as_table(evaluation)
    assert "no press left out: by folder and name none was in the fit; only names are" in table
    assert "aupro_fpr01" in table
    assert "0 of 6 good presses fail, 0 of 4 defective ones pass" in table
    document = json.loads(as_json(evaluation))
    assert len(document["presses"]) == 10
    assert document["measures"]["image_auroc"]["value"] == 1.0
    assert str(tmp_path) not in as_json(evaluation)
    sheet = cv2.imdecode(np.frombuffer(draw_sheet(evaluation), np.uint8), cv2.IMREAD_COLOR)
    assert sheet is not None
    rows = np.split(sheet, 4)
    assert [row[40, 3, ::-1].tolist() for row in rows] == [PASS, FAIL, FAIL, PASS]


def test_likely_mistakes_of_the_dataset_are_said(tmp_path: Path, dataset: Path) -> None:
    """Damage outside the inspected region, and a picture that is there twice."""
    (mask, *_) = sorted((dataset / "ground_truth" / "dent").iterdir())
    cv2.imwrite(str(mask), np.zeros((40, 48), np.uint8))
    good = dataset / "test" / "good"
    shutil.copy(good / "bolt_test_s001_p01.png", good / "bolt_test_s003_p09.png")
    evaluation = run(bundle(tmp_path, threshold=0.1), dataset)
    table = as_table(evaluation)
    assert "1 of the 4 defective presses of bolt has an empty mask in the inspected region" in table
    assert "bolt has 1 copy of other pictures, such as 'bolt_test_s003_p09.png'" in table
    assert {one.name: one.value for one in evaluation.measures}["aupimo_1e-5_1e-4"] == 1.0


@pytest.mark.parametrize("pose", [None, Pose(0.0, 0.0, 0.0), Pose(8.0, 0.0, 0.0)])
def test_the_sheet_has_the_outlines_of_drawn_regions(evaluation: Evaluation, pose: Pose | None) -> None:
    """In both panels, where the part lies."""
    evaluation = replace(evaluation, scored=evaluation.scored[:1])  # the panels of one press
    scale = evaluation.bundle.profile.mm_per_pixel[0]
    corners = tuple((x * scale, y * scale) for x, y in ((8, 8), (16, 8), (16, 16), (8, 16)))
    regions = DrawnRegions((DrawnRegion("logo", "ignore", corners),))
    manifest = evaluation.bundle.manifest.model_copy(update={"regions": regions})
    drawn = replace(
        evaluation,
        bundle=replace(evaluation.bundle, manifest=manifest),
        scored=tuple(replace(one, pose=pose) for one in evaluation.scored),
    )
    panel = 36 + 40  # below the row's heading and the head of the first picture
    before, after = (
        cv2.imdecode(np.frombuffer(draw_sheet(one), np.uint8), cv2.IMREAD_COLOR)[
            panel : panel + 384, : 384 + 8 + 384
        ].astype(int)
        for one in (evaluation, drawn)
    )

    changed = np.abs(after - before).sum(axis=2) > 60
    factor, moved = 384 / evaluation.bundle.manifest.frame[0], 0 if pose is None else round(pose.x_px)
    left, right, top = (round(factor * at) for at in (8 + moved, 16 + moved, 8))
    for x in (0, 384 + 8):
        found = np.flatnonzero(changed[:, x : x + 384][top + 20])
        assert {min(left, right, key=lambda at, x=x: abs(x - at)) for x in found} == {left, right}
        assert all(min(abs(x - left), abs(x - right)) <= 5 for x in found)


def test_only_good_presses_give_reasons(tmp_path: Path, dataset: Path) -> None:
    """Without defective presses the measures are undefined, and the table and JSON say why."""
    shutil.rmtree(dataset / "test" / "dent")
    shutil.rmtree(dataset / "ground_truth" / "dent")
    evaluation = run(bundle(tmp_path), dataset)
    assert "no defective press" in as_table(evaluation)
    assert json.loads(as_json(evaluation))["measures"]["image_auroc"]["value"] is None


def test_another_size_is_refused(tmp_path: Path, dataset: Path) -> None:
    """Pictures of another size than the bundle's profile are one sentence with both sizes."""
    rng = np.random.default_rng(1)
    cv2.imwrite(str(dataset / "test" / "good" / "big.png"), rng.integers(0, 9, (80, 96, 3), dtype=np.uint8))
    with pytest.raises(DatasetError, match=r"are not 48x40 .*big\.png' at 96x80"):
        run(bundle(tmp_path), dataset)


def test_command_line(tmp_path: Path, dataset: Path) -> None:
    """The verb prints the table and writes both files; a wrong part exits with 3 and names what there is; a report that
    cannot be written is refused before anything is scored."""
    out, sheet = tmp_path / "out.json", tmp_path / "sheet.png"
    at = bundle(tmp_path, threshold=0.1)
    words = "evaluate", at, dataset, "--bootstrap", "20", "--position", "test"
    done = gelgate(*words, "--json", out, "--sheet", sheet)
    assert done.code == 0
    assert "image_auroc" in done.out
    assert "scoring presses: 10 of 10" in done.err
    assert json.loads(out.read_text())["schema_version"] == 1
    assert sheet.stat().st_size > 1000

    other = gelgate(*words, "--part", "nut")
    assert (other.code, "it has bolt/test" in other.err) == (3, True)
    nowhere = gelgate("evaluate", at, dataset, "--json", tmp_path / "no" / "x.json")
    assert (nowhere.code, "name a file in an existing folder" in nowhere.err) == (3, True)
    assert "scoring presses" not in nowhere.err


def test_a_file_is_whole_or_absent(tmp_path: Path) -> None:
    """A place that is no folder is a sentence, and nothing is left behind."""
    write_atomically(tmp_path / "out.json", b"{}")
    with pytest.raises(GelgateError, match="cannot be written"):
        write_atomically(tmp_path / "out.json" / "other.json", b"{}")
    assert [p.name for p in tmp_path.iterdir()] == ["out.json"]
