"""`tile_trunk`: turns a trunk into one that reads a large frame in overlapping tiles and gives its taps as mosaics.

Each tap is a mosaic of tiles, (c, tile rows * h, tile columns * w). For a head this is one larger map with separate
locations for every tile, so its bank is per tile and location, and blending is a matrix (edge.core.imaging.tiles).

The file holds the trunk for one tile, and the layout in its metadata. `tile_runner` cuts the tiles and places their
features one at a time, so memory stays that of one tile and tiles can be skipped. `mosaic_trunk` does the same inside
the graph, all tiles as one batch, for other runtimes.
"""

from typing import Any

from edge.core.errors import ConfigError
from edge.core.imaging.tiles import TILES_KEY, Tiles
from plugins.onnx_builder import IR_VERSION

__all__ = ["mosaic_trunk", "tile_trunk"]

# The coarsest stride of the family (layer4): tiles of other sizes would round their grids up.
STRIDE = 32


def tile_trunk(trunk: bytes, tiles: Tiles) -> bytes:
    """The trunk for one tile, with the layout in its metadata. Input `frames` uint8 (n, size, size, 3).

    Errors: ConfigError for bytes that are no trunk, one without the one input `frames`, one that is tiled already, or a
    tile size that is not a multiple of 32.
    """
    import onnx
    from onnx import helper

    model = _plain(trunk, tiles)
    for place, size in enumerate((tiles.size, tiles.size, 3), start=1):
        model.graph.input[0].type.tensor_type.shape.dim[place].dim_value = size
    _tap_shapes(model, tiles)
    facts = {entry.key: entry.value for entry in model.metadata_props}
    helper.set_model_props(model, {**facts, TILES_KEY: tiles.to_json()})
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


def mosaic_trunk(trunk: bytes, tiles: Tiles) -> bytes:
    """The trunk over all tiles in one graph. Input `frames` uint8 (n, *tiles.frame, 3), outputs the taps as mosaics.

    trunk: a plain one, or one of `tile_trunk`. Errors: ConfigError as there.
    """
    import onnx
    from onnx import helper

    model = _read(trunk)
    facts = {entry.key: entry.value for entry in model.metadata_props if entry.key != TILES_KEY}
    helper.set_model_props(model, facts)
    model = _plain(model.SerializeToString(), tiles)
    shapes = _tap_shapes(model, tiles)
    for node in model.graph.node:
        node.input[:] = ["tiles" if name == "frames" else name for name in node.input]
        node.output[:] = [f"{name}_of_tiles" if name in shapes else name for name in node.output]
        node.input[:] = [f"{name}_of_tiles" if name in shapes else name for name in node.input]
    constants: list[Any] = []
    before = _cut(tiles, constants)
    after = [node for tap, shape in shapes.items() for node in _mosaic(tap, shape, tiles, constants)]
    graph = helper.make_graph(
        [*before, *model.graph.node, *after],
        f"{model.graph.name}_tiled",
        [helper.make_tensor_value_info("frames", onnx.TensorProto.UINT8, ["n", *tiles.frame, 3])],
        [
            helper.make_tensor_value_info(
                tap, onnx.TensorProto.FLOAT, ["n", c, h * len(tiles.rows), w * len(tiles.columns)]
            )
            for tap, (c, h, w) in shapes.items()
        ],
        initializer=[*model.graph.initializer, *constants],
    )
    tiled = helper.make_model(
        graph, opset_imports=model.opset_import, ir_version=IR_VERSION, producer_name="gelgate"
    )
    helper.set_model_props(tiled, facts)
    onnx.checker.check_model(tiled, full_check=True)
    return bytes(tiled.SerializeToString())


def _plain(trunk: bytes, tiles: Tiles) -> Any:
    """A trunk that can be tiled. Errors: ConfigError."""
    import onnx

    if tiles.size % STRIDE:
        raise ConfigError(
            f"a tile's side is a multiple of {STRIDE} pixels, found {tiles.size}; choose another size"
        )
    model = _read(trunk)
    inputs = model.graph.input
    is_tiled = any(entry.key == TILES_KEY for entry in model.metadata_props)
    if is_tiled or [(i.name, len(i.type.tensor_type.shape.dim)) for i in inputs] != [("frames", 4)]:
        raise ConfigError(
            "only a plain trunk, with the one input 'frames' (n, height, width, 3) and no tiles yet, can be tiled"
        )
    try:
        onnx.checker.check_model(model)
    except onnx.checker.ValidationError as error:
        raise ConfigError(f"the trunk is no sound ONNX model: {str(error).splitlines()[0]}") from error
    return model


def _read(trunk: bytes) -> Any:
    """Parse an ONNX model. Errors: ConfigError for another file."""
    import onnx
    from google.protobuf.message import DecodeError

    try:
        return onnx.load_from_string(trunk)
    except DecodeError as error:
        raise ConfigError(
            "the trunk is cut short or is no ONNX model; name the .onnx file of a trunk"
        ) from error


def _tap_shapes(model: Any, tiles: Tiles) -> dict[str, tuple[int, int, int]]:
    """Each tap's (c, h, w) for one tile."""
    import onnx

    fixed = onnx.ModelProto()
    fixed.CopyFrom(model)
    for place, size in enumerate((1, tiles.size, tiles.size, 3)):
        fixed.graph.input[0].type.tensor_type.shape.dim[place].dim_value = size
    for output in fixed.graph.output:
        for dim in output.type.tensor_type.shape.dim:
            dim.Clear()
    try:
        inferred = onnx.shape_inference.infer_shapes(fixed, strict_mode=True, data_prop=True)
    except onnx.shape_inference.InferenceError as error:
        raise ConfigError(f"the trunk does not take tiles of {tiles.size} pixels: {error}") from error
    shapes = {}
    for output in inferred.graph.output:
        _, c, h, w = (dim.dim_value for dim in output.type.tensor_type.shape.dim)
        if not min(c, h, w):
            raise ConfigError(
                f"the size of the trunk's tap '{output.name}' is not known in advance; it cannot be tiled"
            )
        shapes[output.name] = (c, h, w)
    return shapes


def _cut(tiles: Tiles, constants: list[Any]) -> list[Any]:
    """frames (n, h, w, 3) to `tiles` (tiles * n, size, size, 3), tile after tile."""
    from onnx import helper

    axes = _ints("tile_axes", [1, 2], constants)
    nodes = []
    for index, (row, column) in enumerate(tiles.places):
        first = _ints(f"tile_{index}_first", [row, column], constants)
        last = _ints(f"tile_{index}_last", [row + tiles.size, column + tiles.size], constants)
        nodes.append(helper.make_node("Slice", ["frames", first, last, axes], [f"tile_{index}"]))
    return [*nodes, helper.make_node("Concat", [f"tile_{i}" for i in range(len(tiles))], ["tiles"], axis=0)]


def _mosaic(tap: str, shape: tuple[int, int, int], tiles: Tiles, constants: list[Any]) -> list[Any]:
    """A tap of (tiles * n, c, h, w) laid out as (n, c, tile rows * h, tile columns * w)."""
    from onnx import helper

    c, h, w = shape
    rows, columns = len(tiles.rows), len(tiles.columns)
    split = _ints(f"{tap}_split", [rows, columns, -1, c, h, w], constants)
    mosaic = _ints(f"{tap}_mosaic", [-1, c, rows * h, columns * w], constants)
    return [
        helper.make_node("Reshape", [f"{tap}_of_tiles", split], [f"{tap}_tiles"]),
        helper.make_node("Transpose", [f"{tap}_tiles"], [f"{tap}_ordered"], perm=[2, 3, 0, 4, 1, 5]),
        helper.make_node("Reshape", [f"{tap}_ordered", mosaic], [tap]),
    ]


def _ints(name: str, values: list[int], constants: list[Any]) -> str:
    import numpy as np
    from onnx import numpy_helper

    constants.append(numpy_helper.from_array(np.array(values, np.int64), name))
    return name
