"""The same bundle on another processor gives the same scores.

int8 products of two neighbours are added in 16 bits by processors without VNNI (Intel before 2019, most Atoms; AMD
before Zen 4), where onnxruntime lets the sum saturate by default. Such a processor is emulated here.
"""

from importlib.resources import files
from pathlib import Path

import numpy as np
import onnx
import pytest
from emulated_processor import needs_emulator, run_on_haswell
from onnx import TensorProto, helper, numpy_helper

from edge.model import session as runtime
from edge.model.session import open_session


def probe() -> bytes:
    """A 3x3 convolution of 8 to 8 channels in uint8 times int8, every weight 127 steps: any pair is too much.
    `edge/model/saturation_probe.onnx` is this graph; where it must change, write these bytes there."""

    def stored(name: str, values: np.ndarray) -> onnx.TensorProto:
        return numpy_helper.from_array(values, name)

    scale, weights = np.float32(1 / 255), np.full((8, 8, 3, 3), 127, np.int8)
    nodes = [
        helper.make_node("QuantizeLinear", ["x", "scale", "zero"], ["steps"]),
        helper.make_node("DequantizeLinear", ["steps", "scale", "zero"], ["rounded"]),
        helper.make_node("DequantizeLinear", ["w", "w_scale", "w_zero"], ["weight"], axis=0),
        helper.make_node("Conv", ["rounded", "weight"], ["sum"], kernel_shape=[3, 3]),
        helper.make_node("QuantizeLinear", ["sum", "y_scale", "zero"], ["sum_steps"]),
        helper.make_node("DequantizeLinear", ["sum_steps", "y_scale", "zero"], ["y"]),
    ]
    constants = [
        stored("scale", scale),
        stored("zero", np.uint8(0)),
        stored("w", weights),
        stored("w_scale", np.full(8, 1 / 127, np.float32)),
        stored("w_zero", np.zeros(8, np.int8)),
        stored("y_scale", np.float32(72 / 255)),
    ]
    x = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 8, "h", "w"])
    y = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 8, "rows", "columns"])
    drawn = helper.make_graph(nodes, "saturation_probe", [x], [y], constants)
    model = helper.make_model(drawn, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    found: bytes = model.SerializeToString()
    return found


def test_the_probe_is_the_graph_that_is_drawn_here() -> None:
    shipped = files("edge.model").joinpath("saturation_probe.onnx").read_bytes()
    assert onnx.load_from_string(shipped) == onnx.load_from_string(probe())


@pytest.mark.parametrize("saturates", [False, True])
def test_wide_sums_are_asked_for_where_needed(saturates: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The option costs an int8 trunk twice its time, also where nothing saturates."""
    monkeypatch.setattr(runtime, "saturates", lambda: saturates)
    options = open_session(probe(), 1, "graph").get_session_options()
    if saturates:
        assert options.get_session_config_entry("session.x64quantprecision") == "1"
    else:
        with pytest.raises(RuntimeError, match="x64quantprecision"):
            options.get_session_config_entry("session.x64quantprecision")


@needs_emulator
def test_int8_sums_do_not_saturate_on_a_processor_without_vnni(tmp_path: Path) -> None:
    """Under an emulated Haswell, 72 products near one still add up to 72 times their mean, as they do here."""
    x = np.random.default_rng(0).uniform(0.9, 1, (1, 8, 16, 16)).astype(np.float32)
    here = open_session(probe(), 1, "graph").run(None, {"x": x})[0]
    assert np.abs(here - 72 * 0.95).max() < 2
    assert np.array_equal(run_on_haswell(probe(), {"x": x}, tmp_path)[0], here)
