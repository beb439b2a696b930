"""The scorer: the values of the reference, the same answer every time, and an error, never a pass, without a score."""

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import onnx.parser
import pytest
import tiny

from edge.core.detector import Bank
from edge.core.errors import BundleCorrupt, NotScorable
from edge.model.bundle import Bundle, GoldenFrame, Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.scorer import Scorer, map_peaks
from edge.model.session import TrunkSessions


def bundle(**changes: object) -> Bundle:
    return Bundle.in_memory(*tiny.tiny_files(**changes))  # type: ignore[arg-type]


def with_head(body: str, inputs: str = "float[n, 3, 4, 4] layer1", **changes: object) -> Bundle:
    """A bundle whose head is written out in the test."""
    model = onnx.parser.parse_model(f"""
        < ir_version: 8, opset_import: ["" : 17] >
        head ({inputs}) => (float[n, H, W] score_map, float[n] score)
        <float[4] scales = {{1.0, 1.0, 8.0, 8.0}}, int64[1] one = {{1}}>
        {{ {body} }}
    """)
    graphs = dataclasses.replace(tiny.tiny_graphs(), head=model.SerializeToString())
    return bundle(graphs=graphs, **changes)


SOUND_BODY = """
    cell = ReduceL2 <axes = [1], keepdims = 1> (layer1)
    wide = Resize <mode = "nearest"> (cell, , scales)
    score_map = Squeeze (wide, one)
    score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
"""


def test_the_score_is_the_oracles() -> None:
    """Trunk and head together give the float64 reference within float32 rounding, map and score."""
    frames = tiny.presses(4)
    pooled = frames.reshape(4, 4, 8, 4, 8, 3).astype(np.float64).mean(axis=(2, 4)).transpose(0, 3, 1, 2) / 255
    truth = tiny.TINY.reference_score(
        {"layer1": pooled},  # type: ignore[dict-item]  # float64 on purpose
        tiny.tiny_grid(),
        tiny.tiny_bank(),
        tiny.TinyParameters(),
    )
    scored = Scorer(bundle()).score_batch(frames)
    np.testing.assert_allclose([s.anomaly_score for s in scored], truth.score, rtol=1e-5)
    np.testing.assert_allclose([s.score_map for s in scored], truth.score_map, atol=1e-6)
    assert scored[0].score_map.dtype == np.float32


def test_the_brightest_square_is_where_the_map_peaks() -> None:
    """A white square in a grey frame is found where it is, rows before columns."""
    frame = np.full((32, 32, 3), 128, np.uint8)
    frame[8:16, 24:32] = 255
    score_map = Scorer(bundle()).score(frame).score_map
    assert np.argwhere(score_map == score_map.max()).tolist() == [
        [r, c] for r in range(8, 16) for c in range(24, 32)
    ]


@pytest.mark.parametrize("packing", ["none", "float16", "int8"])
def test_runs_batches_and_threads_agree_within_the_tolerance(packing: str) -> None:
    """The same frame scores the same again, in a batch, and with another number of threads."""
    frames = tiny.presses(5)
    loaded = bundle(bank=tiny.tiny_bank(0.47, packing))  # type: ignore[arg-type]
    first = [Scorer(loaded, threads=2).score(frame) for frame in frames]
    again = Scorer(loaded, threads=1)
    for others in (
        [again.score(f) for f in frames],
        again.score_batch(frames),
        again.score_batch(frames[:2]),
    ):
        for one, other in zip(first, others, strict=False):
            allowed = loaded.manifest.tolerance.around(one.anomaly_score)
            assert abs(one.anomaly_score - other.anomaly_score) <= allowed
            assert np.abs(one.score_map - other.score_map).max() <= allowed


def test_a_score_is_kept_when_the_next_frame_is_scored() -> None:
    """The returned map is a copy, because the scorer uses its buffers again."""
    scorer, frames = Scorer(bundle()), tiny.presses(2)
    first = scorer.score(frames[0])
    kept = first.score_map.copy()
    scorer.score(np.zeros_like(frames[1]))
    np.testing.assert_array_equal(first.score_map, kept)


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((32, 32, 3), np.float32),
        np.zeros((32, 31, 3), np.uint8),
        np.zeros((32, 32), np.uint8),
        np.zeros((32, 32, 4), np.uint8),
    ],
)
def test_a_frame_of_another_kind_is_refused(frame: np.ndarray) -> None:
    expected = re.escape("scores uint8 (32, 32, 3) frames (h, w, 3), found")
    with pytest.raises(ValueError, match=expected):
        Scorer(bundle()).score(frame)


def test_a_score_that_is_not_finite_is_no_score() -> None:
    """A head that divides by zero gives NotScorable, never a number that could pass."""
    body = SOUND_BODY.replace("(layer1)", "(odd)")
    scorer = Scorer(with_head("zero = Sub (layer1, layer1)  odd = Div (layer1, zero)" + body))
    with pytest.raises(NotScorable, match="not finite"):
        scorer.score(tiny.presses(1)[0])


def test_one_bad_pixel_in_the_map_is_no_score() -> None:
    """The score alone can be finite where the map is not."""
    body = SOUND_BODY.replace("score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)", "")
    body = body.replace(
        "score_map = Squeeze (wide, one)", "squeezed = Squeeze (wide, one)  score_map = Log (squeezed)"
    )
    scorer = Scorer(with_head(body + "score = ReduceMax <axes = [1, 2], keepdims = 0> (squeezed)"))
    with pytest.raises(NotScorable, match="not finite"):
        scorer.score(np.zeros((32, 32, 3), np.uint8))


@pytest.mark.parametrize(
    ("body", "inputs", "reason"),
    [
        (SOUND_BODY, "float[n, 3, 4, 4] layer1, float[3] offset", "wants the input 'offset', the bank has"),
        (
            SOUND_BODY,
            "float[n, 3, 4, 4] layer1, float[3, 5, 4] mean",
            r"wants 'mean' as tensor\(float\) \[3, 5, 4\]",
        ),
        (SOUND_BODY, "float[n, 3, 4, 4] layer1, int64[3, 4, 4] mean", r"wants 'mean' as tensor\(int64\)"),
        (
            "cell = ReduceL2 <axes = [1], keepdims = 0> (layer1)  score_map = Identity (cell)"
            "  score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)",
            "float[n, 3, 4, 4] layer1",
            r"gives score_map float32 \(1, 4, 4\) .* expected float32 \(1, 32, 32\)",
        ),
        (SOUND_BODY, "float[n, 3, 5, 5] layer1", "do not run on a frame"),
        (SOUND_BODY.replace("layer1", "x"), "float[n, 3, 4, 4] x", "reads the taps"),
    ],
    ids=["unknown input", "bank shape", "bank dtype", "map shape", "tap shape", "no tap"],
)
def test_a_head_that_does_not_fit_is_refused_before_any_press(body: str, inputs: str, reason: str) -> None:
    """The scorer cannot be made; the error names what does not fit."""
    with pytest.raises(BundleCorrupt, match=reason):
        Scorer(with_head(body, inputs))


SCORELESS = """
    < ir_version: 8, opset_import: ["" : 17] >
    head (float[n, 3, 4, 4] layer1) => (float[n, 4, 4] score_map)
    { score_map = ReduceL2 <axes = [1], keepdims = 1> (layer1) }
"""


def trunk(change: Callable[[onnx.GraphProto], object]) -> bytes:
    """The tiny trunk, changed."""
    model = onnx.load_from_string(tiny.tiny_trunk())
    change(model.graph)
    return model.SerializeToString()


@pytest.mark.parametrize(
    ("graphs", "sentence"),
    [
        (
            {"head": onnx.parser.parse_model(SCORELESS).SerializeToString()},
            "expected 'score_map' and 'score'",
        ),
        (
            {"trunk": trunk(lambda graph: graph.output.pop(0))},
            r"reads the taps \['layer1'\], trunk.onnx gives \['layer2'\]",
        ),
        # Normalisation is inside: frames go in as they come from the camera.
        (
            {"trunk": trunk(lambda graph: setattr(graph.input[0].type.tensor_type, "elem_type", 1))},
            r"'frames' uint8 \(n, h, w, 3\)",
        ),
        ({"head": b"nonsense"}, r"head\.onnx is refused"),
    ],
    ids=["no score", "no tap", "floats", "no graph"],
)
def test_a_graph_that_does_not_fit_is_refused(graphs: dict[str, bytes], sentence: str) -> None:
    """Bytes with the right hash can still be nonsense."""
    with pytest.raises(BundleCorrupt, match=sentence):
        Scorer(bundle(graphs=dataclasses.replace(tiny.tiny_graphs(), **graphs)))


def golden(score_error: float = 0.0, map_error: float = 0.0) -> GoldenFrame:
    rgb = tiny.presses(1)[0]
    scored = Scorer(bundle()).score(rgb)
    peaks = np.array(map_peaks(scored.score_map))
    peaks[2, 5] += map_error
    return GoldenFrame(rgb, "a press", scored.anomaly_score + score_error, tuple(map(tuple, peaks.tolist())))


def test_golden_frames_are_scored_again() -> None:
    """The largest difference is returned; within the tolerance it is fine: processors round in different ways."""
    assert Scorer(bundle(golden=[golden()])).check_golden() == 0.0
    assert Scorer(bundle(golden=[golden(8e-6, 8e-6)])).check_golden() == pytest.approx(8e-6, rel=0.01)


@pytest.mark.parametrize(
    ("errors", "changes", "sentence"),
    [
        ((1e-3, 0.0), {}, r"golden frame 0 \(a press\) scores 0.0\d+, expected 0.0\d+ within"),
        ((0.0, 1e-3), {}, r"differs in block \(2, 5\)"),
        ((0.0, 0.0), {"map_peaks": ((0.5,),)}, r"golden map 0 is \(1, 1\), found \(8, 8\)"),
    ],
)
def test_another_golden_score_or_map_is_refused(
    errors: tuple[float, float], changes: dict[str, Any], sentence: str
) -> None:
    """Both scores are given, or the block in which the map differs."""
    frame = dataclasses.replace(golden(*errors), **changes)
    with pytest.raises(BundleCorrupt, match=sentence):
        Scorer(bundle(golden=[frame])).check_golden()


def test_map_peaks_are_block_maxima() -> None:
    """A map of 16 x 8 has blocks of 2 x 1; a map smaller than the blocks has one block per pixel."""
    score_map = np.arange(128, dtype=np.float32).reshape(16, 8)
    np.testing.assert_array_equal(map_peaks(score_map), score_map[1::2])
    assert map_peaks(np.array([[1.0, 2.0]], np.float32)) == ((1.0, 2.0),)


def test_bundles_of_one_line_share_one_trunk() -> None:
    """The second bundle is loaded without reading its trunk and scores through the first one's session."""
    trunks = TrunkSessions(threads=1)
    manifest, files = tiny.tiny_files(bank=tiny.tiny_bank(0.4))
    first = Scorer(bundle(), trunks=trunks)
    assert manifest.backbone is not None
    sha256 = manifest.backbone.trunk.sha256
    assert sha256 in trunks
    slim = Bundle.in_memory(manifest, files)
    slim = dataclasses.replace(slim, graphs=dataclasses.replace(slim.graphs, trunk=None))
    frame = tiny.presses(1)[0]
    second = Scorer(slim, trunks=trunks)
    assert second.score(frame).anomaly_score > first.score(frame).anomaly_score
    with pytest.raises(BundleCorrupt, match="was not loaded with the bundle"):
        Scorer(slim, trunks=TrunkSessions(threads=1))


def single_graph(body: str = "") -> Bundle:
    """A bundle of one graph from frames to score map, as a third party would export it."""
    model = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        theirs (uint8[n, h, w, 3] frames) => (float[n, h, w] score_map, float[n] score)
        <int64[1] last = {3}>
        {
            pixels = Cast <to = 1> (frames)
            score_map = ReduceMean <axes = [3], keepdims = 0> (pixels)
            score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
        }
    """)
    facts = tiny.tiny_facts(method="theirs", grid=None)
    return Bundle.in_memory(*bundle_files(facts, Graphs(detector=model.SerializeToString())))


def test_a_third_partys_single_graph_is_scored() -> None:
    """Frames in, score map and score out: no trunk, no bank, the same scorer."""
    frame = tiny.presses(1)[0]
    scored = Scorer(single_graph()).score(frame)
    np.testing.assert_allclose(scored.score_map, frame.mean(axis=2), rtol=1e-5)
    assert scored.anomaly_score == scored.score_map.max()


def test_a_bank_array_that_no_input_takes_does_no_harm() -> None:
    """Graph tools drop unused inputs; the array is then simply not bound."""
    bank = Bank({**tiny.tiny_bank().arrays, "spare": np.arange(3)})
    assert Scorer(bundle(bank=bank)).score(tiny.presses(1)[0]).anomaly_score > 0


def test_integers_and_flags_reach_the_head() -> None:
    """int64 and bool arrays are bound as they are."""
    body = """
        picked = Gather <axis = 1> (layer1, channels)
        zero = Sub (picked, picked)
        seen = Where (mask, picked, zero)
    """ + SOUND_BODY.replace("(layer1)", "(seen)")
    mask = np.zeros((1, 1, 4, 4), bool)
    mask[..., 1, 2] = True
    bank = Bank({"channels": np.array([0]), "mask": mask})
    inputs = "float[n, 3, 4, 4] layer1, int64[1] channels, bool[1, 1, 4, 4] mask"
    frame = np.full((32, 32, 3), 255, np.uint8)
    score_map = Scorer(with_head(body, inputs, bank=bank)).score(frame).score_map
    assert score_map.sum() == 64
    assert (score_map[8:16, 16:24] == 1).all()
