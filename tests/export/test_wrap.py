"""A third party's graph becomes a bundle: its method, a threshold by gelgate, the same checks."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import onnx.parser
import pytest
import tiny
from command_line import gelgate, ran

from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.errors import BundleCorrupt, FitError
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from export.finish import WrapConfig, wrap_files

CONFIG = WrapConfig("bolt", "crest", tiny.PROFILE, tiny.REGION, "theirs")


def graph(batch: str = "n") -> bytes:
    """Brightness as the score map: what someone else might export. batch: `n`, or a fixed number of frames."""
    return onnx.parser.parse_model(f"""
        < ir_version: 8, opset_import: ["" : 17] >
        theirs (uint8[{batch}, h, w, 3] frames) => (float[{batch}, h, w] score_map, float[{batch}] score)
        {{
            pixels = Cast <to = 1> (frames)
            score_map = ReduceMean <axes = [3], keepdims = 0> (pixels)
            score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
        }}
    """).SerializeToString()


def steps(n: int) -> NominalPresses:
    """n frames of grey level 101, 102, ... n: their brightness is their score."""
    frames = np.stack([np.full((32, 32, 3), 101 + k, np.uint8) for k in range(n)])
    return NominalPresses(frames, tuple(map(str, range(n))))


def test_the_threshold_is_the_conformal_quantile_of_its_scores() -> None:
    """39 presses of brightness 101 to 139: rank 38 is 138, and the scores are the graph's own."""
    manifest = wrap_files(graph(), steps(39), CONFIG, created="2026-01-01").manifest
    assert manifest.threshold.value == pytest.approx(138)
    assert manifest.threshold.method == "split-conformal quantile, rank 38 of 39"
    assert (manifest.method, manifest.backbone, manifest.bank) == ("theirs", None, {})


@pytest.mark.parametrize("batch", ["n", "1"])
def test_it_is_scored_and_checked_like_any_other(batch: str) -> None:
    """Golden frames hold, also for a graph that takes one frame at a time."""
    bundle = wrap_files(graph(batch), steps(5), CONFIG, created="").bundle()
    scorer = Scorer(bundle)
    assert scorer.check_golden() == 0.0
    assert scorer.score(np.full((32, 32, 3), 7, np.uint8)).anomaly_score == 7


def test_a_graph_that_breaks_the_contract_is_a_sentence() -> None:
    """Another input name, found before any press is scored."""
    model = onnx.load_from_string(graph())
    model.graph.input[0].name = "image"
    model.graph.node[0].input[0] = "image"
    with pytest.raises(BundleCorrupt, match="expected one, 'frames' uint8"):
        wrap_files(model.SerializeToString(), steps(5), CONFIG, created="")


def test_too_few_presses_and_a_given_threshold() -> None:
    """One press gives no threshold, but a stated one is taken."""
    with pytest.raises(FitError, match="gives no threshold"):
        wrap_files(graph(), steps(1), CONFIG, created="")
    given = dataclasses.replace(CONFIG, threshold=200.0)
    assert wrap_files(graph(), steps(1), given, created="").manifest.threshold.value == 200


def test_the_command_makes_a_bundle_that_verifies(tmp_path: Path) -> None:
    """`gelgate bundle wrap`, then `gelgate bundle verify`; a missing graph is a sentence."""
    (tmp_path / "good").mkdir()
    for k in range(4):
        cv2.imwrite(str(tmp_path / "good" / f"{k}.png"), np.full((240, 320, 3), 100 + k, np.uint8))
    (tmp_path / "detector.onnx").write_bytes(graph())

    options = ("-o", tmp_path / "bolt.zip", "--part", "bolt", "--profile", "cropped_lr", "--licence", "own")
    ran("bundle", "wrap", tmp_path / "detector.onnx", tmp_path / "good", *options)
    assert Bundle.load(tmp_path / "bolt.zip").manifest.method == "external"
    ran("bundle", "verify", tmp_path / "bolt.zip")
    missing = gelgate("bundle", "wrap", tmp_path / "none.onnx", tmp_path / "good", *options, "--overwrite")
    assert "none.onnx" in missing.sentence()
