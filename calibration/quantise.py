"""Graphs with smaller numbers: weights stored as float16, or a graph in int8 (QDQ, weights per channel).

int8 is calibrated on the caller's frames. Layers can be left in float; the operators that are quantised are those that
integer kernels exist for. Imports onnx at use.
"""

import contextlib
import logging
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edge.core.arrays import U8

__all__ = ["halved", "layers", "quantise_graph"]

LAYERS = ("Conv", "MatMul", "Gemm")
"""Operators with weights."""

QUANTISED = (*LAYERS, "Add", "Relu", "MaxPool")
"""The others keep int8 between layers, so that nothing is converted back and forth."""

SMALLEST = 64
"""Constants of fewer entries are settings, not weights."""


def halved(data: bytes) -> bytes:
    """Weights stored as float16 and widened once when the graph is loaded: half the file, the same speed.

    A weight that float16 cannot hold stays as it is.
    """
    import onnx
    from onnx import helper, numpy_helper

    model = onnx.load_from_string(data)
    casts = []
    for weight in model.graph.initializer:
        if weight.data_type != onnx.TensorProto.FLOAT:
            continue
        array = numpy_helper.to_array(weight)
        if array.size < SMALLEST or float(np.abs(array).max()) > float(np.finfo(np.float16).max):
            continue
        name = weight.name
        weight.CopyFrom(numpy_helper.from_array(array.astype(np.float16), f"{name}/half"))
        casts.append(helper.make_node("Cast", [f"{name}/half"], [name], name=f"{name}/widen", to=1))
    nodes = [*casts, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    return bytes(model.SerializeToString())


def layers(data: bytes) -> list[str]:
    """The names of the layers with weights, in the order of computation."""
    return [node.name for node in _prepare(data).graph.node if node.op_type in LAYERS]


def quantise_graph(data: bytes, frames: U8, in_float: Sequence[str] = (), only: Sequence[str] = ()) -> bytes:
    """Quantise a graph to int8, with the same input and outputs.

    frames: uint8 (n, h, w, 3), nominal ones: ranges are those that they show. in_float: layers that stay in float.
    only: layers that are quantised, all others stay; empty: all. Errors: those of onnxruntime for a graph that it
    cannot quantise.
    """
    import onnx
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    class Frames(CalibrationDataReader):  # type: ignore[misc]
        def __init__(self) -> None:
            self._left = list(frames)

        def get_next(self) -> dict[str, U8] | None:
            return {"frames": self._left.pop(0)[None]} if self._left else None

    model = _prepare(data)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "float.onnx", Path(folder) / "int8.onnx"
        onnx.save(model, source)
        with _quiet():
            quantize_static(
                source,
                target,
                Frames(),
                quant_format=QuantFormat.QDQ,
                per_channel=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
                op_types_to_quantize=list(QUANTISED),
                nodes_to_quantize=list(only) or None,
                nodes_to_exclude=[*in_float, *_before_the_first_layer(model)],
            )
        return target.read_bytes()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The quantiser advises in the root log to prepare graphs that ours need not."""
    root = logging.getLogger()
    before = root.level
    root.setLevel(logging.ERROR)
    try:
        yield
    finally:
        root.setLevel(before)


def _prepare(data: bytes) -> Any:
    """The model with a name for every node and its weights in float32, as the quantiser needs them."""
    import onnx
    from onnx import numpy_helper

    model = onnx.load_from_string(data)
    stored = {tensor.name: tensor for tensor in model.graph.initializer}
    kept = []
    for number, node in enumerate(model.graph.node):
        node.name = node.name or f"{node.op_type}_{number}"
        if node.op_type == "Cast" and node.input[0] in stored and stored[node.input[0]].data_type == 10:
            array = numpy_helper.to_array(stored[node.input[0]]).astype(np.float32)
            model.graph.initializer.append(numpy_helper.from_array(array, node.output[0]))
        else:
            kept.append(node)
    read = {name for node in kept for name in node.input} | {output.name for output in model.graph.output}
    weights = [tensor for tensor in model.graph.initializer if tensor.name in read]
    del model.graph.node[:], model.graph.initializer[:]
    model.graph.node.extend(kept)
    model.graph.initializer.extend(weights)
    return model


def _before_the_first_layer(model: Any) -> list[str]:
    """The normalisation of the pixels stays as it is."""
    nodes = list(model.graph.node)
    first = next((n for n, node in enumerate(nodes) if node.op_type in LAYERS), len(nodes))
    return [node.name for node in nodes[:first]]
