"""A bundle in float16 or int8: measured, chosen by measurement, and refused where the maps differ too much."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
import tiny
from command_line import gelgate, ran
from onnx import numpy_helper

from calibration.quantise import halved, layers, quantise_graph
from edge.core.errors import BundleMismatch, FitError
from edge.core.imaging.marker_dots import MarkerDots
from edge.model.bundle import Bundle, GoldenFrame, Graphs
from edge.model.bundle_writer import bundle_files, write_bundle
from edge.model.detectability import CARD
from edge.model.manifest import DotsEntry
from edge.model.manifest_facts import DAMAGE_FOUND
from edge.model.scorer import Scorer, map_peaks
from export import precision as module
from export.precision import Measured, Precisions, choose_precision, in_precision, measure_precisions
from plugins.onnx_builder import Graph

RNG = np.random.default_rng(0)
FRAMES = RNG.integers(60, 200, (6, 32, 32, 3), dtype=np.uint8)


def network(outlier: float = 1.0) -> bytes:
    """Three convolutions to a score map. outlier: how much larger one channel of the second layer's input is."""
    rng = np.random.default_rng(1)
    g = Graph("network")
    x = g.transpose(g.op("Cast", g.input("frames", ("n", 32, 32, 3), "uint8"), to=1), 0, 3, 1, 2)
    x = g.op("Mul", x, g.scalar(1 / 255))
    gain = np.ones((8, 1, 1, 1))
    gain[0] = outlier
    for number, (inputs, outputs) in enumerate(((3, 8), (8, 8), (8, 1))):
        weight = np.abs(rng.normal(size=(outputs, inputs, 3, 3))) / inputs
        if number == 0:
            weight = weight * gain
        if number == 1:
            weight = weight / gain.transpose(1, 0, 2, 3)
        x = g.op("Conv", x, g.constant(weight.astype(np.float32)), pads=[1] * 4, kernel_shape=[3, 3])
        x = g.op("Relu", x)
    x = g.op("Squeeze", x, g.ints(1))
    g.output("score_map", x, ("n", 32, 32))
    g.output("score", g.op("ReduceMax", x, g.ints(1, 2), keepdims=0), ("n",))
    return g.serialise()


def bundle(graph: bytes) -> Bundle:
    facts = tiny.tiny_facts(threshold=4.0, grid=None)
    plain = Bundle.in_memory(*bundle_files(facts, Graphs(detector=graph)))
    score = Scorer(plain).score(FRAMES[0])
    golden = GoldenFrame(FRAMES[0], "a press", score.anomaly_score, map_peaks(score.score_map))
    return Bundle.in_memory(*bundle_files(facts, Graphs(detector=graph), golden=[golden]))


@pytest.fixture(scope="module")
def plain() -> Bundle:
    return bundle(network())


@pytest.fixture(scope="module")
def found(plain: Bundle) -> Precisions:
    return measure_precisions(plain, FRAMES)


def test_every_precision_is_measured(plain: Bundle, found: Precisions) -> None:
    """Bytes fall, differences rise: float32, half the bytes, int8; all layers are in int8 here."""
    full, half, whole = (found.of(one) for one in ("float32", "float16", "int8"))
    assert (full.map_difference, full.score_difference, full.rise) == (0, 0, 0)
    assert 0 < half.map_difference < 1e-3 < whole.map_difference < 0.05
    assert half.bytes < full.bytes
    assert whole.in_float == ()
    assert min(one.milliseconds for one in found.results) > 0
    assert "graph" not in whole.card()


def test_int8_is_in_the_graph_per_channel() -> None:
    """Weights are int8 with a scale for every output channel, the input and outputs are the same."""
    model = onnx.load_from_string(quantise_graph(network(), FRAMES))
    arrays = {one.name: numpy_helper.to_array(one) for one in model.graph.initializer}
    weights = [array for array in arrays.values() if array.dtype == np.int8 and array.ndim == 4]
    assert len(weights) == 3
    assert {len(a) for name, a in arrays.items() if name.endswith("_scale") and a.ndim == 1} == {8, 1}
    assert [one.name for one in model.graph.input] == ["frames"]


def test_int8_is_calibrated_on_what_the_network_sees() -> None:
    """On a marker gel that is a press without its dots."""
    dots = MarkerDots(np.array([[8.0, 8.0], [24.0, 20.0]]), 16.0, 6.0, 0.3)
    facts = tiny.tiny_facts(threshold=4.0, grid=None, dots=DotsEntry.of(dots))
    plain = Bundle.in_memory(*bundle_files(facts, Graphs(detector=network())))
    press = np.full((32, 32, 3), 120, np.uint8)
    press[6:11, 6:11], press[18:23, 22:27] = 20, 20
    (seen,) = module._Comparison(plain, press[None], ((), ()), 1).show(4)
    assert seen.min() > 110


def test_sensitive_layers_stay_in_float_until_the_maps_agree() -> None:
    """A channel two thousand times larger hides the others in int8: the layers that are harmed stay in float."""
    hard = bundle(network(2000))
    everything = module._Comparison(hard, FRAMES, ((), ()), 1).of(
        "int8", quantise_graph(network(2000), FRAMES)
    )
    result = measure_precisions(hard, FRAMES, threads=1).of("int8")
    assert everything.map_difference > 0.05 >= result.map_difference
    assert 0 < len(result.in_float) < len(layers(network(2000)))


def made(precision: str, difference: float, ms: float, size: int) -> Measured:
    return Measured(precision, b"", difference, 0, 0, None, ms, size)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("exact", "int8_ms", "int8_difference", "expected"),
    [
        (True, 5.0, 0.03, "int8"),
        (False, 5.0, 0.03, "float16"),  # no VNNI
        (True, 9.5, 0.03, "float16"),  # hardly faster
        (True, 5.0, 0.06, "float16"),  # beyond the limit
    ],
)
def test_int8_is_chosen_by_the_probe_the_clock_and_the_maps(
    exact: bool, int8_ms: float, int8_difference: float, expected: str
) -> None:
    """All three must speak for it; float16 storage otherwise."""
    results = (
        made("float32", 0, 10, 8),
        made("float16", 1e-4, 10, 4),
        made("int8", int8_difference, int8_ms, 2),
    )
    assert choose_precision(Precisions(results, exact, 0.05)).precision == expected
    for half in (made("float16", 0.02, 10, 4), made("float16", 0, 10, 8)):  # too rough; not smaller
        assert choose_precision(Precisions((results[0], half), exact, 0.05)).precision == "float32"


def test_the_new_bundle_scores_and_says_how_it_was_measured(plain: Bundle, found: Precisions) -> None:
    """Golden frames hold again; the threshold rose by the largest rise of a nominal score; the card has every row."""
    choice = dataclasses.replace(found.of("int8"), rise=0.25)
    facts = {CARD: {"smallest_mm": 0.05}, DAMAGE_FOUND: "dent of 0.1 mm 6 of 6", "licence": "Apache-2.0"}
    manifest = plain.manifest.model_copy(update={"facts": facts})
    plain = dataclasses.replace(plain, manifest=manifest)
    small = Bundle.in_memory(*in_precision(plain, found, choice, FRAMES))
    Scorer(small).check_golden()
    assert small.manifest.threshold.value == 4.25
    assert small.manifest.threshold.method.endswith("raised by 0.25 for int8")
    assert set(small.manifest.facts) == {"licence", "precision"}  # the limit of before found more
    same = in_precision(plain, found, found.of("float32"), FRAMES)[0]
    assert set(same.facts) == {*facts, "precision"}
    card = small.manifest.facts["precision"]
    assert card["chosen"] == "int8"
    assert {"float32", "float16", "int8", "int8_exact_here"} < set(card)
    assert small.digest != plain.digest


def test_too_different_maps_are_refused(plain: Bundle, found: Precisions) -> None:
    """The sentence has both numbers and what to do."""
    with pytest.raises(
        FitError, match=r"in int8 the score maps differ by 0\.2, 0\.05 is allowed; keep float32"
    ):
        in_precision(plain, found, dataclasses.replace(found.of("int8"), map_difference=0.2), FRAMES)


def test_a_change_of_aupro_is_measured_where_masks_exist(plain: Bundle) -> None:
    """A bright square with its mask: float32 changes nothing."""
    damaged, mask = FRAMES[0].copy(), np.zeros((32, 32), bool)
    damaged[8:16, 8:16], mask[8:16, 8:16] = 255, True
    rows = measure_precisions(plain, FRAMES, ([damaged], [mask])).results
    assert rows[0].aupro_change == 0
    assert abs(rows[1].aupro_change or 0) < 0.01
    assert rows[2].aupro_change is not None


def test_what_cannot_be_quantised(plain: Bundle, found: Precisions) -> None:
    """A bundle in int8 already, too few frames, a precision that could not be made."""
    again = Bundle.in_memory(*in_precision(plain, found, found.of("int8"), FRAMES))
    with pytest.raises(BundleMismatch, match="is quantised already"):
        measure_precisions(again, FRAMES)
    with pytest.raises(FitError, match="3 nominal frames cannot calibrate"):
        measure_precisions(plain, FRAMES[:3])
    with pytest.raises(FitError, match="has no int8: it breaks"):
        Precisions(found.results[:1], True, 0.05, ("it breaks",)).of("int8")


def test_weights_beyond_float16_stay(plain: Bundle) -> None:
    """A weight of a million would be infinite."""
    graph = network(1e6)
    kept = {
        one.data_type for one in onnx.load_from_string(halved(graph)).graph.initializer if len(one.dims) == 4
    }
    assert kept == {onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16}
    assert np.isfinite(Scorer(bundle(halved(graph))).score(FRAMES[0]).anomaly_score)


def test_the_command(plain: Bundle, tmp_path: Path) -> None:
    """`gelgate export precision` on a bundle of the tiny detector's trunk prints the table and writes the bundle."""
    write_bundle(tmp_path / "b", tiny.tiny_files()[1])
    (tmp_path / "good").mkdir()
    for number, frame in enumerate(RNG.integers(90, 160, (5, 40, 48, 3), dtype=np.uint8)):
        cv2.imwrite(str(tmp_path / "good" / f"{number}.png"), frame)
    words = ("export", "precision", tmp_path / "b", tmp_path / "good", "-o", tmp_path / "out")
    said = ran(*words)
    choice = Bundle.load(tmp_path / "out").manifest.facts["precision"]["chosen"]
    assert choice in ("float32", "float16", "int8")  # which one is the fastest is a fact of the machine
    assert f"chosen: {choice}\n" in said
    damaged = tmp_path / "bolt" / "test" / "dent"
    for number, height in enumerate((40, 80)):
        picture = RNG.integers(90, 160, (height, 48, 3), dtype=np.uint8)
        for path in (damaged / f"{number}.png", tmp_path / f"bolt/ground_truth/dent/{number}_mask.png"):
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), picture)
    (tmp_path / "good").rename(damaged.parent / "good")
    write_bundle(tmp_path / "t", tiny.tiny_files(position="test")[1])
    said = gelgate("export", "precision", tmp_path / "t", tmp_path / "bolt", "-o", tmp_path / "out2").err
    assert (
        f"warning: 1 of 2 damaged pictures are not 48x40, and tell nothing of AU-PRO, such as {damaged}/1"
        in said
    )
    refused = gelgate(*words, "--precision", "int4", "--overwrite").sentence()
    assert "--precision is auto, float32, float16, int8; found 'int4'" in refused
