"""The same bundle on another processor gives the same scores.

int8 products of two neighbours are added in 16 bits by processors without VNNI (Intel before 2019, most Atoms; AMD
before Zen 4), where onnxruntime lets the sum saturate unless told otherwise. Such a processor is emulated here.
"""

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from edge.runtime import open_session

_EMULATOR = shutil.which("qemu-x86_64")
_RUN = """
import sys
import numpy as np
from edge.runtime import open_session
session = open_session(open(sys.argv[1], "rb").read(), 1, "graph")
np.save(sys.argv[3], session.run(None, {"x": np.load(sys.argv[2])})[0])
"""


@pytest.fixture(scope="module")
def graph() -> bytes:
    """A 3x3 convolution of 8 to 8 channels in uint8 times int8, every weight 127 steps: any pair is too much."""

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
    shape = [1, 8, 16, 16]
    x = helper.make_tensor_value_info("x", TensorProto.FLOAT, shape)
    y = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 8, 14, 14])
    drawn = helper.make_graph(nodes, "saturating", [x], [y], constants)
    model = helper.make_model(drawn, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    found: bytes = model.SerializeToString()
    return found


@pytest.mark.skipif(
    _EMULATOR is None, reason="SKIPPED, NOT TESTED: qemu-x86_64 (Debian: qemu-user) is not installed"
)
def test_int8_sums_do_not_saturate_on_a_processor_without_vnni(graph: bytes, tmp_path: Path) -> None:
    """Under an emulated Haswell, 72 products near one still add up to 72 times their mean, as they do here."""
    x = np.random.default_rng(0).uniform(0.9, 1, (1, 8, 16, 16)).astype(np.float32)
    here = open_session(graph, 1, "graph").run(None, {"x": x})[0]
    assert np.abs(here - 72 * 0.95).max() < 2
    (tmp_path / "graph.onnx").write_bytes(graph)
    np.save(tmp_path / "x.npy", x)
    words = [_EMULATOR, "-cpu", "Haswell", Path(sys.executable).resolve(), "-c", _RUN]
    files = [tmp_path / name for name in ("graph.onnx", "x.npy", "there.npy")]
    places = [str(Path(__file__).parents[2]), sysconfig.get_path("purelib"), sysconfig.get_path("platlib")]
    done = subprocess.run(
        [*map(str, words), *map(str, files)],
        env={"PYTHONPATH": ":".join(places), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert np.array_equal(np.load(files[-1]), here)
