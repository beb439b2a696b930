"""Detectors that others exported to ONNX: the scale of the input is found or asked for; the adapted graph is equal."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnx.parser
import pytest
import tiny
from command_line import gelgate, ran
from numpy.typing import NDArray

from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.errors import ConfigError, FitError
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from export.finish import WrapConfig, wrap_files
from export.single_graph import Adapted, GraphInput, adapt

RNG = np.random.default_rng(0)
FRAMES = RNG.integers(100, 140, (6, 32, 32, 3), dtype=np.uint8)
CONFIG = WrapConfig("bolt", "crest", tiny.PROFILE, tiny.REGION, "theirs")


def parsed(text: str) -> bytes:
    return bytes(
        onnx.parser.parse_model(f'< ir_version: 8, opset_import: ["" : 17] > {text}').SerializeToString()
    )


def anomalib_like(size: int = 16, batch: str = "n") -> bytes:
    """The names and shapes of anomalib 2's exports: 0..1 in, four outputs, the map in the input's size."""
    return parsed(f"""
        theirs (float[{batch}, 3, {size}, {size}] input) => (float[{batch}] pred_score, bool[{batch}] pred_label,
            float[{batch}, 1, {size}, {size}] anomaly_map, bool[{batch}, 1, {size}, {size}] pred_mask)
        <float[3, 1, 1] mean = {{0.485, 0.456, 0.406}}, float half = {{0.5}}>
        {{
            centred = Sub (input, mean)
            strength = Abs (centred)
            anomaly_map = ReduceMean <axes = [1], keepdims = 1> (strength)
            pred_score = ReduceMax <axes = [1, 2, 3], keepdims = 0> (anomaly_map)
            pred_label = Greater (pred_score, half)
            pred_mask = Greater (anomaly_map, half)
        }}
    """)


def student_teacher(layout: str = "n, 3, h, w", ends: str = "map") -> bytes:
    """A float graph that says nothing about its input: the map is the distance from mid grey."""
    axis = 1 if layout.startswith("n, 3") else 3
    return parsed(f"""
        theirs (float[{layout}] image) => (float[n, a, b, c] {ends})
        <float grey = {{0.5}}>
        {{
            apart = Sub (image, grey)
            size = Abs (apart)
            {ends} = ReduceMean <axes = [{axis}], keepdims = 1> (size)
        }}
    """)


def presses(frames: NDArray[np.uint8] = FRAMES) -> NominalPresses:
    return NominalPresses(frames, tuple(map(str, range(len(frames)))))


def checked(ready: Adapted) -> Adapted:
    assert ready.parity is not None
    ready.parity.raise_if_different()
    names = [result.name for result in ready.parity.results]
    assert names == ["input", "map", "score", "order of the presses"]
    return ready


@pytest.mark.parametrize("batch", ["n", "1"])
def test_an_export_of_anomalib_is_known_by_its_outputs(batch: str) -> None:
    """0..1 without a question, resized to its size; map and score are its own, in the region's size."""
    ready = checked(adapt(anomalib_like(batch=batch), FRAMES))
    assert "an export of anomalib" in ready.found["input"]
    assert [one.domain for one in onnx.load_from_string(ready.graph).opset_import] == [""]
    bundle = wrap_files(ready.graph, presses(), CONFIG, created="").bundle()
    scored = Scorer(bundle).score(np.full((32, 32, 3), 255, np.uint8))
    assert scored.score_map.shape == (32, 32)
    assert scored.anomaly_score == pytest.approx(1 - np.mean([0.485, 0.456, 0.406]), abs=1e-5)


def test_what_the_file_does_not_show_is_asked_for() -> None:
    """A float input without a normalisation could be 0..1, 0..255 or normalised."""
    with pytest.raises(ConfigError, match=r"'image' is scaled; pass --input 0\.\.1"):
        adapt(student_teacher(), FRAMES)
    checked(adapt(student_teacher(), FRAMES, GraphInput("0..255")))
    with pytest.raises(ConfigError, match=r"--input is 0\.\.1, 0\.\.255, imagenet; found 'rgb'"):
        adapt(student_teacher(), FRAMES, GraphInput("rgb"))
    with pytest.raises(ConfigError, match=r"leave --input 0\.\.255 away"):
        adapt(student_teacher(), FRAMES, GraphInput("0..255", mean=(0, 0, 0)))


@pytest.mark.parametrize(
    ("mean", "words"), [("0.4, 0.5, 0.6", "0..1 (it norm"), ("100.0, 110.0, 120.0", "0..255 (it norm")]
)
def test_a_normalisation_inside_shows_the_scale(mean: str, words: str) -> None:
    """The mean that the graph subtracts is of 0..1, or of 0..255."""
    graph = parsed(f"""
        theirs (float[n, 3, h, w] x) => (float[n, 1, h, w] heat)
        <float[3, 1, 1] mean = {{{mean}}}>
        {{ y = Sub (x, mean)  z = Abs (y)  heat = ReduceMax <axes = [1], keepdims = 1> (z) }}
    """)
    assert words in checked(adapt(graph, FRAMES)).found["input"]


@pytest.mark.parametrize(
    ("given", "value"),
    [
        (GraphInput("0..1"), 0.3),
        (GraphInput("0..255"), 203.5),
        (GraphInput(mean=(0.5,) * 3, std=(0.1,) * 3), 2.5),
    ],
)
def test_the_stated_scale_is_used(given: GraphInput, value: float) -> None:
    """Frames of level 204: 0.8, 204, or (0.8 - 0.5) / 0.1, less a half."""
    ready = checked(adapt(student_teacher(), FRAMES, given))
    bundle = wrap_files(ready.graph, presses(), CONFIG, created="").bundle()
    assert Scorer(bundle).score(np.full((32, 32, 3), 204, np.uint8)).anomaly_score == pytest.approx(
        value, rel=1e-4
    )


def test_colours_last_and_bytes() -> None:
    """(n, h, w, 3) is found; a uint8 input needs no scale."""
    assert "nhwc" in checked(adapt(student_teacher("n, h, w, 3"), FRAMES, GraphInput("0..1"))).found["input"]
    graph = parsed("""
        theirs (uint8[n, 3, 16, 16] x) => (float[n, 16, 16] heat)
        { y = Cast <to = 1> (x)  heat = ReduceMean <axes = [1], keepdims = 0> (y) }
    """)
    assert "levels 0 to 255" in checked(adapt(graph, FRAMES)).found["input"]


def test_scores_that_fall_with_damage_are_refused() -> None:
    """A likelihood: negating it gives a bundle."""
    graph = parsed("""
        theirs (float[n, 3, h, w] input) => (float[n, 1, h, w] anomaly_map, float[n] pred_score)
        <float grey = {0.47}>
        {
            y = Sub (input, grey)  z = Abs (y)  far = ReduceMean <axes = [1], keepdims = 1> (z)
            anomaly_map = Neg (far)
            pred_score = ReduceMin <axes = [1, 2, 3], keepdims = 0> (anomaly_map)
        }
    """)
    with pytest.raises(
        FitError, match="scores fall where a press is damaged: a painted square lowers 6 of 6"
    ):
        wrap_files(adapt(graph, FRAMES).graph, presses(), CONFIG, created="")
    ready = checked(adapt(graph, FRAMES, GraphInput(is_negated=True)))
    manifest = wrap_files(ready.graph, presses(), CONFIG, created="").manifest
    assert manifest.threshold.value > 0


def test_limited_scores_and_blind_graphs_are_warned_of() -> None:
    """Scores that are cut at 0 and 1 say little; a graph that sees nothing has no known direction."""
    blind = parsed("""
        theirs (float[n, 3, h, w] input) => (float[n, 1, h, w] anomaly_map, float[n] pred_score)
        <float zero = {0.0}>
        {
            nothing = Mul (input, zero)
            anomaly_map = ReduceMean <axes = [1], keepdims = 1> (nothing)
            pred_score = ReduceMax <axes = [1, 2, 3], keepdims = 0> (anomaly_map)
        }
    """)
    said = " ".join(
        wrap_files(adapt(blind, FRAMES).graph, presses(), CONFIG, created="").manifest.provenance.warnings
    )
    assert "a painted square raises 0 and lowers 0 of 6 nominal scores: whether higher" in said
    assert "100% of the nominal presses have one score" in said


def test_a_direction_that_changes_from_press_to_press_is_warned_of() -> None:
    """The brightness: the square raises it in three dark presses, and lowers it in three bright ones."""
    brightness = parsed("""
        theirs (float[n, 3, h, w] input) => (float[n, 1, h, w] anomaly_map, float[n] pred_score)
        {
            anomaly_map = ReduceMean <axes = [1], keepdims = 1> (input)
            pred_score = ReduceMean <axes = [1, 2, 3], keepdims = 0> (anomaly_map)
        }
    """)
    frames = np.stack([np.full_like(FRAMES[0], level) for level in (60, 70, 80, 170, 180, 190)])
    ready = adapt(brightness, frames).graph

    said = " ".join(wrap_files(ready, presses(frames), CONFIG, created="").manifest.provenance.warnings)

    assert "a painted square raises 3 and lowers 3 of 6 nominal scores: whether higher" in said


@pytest.mark.parametrize(
    ("graph", "given", "words"),
    [
        (parsed("t (float[n, 3, 8, 8] x) => (float[n] s) { s = ReduceMax <axes = [1, 2, 3], keepdims = 0> (x) }"),
         GraphInput("0..1"), "needs a score map of floats"),
        (anomalib_like(), GraphInput(map_output="heat"), "no output 'heat'; it has pred_score float32"),
        (anomalib_like(), GraphInput(score_output="anomaly_map"), "'anomaly_map' is not one float per frame"),
        (parsed("t (float[n, 8] x) => (float[n, 8] y) { y = Abs (x) }"), None, "four axes"),
        (parsed("t (float[n, 5, 8, 8] x) => (float[n, 5, 8, 8] y) { y = Abs (x) }"), None, "three colours are"),
        (parsed("t (float[n, 3, 8, 8] x, float[n] k) => (float[n, 3, 8, 8] y) { y = Abs (x) }"), None, "one picture"),
        (b"not a graph", None, "refused"),
        (b"", None, "refused"),
    ],
)  # fmt: skip
def test_graphs_that_cannot_be_wrapped(graph: bytes, given: GraphInput | None, words: str) -> None:
    """What is there and what is expected, in one sentence."""
    with pytest.raises(ConfigError, match=words):
        adapt(graph, FRAMES, given)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda graph: setattr(graph.node[0], "domain", "com.example"), r"uses the operator domain 'com\.example'"),
        (lambda graph: setattr(graph.node[0], "op_type", "Subtract"), "No Op registered for Subtract"),
        (lambda graph: setattr(graph.initializer[0], "data_location", onnx.TensorProto.EXTERNAL),
         "keeps tensors in an external file"),
    ],
)  # fmt: skip
def test_foreign_operators_and_data_refused(change: Callable[[onnx.GraphProto], None], words: str) -> None:
    """Operators of other domains, and tensors in files next to the graph."""
    model = onnx.load_from_string(anomalib_like())
    change(model.graph)
    with pytest.raises(ConfigError, match=words):
        adapt(model.SerializeToString(), FRAMES)


def test_the_command_adapts_compares_and_records(tmp_path: Path) -> None:
    """`gelgate bundle wrap` of an anomalib-like file asks for the licence; the manifest has it and what was found."""
    (tmp_path / "good").mkdir()
    for k in range(4):
        frame = np.random.default_rng(k).integers(90, 130, (240, 320, 3), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / "good" / f"{k}.png"), frame)
    (tmp_path / "model.onnx").write_bytes(anomalib_like(64))

    options = ("-o", tmp_path / "b", "--part", "bolt", "--profile", "cropped_lr")
    words = ("bundle", "wrap", tmp_path / "model.onnx", tmp_path / "good", *options)
    assert "licence of the graph" in gelgate(*words).sentence()
    ran(*words, "--licence", "Apache-2.0", "--report", tmp_path / "report")
    manifest = Bundle.load(tmp_path / "b").manifest
    assert manifest.facts["licence"] == "Apache-2.0"
    assert manifest.facts["outputs"] == "map anomaly_map, score pred_score"
    assert (tmp_path / "report" / "parity.html").is_file()
    assert "weights Apache-2.0" in ran("bundle", "inspect", tmp_path / "b")
