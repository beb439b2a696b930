"""A graph that anomalib 2.7.0 exported, with its weights in a file next to it, becomes a bundle of raw scores."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnx.parser
import pytest
from anomalib_files import SMALL, pictures
from command_line import gelgate, ran

from edge.model.bundle import Bundle
from export.graph_file import read_graph
from export.normalised_scores import raw_scores
from export.onnx_values import run_values
from export.parity import Stage, compare
from export.single_graph import Adapted, adapt

EXPORTED = SMALL / "padim_onnx" / "model.onnx"
LABELS = {"pred_score": "pred_label"}
# Two runtimes, float32, relative to the largest score: measured 3e-7.
ALIKE = 1e-5


@pytest.fixture(scope="module")
def ready() -> Adapted:
    """PaDiM of anomalib, adapted to its own pictures."""
    return adapt(read_graph(EXPORTED), pictures(), None, "model.onnx")


def test_scores_are_anomalibs_before_its_normalisation(ready: Adapted) -> None:
    """Above 1 and unequal where anomalib's export gives 0 to every nominal picture."""
    expected = np.load(SMALL / "padim.npz")["exported_score"].astype(np.float64)
    original = onnx.load(EXPORTED)
    planes = (pictures().transpose(0, 3, 1, 2) / 255).astype(np.float32)
    (limited,) = run_values(original.SerializeToString(), ["pred_score"], {"input": planes}, "model.onnx")

    (found,) = run_values(ready.graph, ["score"], {"frames": pictures()}, "the adapted graph")

    compare([Stage("score", expected, found, "score", ALIKE)]).raise_if_different()
    assert (limited == 0).sum() > 6
    assert len(np.unique(found)) == len(found)


def test_normalisation_and_threshold_are_stated_and_compared(ready: Adapted) -> None:
    """The formula with its numbers gives the original's own outputs; the threshold is on the raw scale."""
    numbers = np.load(SMALL / "padim.npz")
    threshold, spread = float(numbers["image_threshold"]), float(numbers["image_max"] - numbers["image_min"])

    said = ready.found["normalisation"]
    assert f"(pred_score - {threshold:.7g}) / {np.float32(spread):.7g} + 0.5, limited to 0..1" in said
    assert f"--threshold {threshold:.7g}" in ready.found["threshold of the model"]
    assert ready.parity is not None
    ready.parity.raise_if_different()
    names = [result.name for result in ready.parity.results]
    assert names[1:3] == ["normalised pred_score", "normalised anomaly_map"]


def test_a_bundle_carries_no_trace_of_the_exporters_machine() -> None:
    """PyTorch notes files and lines of its run at every node."""
    model = onnx.load(EXPORTED)
    for node in model.graph.node:
        node.metadata_props.add(key="pkg.torch.onnx.stack_trace", value='File "/home/somebody/secret.py"')
        node.doc_string = "/home/somebody/secret.py"

    graph = adapt(model.SerializeToString(), pictures()).graph

    assert b"somebody" not in graph


def normalising(ending: str) -> onnx.ModelProto:
    """A score that is normalised as anomalib does it: threshold 3, spread 4, label above 0.75."""
    return onnx.parser.parse_model(f"""
        < ir_version: 8, opset_import: ["" : 17] >
        theirs (float[n, 3, 8, 8] input) => (float[n] pred_score, bool[n] pred_label)
        <float three = {{3.0}}, float four = {{4.0}}, float half = {{0.5}}, float zero = {{0.0}}, float one = {{1.0}},
         float most = {{0.75}}, bool yes = {{1}}, bool no = {{0}}>
        {{
            raw = ReduceMax <axes = [1, 2, 3], keepdims = 0> (input)
            low = Sub (raw, three)
            part = Div (low, four)
            middle = Add (part, half)
            {ending}
            pred_label = Greater (pred_score, most)
        }}
    """)


@pytest.mark.parametrize(
    "ending",
    [
        "pred_score = Clip (middle, zero, one)",
        "low1 = Min (middle, one)  pred_score = Max (low1, zero)",
        "kept = Clip (middle, zero, one)  pred_score = Where (yes, kept, raw)",
        "kept = Clip (middle, zero, one)  first = Where (no, raw, kept)  pred_score = Identity (first)",
    ],
)
def test_a_normalisation_is_found(ending: str) -> None:
    """As every exporter writes it; the label's limit of 0.75 is the raw score 3 + 0.25 * 4."""
    changed, found = raw_scores(normalising(ending), LABELS)

    one = found["pred_score"]
    assert (one.raw, one.threshold, one.spread, one.own_threshold) == ("raw", 3, 4, 4)
    picture = np.full((1, 3, 8, 8), 9, np.float32)
    (raw,) = run_values(changed.SerializeToString(), ["pred_score"], {"input": picture}, "changed")
    assert raw.tolist() == [9]


@pytest.mark.parametrize(
    "ending",
    [
        "kept = Clip (middle, zero, one)  pred_score = Where (no, kept, raw)",
        "pred_score = Identity (raw)",
        "pred_score = Mul (middle, half)",
    ],
)
def test_other_endings_stay(ending: str) -> None:
    """Where anomalib had no range it gives raw scores; another formula is not taken apart."""
    model = normalising(ending)

    assert raw_scores(model, LABELS) == (model, {})


def test_from_anomalibs_files_to_a_bundle(tmp_path: Path) -> None:
    """`gelgate bundle wrap` of the two files, with anomalib's own threshold; without the weights it is a sentence."""
    (tmp_path / "presses").mkdir()
    for number, frame in enumerate(pictures(6, 0)):
        picture = cv2.resize(frame[..., ::-1], (320, 240))
        cv2.imwrite(str(tmp_path / "presses" / f"{number}.png"), picture)
    for name in ("model.onnx", "model.onnx.data"):
        shutil.copy(EXPORTED.with_name(name), tmp_path / name)

    options = ("-o", tmp_path / "b", "--part", "bolt", "--profile", "cropped_lr", "--licence", "own")
    words = ("bundle", "wrap", tmp_path / "model.onnx", tmp_path / "presses", *options)
    said = ran(*words, "--region", "full", "--threshold", "17.8581")
    assert "normalisation: left out: (pred_score - 17.8581)" in said
    assert "threshold of the model: 17.8581 of raw scores" in said
    manifest = Bundle.load(tmp_path / "b").manifest
    assert manifest.threshold.value == 17.8581
    assert "limited to 0..1" in manifest.facts["normalisation"]
    (tmp_path / "model.onnx.data").unlink()
    lost = gelgate(*words, "--overwrite").sentence()
    assert "model.onnx.data, which is not next to it; copy both files" in lost
