"""A complete run on a small dataset: rows, resuming, the bundle of a point, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tradeoff_dataset import make_dataset

from calibration.experiments.tradeoff.command import bundle_of
from calibration.experiments.tradeoff.front import WAITED, read_rows, write_rows
from calibration.experiments.tradeoff.plan import Run, TradeoffArguments, usual_points
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint
from calibration.experiments.tradeoff.presses import choose_presses, on_common_grid
from calibration.experiments.tradeoff.run import measure, require_same_run
from calibration.progress import progress
from edge.core.errors import ConfigError, DatasetError

POINTS = (
    OperatingPoint("padim", "tactile_resnet18", presses=5),
    OperatingPoint("padim", "tactile_resnet18_int8", presses=5, settings=(("rank", 4),)),
)


def run_of(dataset: Path, points: tuple[OperatingPoint, ...] = POINTS, **changed: Any) -> Run:
    return replace(Run.of(TradeoffArguments(dataset, rounds=7, bootstrap=20, **changed)), points=points)


@pytest.fixture(scope="module")
def measured(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    """The folder of a run, and its rows."""
    folder = tmp_path_factory.mktemp("run")
    return folder, measure(run_of(dataset), folder, progress)


def test_every_point_has_a_complete_row(measured: tuple[Path, list[dict[str, Any]]]) -> None:
    """Four measures with intervals, three stages, sizes, hashes and a floor."""
    _, rows = measured
    assert [row["key"] for row in rows] == [point.key for point in POINTS]
    for row in rows:
        assert all(one["low"] <= one["value"] <= one["high"] for one in row["accuracy"].values())
        assert row["accuracy"]["image_auroc"]["value"] > 0.9
        assert list(row["stages"]) == list(WAITED)
        assert row["floor"]["ms"] > 0  # below the median only where other work left the machine alone
        assert row["bank_bytes"] > 1000
        assert row["peak_memory_bytes"] > 10_000_000
        assert row["rounds"] == 7
        assert row["machine"]["threads"] == 2
    assert rows[0]["work"]["float32"] > rows[1]["work"]["float32"]
    assert rows[1]["work"]["int8"] > 0


def test_a_run_goes_on_where_it_was_interrupted(
    measured: tuple[Path, list[dict[str, Any]]], dataset: Path, tmp_path: Path
) -> None:
    """A point that has its row is not fitted again, and its accuracy stays; a torn last line is measured again."""
    folder, rows = measured
    kept = (folder / "points.jsonl").read_text().splitlines(keepends=True)
    marked = json.loads(kept[0]) | {"fit_s": {"features": 123.0, "bank": 0.0}}
    (folder / "points.jsonl").write_text(json.dumps(marked) + "\n" + kept[1][:40])
    again = measure(run_of(dataset), folder, progress)
    assert again[0]["fit_s"]["features"] == 123.0
    assert again[1]["fit_s"]["features"] != 123.0
    assert [row["accuracy"] for row in again] == [row["accuracy"] for row in rows]
    assert [row["content_sha256"] for row in again] == [row["content_sha256"] for row in rows]


def test_another_run_s_folder_is_refused(measured: tuple[Path, list[dict[str, Any]]], dataset: Path) -> None:
    """Points of two seeds would be mixed."""
    with pytest.raises(
        ConfigError, match="holds another unfinished run: other dataset, seed 0, not 1; remove it, or"
    ):
        measure(run_of(dataset, seed=1), measured[0], progress)


def test_finished_rows_of_another_run_are_refused(
    measured: tuple[Path, list[dict[str, Any]]], dataset: Path, tmp_path: Path
) -> None:
    """Other points than the command wants: said so, with what to do."""
    file = tmp_path / "rows.jsonl"
    write_rows(file, measured[1])
    require_same_run(read_rows(file), run_of(dataset), file)
    with pytest.raises(
        ConfigError, match=r"rows of another run \(points differ\); measure again with --overwrite"
    ):
        require_same_run(read_rows(file), run_of(dataset, POINTS[:1]), file)


def test_a_bundle_is_what_was_measured(measured: tuple[Path, list[dict[str, Any]]], dataset: Path) -> None:
    """The same trunk, head and bank, the accuracy card measured with the bundle itself, and the row's cost card."""
    row = measured[1][0]
    fitted = bundle_of(POINTS[0], run_of(dataset), row=row)
    manifest = fitted.bundle().manifest
    assert manifest.facts["tradeoff"]["content_sha256"] == row["content_sha256"]
    assert manifest.facts["tradeoff"]["stages"] == row["stages"]
    assert manifest.accuracy is not None
    value = row["accuracy"]["aupro_fpr01"]
    assert manifest.accuracy["aupro_fpr01"] == pytest.approx(value["value"], abs=1e-4)
    assert manifest.accuracy["aupro_fpr01_low"] == pytest.approx(value["low"], abs=1e-3)


def test_a_fit_has_no_piece_that_is_scored(dataset: Path) -> None:
    """Fitted and scored good presses share no specimen, and defective ones come last."""
    chosen = run_of(dataset).chosen
    assert not {press.specimen for press in chosen.fitted} & {press.specimen for press in chosen.scored}
    assert chosen.label.tolist() == sorted(chosen.label.tolist())
    assert chosen.sha256() == run_of(dataset).chosen.sha256()


def test_all_views_show_the_same_part_of_the_gel() -> None:
    """The high-resolution region covers the same millimetres; its maps are compared in low-resolution pixels."""
    low, high = VIEWS["lr"], VIEWS["hr"]
    assert (low.region.width, low.region.height) == (224, 224)
    assert high.region.width / high.profile.pixels_per_mm == pytest.approx(
        low.region.width / low.profile.pixels_per_mm
    )
    grown = np.repeat(np.repeat(np.arange(224 * 224, dtype=np.float32).reshape(224, 224), 3, 0), 4, 1)
    assert grown.shape == (high.region.height, high.region.width)
    assert on_common_grid(grown) == pytest.approx(grown[::3, ::4])


def test_a_usual_run_has_sixty_points_and_no_two_alike() -> None:
    """Also without high resolution and with 20 presses at most; every axis is varied."""
    from calibration.experiments.tradeoff.plan import BACKBONES
    from edge import registry

    methods = tuple(registry.names("detectors"))
    points = usual_points(BACKBONES, methods)
    few = usual_points(BACKBONES, methods, with_high=False, most=20)
    assert len(few) >= 60
    assert len({point.key for point in points}) == len(points)
    assert {point.view for point in points} == set(VIEWS)
    assert {point.mode for point in points} == {"corrected", "paper"}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"defective": 0}, "has no defective press of PZ9/pos1"),
        (
            {"is_masked": False},
            r"the masks of all 4 defective presses of PZ9/pos1 are empty in the inspected region",
        ),
        ({"pieces": 1}, "^PZ9/pos1: a split by specimen needs two specimens, found 1"),
        ({"pieces": 0}, r"has no nominal press of \*/\*; add pictures of sound parts"),
    ],
    ids=["no damage", "empty masks", "one piece", "none"],
)
def test_presses_showing_nothing_are_refused(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    """Before any work, in one sentence."""
    root = make_dataset(tmp_path / "bad", **changes)
    with pytest.raises(DatasetError, match=sentence):
        choose_presses(root, None, None, seed=0)
