"""Builds ONNX graphs: every trunk and head of the product is written with `Graph`.

`Graph` names the values, so that a head reads like the formula it computes:

    g = Graph("residual")
    x = g.input("layer1", ("n", 64, 56, 56))
    mean = g.input("mean", (64, 1, 1))
    g.output("score", g.op("ReduceMax", g.op("Abs", g.op("Sub", x, mean)), g.ints(1, 2, 3), keepdims=0), ("n",))
    head = g.serialise()

Only the standard operator domain is used and nothing is stored outside the graph. onnx is imported at use.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["IR_VERSION", "OPSET", "Dim", "Graph", "Value"]

Value = str
"""The name of a tensor in a graph."""

Dim = int | str
"""A fixed size, or the name of a size known at run time."""

# Opset 18 has ReduceMax with axes as an input and Resize on any axes; onnxruntime 1.23 (our oldest) runs up to 23.
OPSET = 18
# The oldest container format that may carry opset 18.
IR_VERSION = 8

ElementType = Literal["float32", "float16", "uint8", "int8", "int64", "bool"]


class Graph:
    """An ONNX graph under construction: inputs, operations and outputs in the order of the calls."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._nodes: list[Any] = []
        self._inputs: list[Any] = []
        self._outputs: list[Any] = []
        self._initializers: list[Any] = []
        self._constants: dict[tuple[str, tuple[int, ...], bytes], Value] = {}
        self._count = 0

    def input(self, name: str, shape: Sequence[Dim], dtype: ElementType = "float32") -> Value:
        """An outer input with its declared shape."""
        self._inputs.append(_value_info(name, dtype, shape))
        return name

    def output(self, name: str, value: Value, shape: Sequence[Dim], dtype: ElementType = "float32") -> None:
        """Give `value` to the outside under `name`."""
        self._nodes.append(_node("Identity", [value], [name]))
        self._outputs.append(_value_info(name, dtype, shape))

    def op(self, kind: str, *inputs: Value, **attributes: object) -> Value:
        """Add a standard operation with one result. An absent optional input is the empty string."""
        return self.ops(kind, 1, *inputs, **attributes)[0]

    def ops(self, kind: str, results: int, *inputs: Value, **attributes: object) -> tuple[Value, ...]:
        """Add a standard operation with several results, such as TopK."""
        names = tuple(self._fresh(kind) for _ in range(results))
        self._nodes.append(_node(kind, list(inputs), list(names), **attributes))
        return names

    def constant(self, array: NDArray[Any] | np.generic) -> Value:
        """A tensor stored inside the graph; equal small ones are stored once."""
        from onnx import numpy_helper

        array = np.ascontiguousarray(array)
        key = (array.dtype.str, array.shape, array.tobytes() if array.size <= 64 else b"")
        if array.size <= 64 and key in self._constants:
            return self._constants[key]
        name = self._fresh("constant")
        self._initializers.append(numpy_helper.from_array(array, name))
        self._constants[key] = name
        return name

    def ints(self, *values: int) -> Value:
        """A stored int64 vector: axes, shapes, sizes."""
        return self.constant(np.array(values, np.int64))

    def scalar(self, value: float) -> Value:
        """A stored float32 number."""
        return self.constant(np.array(value, np.float32))

    def reshape(self, value: Value, *shape: int) -> Value:
        """Reshape a value; 0 keeps a size, -1 is whatever is left."""
        return self.op("Reshape", value, self.ints(*shape))

    def transpose(self, value: Value, *order: int) -> Value:
        """Reorder the axes."""
        return self.op("Transpose", value, perm=list(order))

    def slice(self, value: Value, first: int, last: int, axis: int) -> Value:
        """Take the places `first` to `last` of an axis."""
        return self.op("Slice", value, self.ints(first), self.ints(last), self.ints(axis))

    def unsqueeze(self, value: Value, *axes: int) -> Value:
        """Add axes of length one."""
        return self.op("Unsqueeze", value, self.ints(*axes))

    def squeeze(self, value: Value, *axes: int) -> Value:
        """Remove axes of length one."""
        return self.op("Squeeze", value, self.ints(*axes))

    def first(self, value: Value, axis: int) -> Value:
        """Take the first place of an axis, without that axis."""
        return self.squeeze(self.op("Gather", value, self.ints(0), axis=axis), axis)

    def concat(self, values: Sequence[Value], axis: int) -> Value:
        """Join values along an axis; a single one stays as it is."""
        return self.op("Concat", *values, axis=axis) if len(values) > 1 else values[0]

    def length(self, value: Value, axis: int) -> Value:
        """Compute the Euclidean length along an axis, which goes."""
        return self.op("Sqrt", self.op("ReduceSumSquare", value, self.ints(axis), keepdims=0))

    def between(self, rows: NDArray[Any], value: Value, columns: NDArray[Any]) -> Value:
        """Multiply maps (..., h, w) by fixed matrices: rows @ value @ columns.T."""
        left, right = (self.constant(np.asarray(matrix, np.float32)) for matrix in (rows, columns.T))
        return self.op("MatMul", left, self.op("MatMul", value, right))

    def serialise(self, facts: Mapping[str, str] | None = None) -> bytes:
        """The checked graph as bytes, with `facts` as its metadata.

        Errors: onnx's own, for a graph that is not well formed (ours to repair).
        """
        import onnx

        graph = onnx.helper.make_graph(
            self._nodes, self.name, self._inputs, self._outputs, initializer=self._initializers
        )
        model = onnx.helper.make_model(
            graph,
            opset_imports=[onnx.helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="gelgate",
        )
        onnx.helper.set_model_props(model, dict(facts or {}))
        onnx.checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString())

    def _fresh(self, kind: str) -> Value:
        self._count += 1
        return f"{kind.lower()}_{self._count}"


def _node(kind: str, inputs: list[Value], outputs: list[Value], **attributes: object) -> Any:
    from onnx import helper

    return helper.make_node(kind, inputs, outputs, name=outputs[0], **attributes)


def _value_info(name: str, dtype: ElementType, shape: Sequence[Dim]) -> Any:
    from onnx import helper

    return helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), list(shape))
