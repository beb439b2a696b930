"""The stages of a bundle for given frames, and their comparison with a research model's, saved as arrays.

A researcher saves what the model computes: `np.savez("stages.npz", frames=frames, layer1=..., map=..., score=...)`.
"""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import U8
from edge.core.errors import ConfigError
from edge.model.bundle import Bundle
from edge.model.pipe import FRAMES
from edge.model.scorer import Scorer
from export.onnx_values import first_conv_input, run_values
from export.parity import Kind, ParityReport, Stage, compare, order_stage, score_frames, show_frames

__all__ = ["compare_bundle"]

MOST_BYTES = 1 << 30
KINDS: tuple[Kind, ...] = ("input", "descriptor", "distance", "map", "score")


def compare_bundle(bundle: Bundle, file: Path) -> ParityReport:
    """Compare the stages in a file with the bundle's, in the order of the computation; with the order of the presses
    where scores are among them. Errors: ConfigError for a file or a stage that cannot be used."""
    given = read_stages(file)
    frames = given.pop("frames", np.empty(0))
    expected = (*bundle.manifest.frame, 3)
    if frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[1:] != expected or not len(frames):
        raise ConfigError(
            f"{file}: 'frames' is {frames.dtype} {frames.shape}, expected uint8 (n, {', '.join(map(str, expected))}) "
            "of the bundle's region"
        )
    if not given:
        raise ConfigError(f"{file} holds frames and no stage; add at least map and score")
    maps = (len(frames), *bundle.manifest.frame)
    if "map" in given and given["map"].shape != maps:
        raise ConfigError(
            f"{file}: 'map' is {given['map'].shape}, expected {maps}, a value for each pixel of 'frames'; resize the "
            "maps (cv2.resize), or leave 'map' out"
        )
    own = bundle_stages(bundle, frames, tuple(given))
    stages = [
        Stage(name, given[name], array, next((kind for kind in KINDS if kind == name), "tap"))
        for name, array in own.items()
    ]
    if "score" in given and given["score"].shape == (len(frames),) and len(frames) > 1:
        stages.append(order_stage(given["score"], own["score"]))
    return compare(
        stages, frames=frames, title=f"{bundle.where} and {file.name}", facts={"bundle": bundle.digest}
    )


def bundle_stages(bundle: Bundle, frames: U8, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """These stages for frames uint8 (n, h, w, 3) of presses, in the order of the computation.

    names: `input`, taps, names of values inside the head, `map`, `score`. Errors: ConfigError for an unknown name, or a
    stage inside the network of a bundle with tiles.
    """
    arrays: dict[str, NDArray[Any]] = {}
    inner = [name for name in names if name not in ("map", "score")]
    scorer = Scorer(bundle, is_skipping=False)
    if inner:
        arrays |= _inside(bundle, show_frames(scorer, frames), inner)
    last = zip(("map", "score"), score_frames(scorer, frames), strict=True)
    return arrays | {name: array for name, array in last if name in names}


def _inside(bundle: Bundle, frames: U8, names: list[str]) -> dict[str, NDArray[Any]]:
    import onnx

    network = bundle.graphs.trunk or bundle.graphs.detector or b""
    head = bundle.graphs.head
    if bundle.grid is not None and bundle.grid.tiles is not None:
        raise ConfigError("a bundle with tiles is compared by map and score; leave the other stages out")
    values = {"input": first_conv_input(network)} if "input" in names else {}
    in_network = _select_known(network, names)
    in_head = [name for name in _select_known(head, names) if name not in in_network] if head else []
    unknown = [name for name in names if name not in (*values, *in_network, *in_head)]
    if unknown:
        raise ConfigError(
            f"bundle {bundle.where} has no stage '{unknown[0]}'; known are input, map, score, its taps "
            f"({', '.join(bundle.grid.taps) if bundle.grid else 'none'}) and the names of values in its graphs"
        )
    asked = [str(value.name) for value in onnx.load_from_string(head).graph.input] if head and in_head else []
    taps = [name for name in asked if bundle.grid and name in bundle.grid.taps]
    values |= {name: name for name in (*in_network, *taps)}
    arrays = run_values(network, list(values.values()), {FRAMES: frames}, "the trunk")
    computed = dict(zip(values, arrays, strict=True))
    if head and in_head:
        sources = {**bundle.bank, **computed}
        feeds = {name: sources[name] for name in asked}
        computed |= dict(zip(in_head, run_values(head, in_head, feeds, "the head"), strict=True))
    return {name: array for name, array in computed.items() if name in names}


def _select_known(graph: bytes | None, names: list[str]) -> list[str]:
    """Select the names of values that nodes of the graph give, in the order of the computation."""
    import onnx

    given = [str(name) for node in onnx.load_from_string(graph or b"").graph.node for name in node.output]
    return [name for name in given if name in names]


def read_stages(file: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file. Pickled objects are refused. Errors: ConfigError."""
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MOST_BYTES:
            raise ConfigError(
                f"{file} unpacks to {size} bytes, at most {MOST_BYTES} are read; save fewer frames"
            )
        with np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(
            f"{file} is not an .npz of plain arrays ({error!s:.150}); save it with np.savez"
        ) from error
