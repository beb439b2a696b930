"""The merged graph: one file that scores as the bundle does, or none."""

import dataclasses
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import onnx
import onnx.parser
import pytest
import tiny
from command_line import ran
from graph_session import open_graph

from calibration.fitting.regions.drawing import draw_regions
from edge.core.drawn_regions import DrawnRegion
from edge.core.errors import BundleCorrupt, BundleMismatch
from edge.model.bundle import Bundle, GoldenFrame
from edge.model.bundle_writer import facts_of, rewrite_files, write_bundle
from edge.model.manifest import REGION_WEIGHTS
from edge.model.scorer import Scorer
from export import merge
from export.merge import merge_bundle, merged_graph


@pytest.fixture
def bundle() -> Bundle:
    golden = GoldenFrame(tiny.presses(1)[0], "a press", 0.0, ((0.0,),))
    return Bundle.in_memory(*tiny.tiny_files(tiny.tiny_bank(0.47, "int8"), golden=[golden]))


def test_any_runtime_gets_the_bundles_scores(bundle: Bundle) -> None:
    """Plain onnxruntime with one input: equal maps and scores, for any batch size."""
    frames = tiny.presses(3)
    session = open_graph(merged_graph(bundle))
    score_map, score = session.run(["score_map", "score"], {"frames": frames})
    expected = Scorer(bundle).score_batch(frames)
    np.testing.assert_allclose(score, [s.anomaly_score for s in expected], rtol=1e-6)
    np.testing.assert_allclose(score_map, [s.score_map for s in expected], rtol=1e-5, atol=1e-7)


def test_a_smoothed_bundle_smooths_in_the_graph(tmp_path: Path) -> None:
    """Of the camera's frame it gives the gateway's score; around a bundle the gateway smooths, and does so once."""
    frames, smoothed = (
        tiny.presses(2),
        Bundle.in_memory(*tiny.tiny_files(tiny.tiny_bank(0.47), is_smoothed=True)),
    )
    expected = [Scorer(smoothed).score(frame) for frame in frames]
    merge_bundle(smoothed, tmp_path / "detector.onnx")
    merge_bundle(smoothed, tmp_path / "single", as_bundle=True)
    session = open_graph(tmp_path / "detector.onnx")
    score_map, score = session.run(["score_map", "score"], {"frames": frames})
    np.testing.assert_array_equal(score, [one.anomaly_score for one in expected])
    np.testing.assert_array_equal(score_map, [one.score_map for one in expected])
    single = Scorer(Bundle.load(tmp_path / "single"))
    with pytest.raises(BundleMismatch, match=r"copy its detector\.onnx, before which frames are smoothed"):
        merged_graph(single.bundle)
    assert [single.score(frame).anomaly_score for frame in frames] == score.tolist()
    assert Scorer(smoothed).score_prepared(frames[0]).anomaly_score != score[0]


def test_drawn_regions_are_in_the_graph(bundle: Bundle, tmp_path: Path) -> None:
    """Another runtime weighs the map as the gateway does, which itself knows of the bundle around the graph what of a
    press is judged."""
    touching, gel = tiny.presses(1)[0], np.full((120, 160, 3), 128, np.uint8)
    touching[4:28, 4:16], touching[4:28, 16:28] = 255, 0
    golden = GoldenFrame(touching, "a press", 0.0, ((0.0,),))
    _, files = rewrite_files(bundle, facts_of(bundle.manifest), [golden], free_view=gel)
    path = write_bundle(tmp_path / "plain", files)
    seam = DrawnRegion("seam", "stricter", ((0.5, 0.5), (1.5, 0.5), (1.5, 1.5)), 3.0)
    logo = DrawnRegion("logo", "ignore", ((0.1, 0.1), (0.4, 0.1), (0.4, 0.4)))
    fitted = draw_regions(path, [seam, logo], None, 1)
    frames, drawn = tiny.presses(3), fitted.bundle()
    fitted.write(tmp_path / "drawn")
    ran("export", "merge", tmp_path / "drawn", "-o", tmp_path / "detector.onnx")
    ran("export", "merge", tmp_path / "drawn", "-o", tmp_path / "single", "--as-bundle")
    score_map, score = open_graph(tmp_path / "detector.onnx").run(["score_map", "score"], {"frames": frames})
    plain = np.stack([one.score_map for one in Scorer(bundle).score_batch(frames)])
    np.testing.assert_allclose(score_map, plain * drawn.bank[REGION_WEIGHTS], rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(score, score_map.max(axis=(1, 2)))
    assert (score_map != plain).any()
    single = Bundle.load(tmp_path / "single")
    assert [one.anomaly_score for one in Scorer(single).score_batch(frames)] == score.tolist()
    assert single.manifest.regions == drawn.manifest.regions
    np.testing.assert_array_equal(single.blind, drawn.blind)
    np.testing.assert_array_equal(single.free_region, drawn.free_region)


def test_the_file_says_what_it_is(bundle: Bundle) -> None:
    """Part, threshold and region travel inside the graph."""
    props = {p.key: p.value for p in onnx.load_from_string(merged_graph(bundle)).metadata_props}
    assert props["gelgate_bundle"] == bundle.digest
    assert (props["part"], props["threshold"], props["region"]) == ("bolt", "0.05", "8,4,32x32")


def test_trunk_and_head_of_different_opsets_are_merged(bundle: Bundle) -> None:
    """The older of the two is converted."""
    trunk = onnx.load_from_string(bundle.graphs.trunk)
    trunk.opset_import[0].version, trunk.ir_version = 18, 10
    newer = dataclasses.replace(
        bundle, graphs=dataclasses.replace(bundle.graphs, trunk=trunk.SerializeToString())
    )
    assert onnx.load_from_string(merged_graph(newer)).opset_import[0].version == 18


def test_merge_writes_the_file_and_a_bundle_around_it(bundle: Bundle, tmp_path: Path) -> None:
    """The command line: a bare file, or a bundle that gelgate itself scores and verifies."""
    good = dataclasses.replace(bundle, golden=())
    manifest, files = tiny.tiny_files()
    folder = write_bundle(tmp_path / "bolt", files)
    ran("export", "merge", folder, "-o", tmp_path / "detector.onnx")
    onnx.checker.check_model(str(tmp_path / "detector.onnx"))
    around = tmp_path / "single"
    ran("export", "merge", folder, "-o", around, "--as-bundle")
    single = Bundle.load(around)
    assert single.manifest.threshold == manifest.threshold
    frame = tiny.presses(1)[0]
    assert Scorer(single).score(frame).anomaly_score == pytest.approx(
        Scorer(Bundle.load(folder)).score(frame).anomaly_score, rel=1e-6
    )
    assert merge_bundle(good, tmp_path / "again.onnx") < 1e-6


def test_what_cannot_be_merged_is_refused(bundle: Bundle, tmp_path: Path) -> None:
    """A single graph, with what to copy instead; a bundle that registers its presses, as other programs do not."""
    merge_bundle(bundle, tmp_path / "single", as_bundle=True)
    with pytest.raises(BundleMismatch, match=r"copy its detector\.onnx"):
        merged_graph(Bundle.load(tmp_path / "single"))
    with pytest.raises(BundleMismatch, match="fit it again with --set register=never"):
        merged_graph(dataclasses.replace(bundle, registration=Mock()))


def test_a_graph_that_scores_otherwise_is_not_written(
    bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a limit that no graph keeps: no file, and a sentence."""
    monkeypatch.setattr(merge, "MERGED_RELATIVE", -1.0)
    with pytest.raises(BundleCorrupt, match="nothing is written"):
        merge_bundle(bundle, tmp_path / "detector.onnx")
    assert list(tmp_path.iterdir()) == []
