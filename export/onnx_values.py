"""Small changes to ONNX models: values made outputs, a front that reads frames, one input of a picture found.

Every function takes and gives models of the onnx package, which is imported at use.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import U8
from edge.core.errors import ConfigError
from edge.model.onnx_validation import GraphRefused, check_graph
from edge.model.session import RUNTIME_ERRORS, open_session
from plugins.backbones.input_steps import InputSteps, apply_steps, input_planes
from plugins.onnx_builder import Graph

__all__ = [
    "PIXELS",
    "PictureInput",
    "append",
    "drop_traces",
    "first_conv_input",
    "join",
    "load_model",
    "picture_input",
    "read_frames",
    "rename",
    "run_each",
    "run_values",
]

Layout = Literal["nchw", "nhwc"]
PIXELS = "gelgate_pixels"


@dataclass(frozen=True)
class PictureInput:
    """A graph's one input."""

    name: str
    layout: Layout
    is_bytes: bool
    """uint8, or float32."""
    size: tuple[int, int] | None
    """(h, w)."""
    batch: int | None
    """Frames at a time; None where they are free."""

    def prepare(self, frames: U8, steps: InputSteps, high: float) -> NDArray[Any]:
        """Prepare frames, uint8 (n, h, w, 3), for the graph. high: what the brightest level is after the steps."""
        planes = apply_steps(steps, frames) * high
        planes = planes if self.layout == "nchw" else planes.transpose(0, 2, 3, 1)
        if self.is_bytes:
            return np.rint(planes).clip(0, 255).astype(np.uint8)
        return planes.astype(np.float32)


def load_model(data: bytes, where: str) -> Any:
    """The model of untrusted bytes. Errors: ConfigError for what a bundle may not carry, or no graph at all."""
    import onnx

    try:
        check_graph(data)
        model = onnx.load_from_string(data)
        onnx.checker.check_model(model)
    except GraphRefused as error:
        raise ConfigError(f"{where} is refused: {error}; export it again as one plain ONNX file") from error
    except Exception as error:  # protobuf and the checker raise their own classes
        words = str(error).strip().splitlines() or [type(error).__name__]
        raise ConfigError(f"{where} is not an ONNX graph that can be used: {words[0]:.200}") from error
    return model


def picture_input(model: Any, where: str) -> PictureInput:
    """The one input that is a picture. Errors: ConfigError with the inputs found."""
    constants = {tensor.name for tensor in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in constants]
    present = ", ".join(f"{value.name} {_shape(value)}" for value in inputs) or "none"
    if len(inputs) != 1:
        raise ConfigError(f"{where} has the inputs {present}; one picture is expected")
    shape, kind = _shape(inputs[0]), inputs[0].type.tensor_type.elem_type
    if len(shape) != 4 or kind not in (1, 2):
        raise ConfigError(
            f"{where} has the input {present} of type {kind}; a picture of four axes, float32 or uint8, is expected"
        )
    threes = [axis for axis in (1, 3) if shape[axis] == 3]
    if len(threes) != 1:
        raise ConfigError(
            f"{where} has the input {present}: its three colours are expected on axis 1 (n, 3, h, w) or 3 (n, h, w, 3)"
        )
    layout: Layout = "nchw" if threes == [1] else "nhwc"
    h, w = (shape[2], shape[3]) if layout == "nchw" else (shape[1], shape[2])
    size = (h, w) if isinstance(h, int) and isinstance(w, int) else None
    return PictureInput(
        inputs[0].name, layout, kind == 2, size, shape[0] if isinstance(shape[0], int) else None
    )


def _shape(value: Any) -> tuple[int | str, ...]:
    dims = value.type.tensor_type.shape.dim
    return tuple(dim.dim_value if dim.dim_value > 0 else (dim.dim_param or "?") for dim in dims)


def read_frames(
    model: Any, picture: PictureInput, steps: InputSteps, frame: tuple[int, int], high: float = 1.0
) -> Any:
    """The model behind a front that reads `frames` uint8 (n, h, w, 3) and does these steps.

    high: what the brightest level is in the model's input after the steps, 1 or 255. The front's values are under
    `front/`, the model's own under `model/`.
    """
    import onnx

    graph = Graph("front")
    planes = input_planes(graph, steps, frame)
    if high != 1.0:
        planes = graph.op("Mul", planes, graph.scalar(high))
    if picture.layout == "nhwc":
        planes = graph.transpose(planes, 0, 2, 3, 1)
    if picture.is_bytes:
        planes = graph.op(
            "Cast", graph.op("Clip", graph.op("Round", planes), graph.scalar(0), graph.scalar(255)), to=2
        )
    graph.output(PIXELS, planes, ("n", "a", "b", "c"), "uint8" if picture.is_bytes else "float32")
    front = onnx.load_from_string(graph.serialise())
    merged = join(front, model, {PIXELS: picture.name}, ("front/", "model/"))
    rename(merged, {"front/frames": "frames"})
    drop_traces(merged)
    return merged


def join(first: Any, second: Any, reads: Mapping[str, str], prefixes: tuple[str, str] = ("", "")) -> Any:
    """Join two models, whose outputs are then those of the second.

    reads: value of the first to the input of the second that reads it. prefixes: of all names of each.
    """
    import onnx
    from onnx import compose

    first, second = (
        compose.add_prefix(model, prefix) if prefix else model
        for model, prefix in zip(same_versions(first, second), prefixes, strict=True)
    )
    pairs = [(prefixes[0] + value, prefixes[1] + name) for value, name in reads.items()]
    del first.graph.output[:]
    first.graph.output.extend(onnx.ValueInfoProto(name=value) for value, _ in pairs)
    merged = compose.merge_models(first, second, io_map=pairs)
    name_opset_once(merged)
    return merged


def append(body: Any, ending: bytes, reads: Mapping[str, str]) -> Any:
    """Join a graph behind a model of `read_frames`; it keeps the names of its outputs. reads: as for `join`."""
    import onnx

    end = onnx.load_from_string(ending)
    merged = join(body, end, {f"model/{value}": name for value, name in reads.items()}, ("", "end/"))
    rename(merged, {f"end/{output.name}": output.name for output in end.graph.output})
    onnx.checker.check_model(merged)
    return merged


def drop_traces(model: Any) -> None:
    """Remove what exporters note of their own run: stack traces with the folders and names of the machine."""
    graph = model.graph
    del model.metadata_props[:]
    for part in (
        model,
        graph,
        *graph.node,
        *graph.initializer,
        *graph.value_info,
        *graph.input,
        *graph.output,
    ):
        part.doc_string = ""
        if part is not model:
            del part.metadata_props[:]


def same_versions(first: Any, second: Any) -> tuple[Any, Any]:
    """Both at the higher opset and IR version of the two, as merging requires."""
    from onnx import version_converter

    opset = max(_opset(first), _opset(second))
    models = [
        m if _opset(m) == opset else version_converter.convert_version(m, opset) for m in (first, second)
    ]
    ir_version = max(m.ir_version for m in models)
    for m in models:
        m.ir_version = ir_version
        name_opset_once(m)
    return models[0], models[1]


def name_opset_once(model: Any) -> None:
    """Merging repeats the operator set; onnxruntime's quantiser refuses that."""
    version = _opset(model)
    del model.opset_import[:]
    model.opset_import.add(domain="", version=version)


def _opset(model: Any) -> int:
    return next(int(opset.version) for opset in model.opset_import if opset.domain in ("", "ai.onnx"))


def rename(model: Any, names: Mapping[str, str]) -> None:
    """Rename values in inputs, outputs and nodes."""
    for value in [*model.graph.input, *model.graph.output]:
        value.name = names.get(value.name, value.name)
    for node in model.graph.node:
        for side in (node.input, node.output):
            side[:] = [names.get(name, name) for name in side]


def add_outputs(data: bytes, values: Sequence[str]) -> bytes:
    """Make further values of a graph its outputs, of any type. Values that are outputs already stay single."""
    import onnx

    model = onnx.load_from_string(data)
    given = {output.name for output in model.graph.output}
    for name in values:
        if name not in given:
            model.graph.output.append(onnx.ValueInfoProto(name=name))
    return bytes(model.SerializeToString())


def run_values(
    data: bytes, values: Sequence[str], feeds: Mapping[str, NDArray[Any]], where: str
) -> list[NDArray[Any]]:
    """These values of a graph for these inputs. Errors: ConfigError where the runtime refuses, BundleCorrupt."""
    session = open_session(add_outputs(data, values), 2, where)
    try:
        return [np.asarray(array) for array in session.run(list(values), dict(feeds))]
    except RUNTIME_ERRORS as error:
        raise ConfigError(f"{where} does not run: {str(error).strip().splitlines()[0]:.300}") from error


def run_each(
    data: bytes, values: list[str], name: str, batch: NDArray[Any], limit: int | None, where: str
) -> list[NDArray[Any]]:
    """These values for a batch of one input: at once, or one by one where the graph takes one. Errors: ConfigError."""
    if limit is None or limit == len(batch):
        return run_values(data, values, {name: batch}, where)
    if limit != 1:
        raise ConfigError(f"{where} takes {limit} frames at a time; export it for one, or for any number")
    runs = [run_values(data, values, {name: frame[None]}, where) for frame in batch]
    return [np.concatenate(parts) for parts in zip(*runs, strict=True)]


def first_conv_input(data: bytes) -> str:
    """The value that the first convolution reads: the network's input tensor in a trunk of ours."""
    import onnx

    model = onnx.load_from_string(data)
    return next(str(node.input[0]) for node in model.graph.node if node.op_type == "Conv")
