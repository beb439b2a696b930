"""The floor: operations and bytes counted by hand."""

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from calibration.experiments.tradeoff.floor import Work, floor_ms, operations
from calibration.experiments.tradeoff.machine import Peak, best, probe


def graph(kind: str, weight: np.ndarray, shape: list[int | str], **attributes: object) -> bytes:
    made = helper.make_graph(
        [helper.make_node(kind, ["frames", "w"], ["out"], **attributes)],
        "one",
        [helper.make_tensor_value_info("frames", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)],
        initializer=[numpy_helper.from_array(weight.astype(np.float32), "w")],
    )
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)]).SerializeToString()


def test_a_convolution_is_counted_as_its_definition_says() -> None:
    """5 outputs of 8x8, each of 3 channels and 3x3 places: two operations per product."""
    convolution = graph("Conv", np.zeros((5, 3, 3, 3)), ["n", 3, 8, 8], pads=[1] * 4)
    assert operations(convolution, {"frames": (1, 3, 8, 8)}) == (2 * 5 * 8 * 8 * 27, False)


def test_a_product_is_counted_as_its_definition_says() -> None:
    """4x6 by 6x7."""
    assert operations(graph("MatMul", np.zeros((6, 7)), [4, 6]), {}) == (2 * 4 * 7 * 6, False)


def test_what_is_no_product_counts_as_nothing() -> None:
    """An addition is not counted, and a shape that is not known counts as nothing: the floor stays a floor."""
    assert operations(graph("Add", np.zeros(6), [4, 6]), {})[0] == 0
    assert operations(graph("MatMul", np.zeros((6, 7)), ["n", 6]), {})[0] == 0


def test_the_slower_of_arithmetic_and_bandwidth_is_the_floor() -> None:
    """1 GFLOP at 100 GFLOP/s and 2 Gop of int8 at 400 are 15 ms; 200 MB at 10 GB/s are 20 ms."""
    peak = Peak(float32_per_s=100e9, int8_per_s=400e9, bytes_per_s=10e9)
    assert floor_ms(Work(1e9, 2e9, 1e6), peak)[1] == "arithmetic"
    assert floor_ms(Work(1e9, 2e9, 1e6), peak)[0] == pytest.approx(15)
    assert floor_ms(Work(1e9, 2e9, 200e6), peak) == (pytest.approx(20), "bandwidth")


def test_the_probe_sees_a_machine() -> None:
    """Positive rates, int8 included; the better of two probes counts."""
    found = probe(1, repeats=4)
    assert min(found.float32_per_s, found.int8_per_s, found.bytes_per_s) > 1e6
    assert best(found, Peak(1.0, 1e30, 1.0)) == Peak(found.float32_per_s, 1e30, found.bytes_per_s)
