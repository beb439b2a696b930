"""`tile_trunk`: turns a trunk into one that reads a large frame in overlapping tiles and gives its taps as mosaics.

Each tap is a mosaic of tiles, (c, tile rows * h, tile columns * w). For a head this is one larger map with separate
locations for every tile, so its bank is per tile and location, and blending is a matrix (edge.core.imaging.tiles).

The file holds the trunk for one tile, and the layout in its metadata. `tile_runner` cuts the tiles and places their
features one at a time, so memory stays that of one tile and tiles can be skipped.
"""

from typing import Any

from edge.core.errors import ConfigError
from edge.core.imaging.tiles import TILES_KEY, Tiles

__all__ = ["plain_trunk", "read_model", "tap_shapes", "tile_trunk"]

# The coarsest stride of the family (layer4): tiles of other sizes would round their grids up.
STRIDE = 32


def tile_trunk(trunk: bytes, tiles: Tiles) -> bytes:
    """The trunk for one tile, with the layout in its metadata. Input `frames` uint8 (n, size, size, 3).

    Errors: ConfigError for bytes that are no trunk, one without the one input `frames`, one that is tiled already, or a
    tile size that is not a multiple of 32.
    """
    import onnx
    from onnx import helper

    model = plain_trunk(trunk, tiles)
    for place, size in enumerate((tiles.size, tiles.size, 3), start=1):
        model.graph.input[0].type.tensor_type.shape.dim[place].dim_value = size
    tap_shapes(model, tiles)
    facts = {entry.key: entry.value for entry in model.metadata_props}
    helper.set_model_props(model, {**facts, TILES_KEY: tiles.to_json()})
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


def plain_trunk(trunk: bytes, tiles: Tiles) -> Any:
    """A trunk that can be tiled. Errors: ConfigError."""
    import onnx

    if tiles.size % STRIDE:
        raise ConfigError(
            f"a tile's side is a multiple of {STRIDE} pixels, found {tiles.size}; choose another size"
        )
    model = read_model(trunk)
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


def read_model(trunk: bytes) -> Any:
    """Parse an ONNX model. Errors: ConfigError for another file."""
    import onnx
    from google.protobuf.message import DecodeError

    try:
        return onnx.load_from_string(trunk)
    except DecodeError as error:
        raise ConfigError(
            "the trunk is cut short or is no ONNX model; name the .onnx file of a trunk"
        ) from error


def tap_shapes(model: Any, tiles: Tiles) -> dict[str, tuple[int, int, int]]:
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
