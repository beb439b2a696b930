"""A network of another program, wrapped, inspects presses in the running gateway; so does its int8 form."""

import threading
from pathlib import Path

import onnx.parser
import pytest
from command_line import ran
from station import press_recording, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.config.tables import Config
from edge.gateway.build import open_station
from edge.gateway.recorder import PressReport

NETWORK = """
    < ir_version: 8, opset_import: ["" : 17] >
    theirs (float[n, 3, 56, 56] input) => (float[n, 1, 56, 56] anomaly_map, float[n] pred_score)
    <float[1, 3, 1, 1] tint = {1.0, 0.0, -1.0}>
    {
        colour = Conv <kernel_shape = [1, 1]> (input, tint)
        near = AveragePool <kernel_shape = [5, 5], pads = [2, 2, 2, 2], strides = [1, 1]> (colour)
        around = AveragePool <kernel_shape = [21, 21], pads = [10, 10, 10, 10], strides = [1, 1]> (colour)
        apart = Sub (near, around)
        anomaly_map = Abs (apart)
        pred_score = ReduceMax <axes = [1, 2, 3], keepdims = 0> (anomaly_map)
    }
"""
"""How far the colour of a place is from its surroundings, with the names of anomalib's exports."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The network, a recording of nominal presses, one with a damaged press, and the wrapped bundle."""
    home = tmp_path_factory.mktemp("wrapped")
    (home / "model.onnx").write_bytes(onnx.parser.parse_model(NETWORK).SerializeToString())
    nominal = press_recording(home / "nominal", 12, seed=1)
    press_recording(home / "presses", 3, dented=[1], seed=2)
    words = ("-o", home / "bundle", "--part", "PZ0", "--licence", "own")
    ran("bundle", "wrap", home / "model.onnx", nominal, *words)
    return home


def inspected(config: Config) -> list[PressReport]:
    reports: list[PressReport] = []
    with open_station(config, SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())
    return reports


@pytest.mark.parametrize("precision", ["float32", "int8"])
def test_presses_are_inspected_by_the_network(folder: Path, tmp_path: Path, precision: str) -> None:
    """Three presses of the virtual sensor: the damaged one fails, the others pass."""
    words = ("-o", tmp_path / "bundle", "--precision", precision)
    ran("export", "precision", folder / "bundle", folder / "nominal", *words)
    config = load_config(station_config(tmp_path, folder / "presses", tmp_path / "bundle"))
    reports = inspected(config)
    assert [report.result.verdict for report in reports] == ["pass", "fail", "pass"]


def test_a_likelihood_has_a_threshold_below_zero(folder: Path, tmp_path: Path) -> None:
    """1 minus the distance falls with damage; negated it inspects, and the pictures of the presses are drawn."""
    likely = NETWORK.replace("anomaly_map = Abs (apart)", "far = Abs (apart)  anomaly_map = Sub (one, far)")
    likely = likely.replace("ReduceMax", "ReduceMin")
    likely = likely.replace("-1.0}>", "-1.0}, float one = {1.0}>")
    (tmp_path / "likely.onnx").write_bytes(onnx.parser.parse_model(likely).SerializeToString())
    likely_onnx, wrapped = tmp_path / "likely.onnx", tmp_path / "bundle"
    words = ("-o", wrapped, "--part", "PZ0", "--licence", "own", "--negate")
    ran("bundle", "wrap", likely_onnx, folder / "nominal", *words)
    config = load_config(station_config(tmp_path, folder / "presses", tmp_path / "bundle"))
    reports = inspected(config)

    assert [report.result.verdict for report in reports] == ["pass", "fail", "pass"]
    assert all(report.result.threshold is not None and report.result.threshold < 0 for report in reports)
