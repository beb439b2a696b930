"""One ONNX graph from frames to score map, with the bank inside: for other runtimes and tools.

Its inputs and outputs are those of a bundle's pair of graphs, so the gateway also accepts it as `detector.onnx`.
"""

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from calibration.fitting.bundle_measurements import score_again
from edge.core.detector import Bank
from edge.core.errors import BundleCorrupt, BundleMismatch
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.imaging.tiles import TILES_KEY, Tiles
from edge.model.bundle import Bundle, Graphs
from edge.model.bundle_writer import bundle_files, facts_of, write_bundle, write_file
from edge.model.manifest import REGION_WEIGHTS, Manifest
from edge.model.pipe import SCORE, SCORE_MAP
from edge.model.scorer import Scorer
from export.onnx_values import join, rename
from plugins.backbones.tiled import plain_trunk, read_model, tap_shapes
from plugins.onnx_builder import Graph

__all__ = ["merge_bundle", "merged_graph", "mosaic_trunk", "smooth_first"]

MERGED_RELATIVE = 1e-4
"""How far the merged graph may differ from the pair, relative to the largest map value: with a constant bank the
runtime folds and fuses differently. Measured on every detector: 1e-6."""


def merge_bundle(bundle: Bundle, output: Path, *, as_bundle: bool = False) -> float:
    """Write the merged graph of a bundle and return the largest relative difference from the bundle's own maps.

    as_bundle: write a bundle with `detector.onnx` instead of the bare file. Nothing is written when the scores
    differ. Errors: BundleMismatch for a bundle that is already a single graph, BundleCorrupt when the scores differ,
    OSError of the disk.
    """
    graph = _merge(bundle)
    difference = _largest_difference(bundle, graph)
    if not difference <= MERGED_RELATIVE:
        raise BundleCorrupt(
            f"the merged graph of {bundle.where} differs from the bundle by {difference:.2g} of the largest score, "
            f"{MERGED_RELATIVE:g} is allowed; nothing is written, report this with the bundle"
        )
    if as_bundle:
        write_bundle(output, single_graph_bundle(bundle, graph)[1], overwrite=True)
    else:
        write_file(output, _read_raw(bundle, graph))
    return difference


def merged_graph(bundle: Bundle) -> bytes:
    """The serialised graph: uint8 `frames` (n, h, w, 3), as the camera shows them, to `score_map` and `score`. Imports
    onnx at use.

    Errors: BundleMismatch for a bundle that no single graph can replace.
    """
    return _read_raw(bundle, _merge(bundle))


def _read_raw(bundle: Bundle, graph: bytes) -> bytes:
    return smooth_first(graph, bundle.manifest.frame) if bundle.manifest.is_smoothed else graph


def _merge(bundle: Bundle) -> bytes:
    """Make one graph of a bundle's two. Frames are prepared. Errors: as `merged_graph`."""
    import onnx
    from onnx import numpy_helper

    if bundle.registration is not None:
        raise BundleMismatch(
            f"bundle {bundle.where} brings each press to one pose before its graphs, which a graph alone does not do; "
            "fit it again with --set register=never"
        )
    if bundle.manifest.dots is not None:
        raise BundleMismatch(
            f"bundle {bundle.where} fills the dots of a marker gel before its graphs, which a graph alone does not do; "
            "fit it on a gel without dots"
        )
    if bundle.graphs.trunk is None or bundle.graphs.head is None:
        before = ", before which frames are smoothed (docs/bundle.md)" if bundle.manifest.is_smoothed else ""
        raise BundleMismatch(
            f"bundle {bundle.where} is already a single graph; copy its detector.onnx{before}"
        )
    head = onnx.load_from_string(bundle.graphs.head)
    trunk_graph = bundle.graphs.trunk
    if bundle.grid is not None and bundle.grid.tiles is not None:
        trunk_graph = mosaic_trunk(trunk_graph, bundle.grid.tiles)
    trunk = onnx.load_from_string(trunk_graph)
    wanted = {i.name for i in head.graph.input}
    taps = [o.name for o in trunk.graph.output if o.name in wanted]
    for name in sorted(wanted - set(taps)):
        head.graph.initializer.append(numpy_helper.from_array(np.ascontiguousarray(bundle.bank[name]), name))
    kept = [i for i in head.graph.input if i.name in taps]
    del head.graph.input[:]
    head.graph.input.extend(kept)
    outputs = [output for output in head.graph.output if output.name in (SCORE_MAP, SCORE)]
    head.graph.ClearField("output")
    head.graph.output.extend(outputs)
    # Prefixes keep the inner names of the two graphs distinct; the outer names are restored below.
    merged = join(trunk, head, {tap: tap for tap in taps}, ("trunk/", "head/"))
    rename(merged, {"trunk/frames": "frames", "head/score_map": "score_map", "head/score": "score"})
    merged.graph.name = f"{bundle.manifest.method}_{bundle.manifest.part}_{bundle.manifest.position}"
    del merged.metadata_props[:]
    for key, value in _metadata(bundle).items():
        merged.metadata_props.add(key=key, value=value)
    onnx.checker.check_model(merged)
    return bytes(merged.SerializeToString())


def mosaic_trunk(trunk: bytes, tiles: Tiles) -> bytes:
    """The trunk over all tiles in one graph. Input `frames` uint8 (n, *tiles.frame, 3), outputs the taps as mosaics.

    trunk: a plain one, or one of `tile_trunk`. Errors: ConfigError as there.
    """
    import onnx

    model = read_model(trunk)
    facts = {entry.key: entry.value for entry in model.metadata_props if entry.key != TILES_KEY}
    onnx.helper.set_model_props(model, facts)
    model = plain_trunk(model.SerializeToString(), tiles)
    shapes, front, end = tap_shapes(model, tiles), Graph("cut"), Graph("mosaic")
    frames = front.input("frames", ("n", *tiles.frame, 3), "uint8")
    size, down, across = tiles.size, len(tiles.rows), len(tiles.columns)
    ends = [(front.ints(y, x), front.ints(y + size, x + size)) for y, x in tiles.places]
    cut = [front.op("Slice", frames, *corners, front.ints(1, 2)) for corners in ends]
    front.output("tiles", front.concat(cut, 0), ("m", size, size, 3), "uint8")
    for tap, (c, h, w) in shapes.items():
        x = end.reshape(end.input(tap, ("m", c, h, w)), down, across, -1, c, h, w)
        mosaic = (c, down * h, across * w)
        end.output(
            f"{tap}_mosaic", end.reshape(end.transpose(x, 2, 3, 0, 4, 1, 5), -1, *mosaic), ("n", *mosaic)
        )
    first, last = (onnx.load_from_string(graph.serialise()) for graph in (front, end))
    tiled = join(first, model, {"tiles": "frames"}, ("cut/", "tile/"))
    tiled = join(tiled, last, {f"tile/{tap}": tap for tap in shapes}, ("", "mosaic/"))
    rename(tiled, {"cut/frames": "frames", **{f"mosaic/{tap}_mosaic": tap for tap in shapes}})
    onnx.helper.set_model_props(tiled, facts)
    onnx.checker.check_model(tiled, full_check=True)
    return bytes(tiled.SerializeToString())


def smooth_first(graph: bytes, frame: tuple[int, int]) -> bytes:
    """The graph behind `smooth`, bit for bit: it then reads frames as the camera shows them. frame: (h, w)."""
    import onnx

    first, size = Graph("smoothing"), ("n", *frame, 3)
    x = first.op("Cast", first.input("frames", size, "uint8"), to=onnx.TensorProto.FLOAT)
    x = first.op("Pad", first.transpose(x, 0, 3, 1, 2), first.ints(0, 0, 1, 1, 0, 0, 1, 1), mode="edge")
    weights = np.outer((1, 2, 1), (1, 2, 1)).astype(np.float32) / 16
    x = first.op("Conv", x, first.constant(np.repeat(weights[None, None], 3, axis=0)), group=3)
    x = first.op("Floor", first.op("Add", x, first.scalar(0.5)))
    x = first.op("Cast", first.transpose(x, 0, 2, 3, 1), to=onnx.TensorProto.UINT8)
    first.output("smoothed", x, size, "uint8")
    model = onnx.load_from_string(graph)
    smoothed = join(onnx.load_from_string(first.serialise()), model, {"smoothed": "frames"}, ("smooth/", ""))
    rename(smoothed, {"smooth/frames": "frames"})
    onnx.helper.set_model_props(smoothed, {entry.key: entry.value for entry in model.metadata_props})
    onnx.checker.check_model(smoothed)
    return bytes(smoothed.SerializeToString())


def _metadata(bundle: Bundle) -> dict[str, str]:
    """Tell another runtime what it needs to know, as metadata of the file."""
    manifest = bundle.manifest
    return {
        "gelgate_bundle": bundle.digest,
        "part": manifest.part,
        "position": manifest.position,
        "method": manifest.method,
        "threshold": repr(manifest.threshold.value),
        "sensor_profile": TypeAdapter(SensorProfile).dump_json(manifest.profile).decode(),
        "region": str(bundle.region),
    }


def single_graph_bundle(bundle: Bundle, graph: bytes) -> tuple[Manifest, dict[str, bytes]]:
    """The manifest and files of a bundle with one graph in place of trunk, head and bank; the rest is kept."""
    golden, pictures, gateway = bundle.golden, bundle.nominal_pictures, dict[str, Any]()
    if bundle.free_gel is not None:
        # The single graph runs every tile, so it is compared with the pair running every tile.
        scorer = Scorer(bundle, is_skipping=False)
        golden = tuple(score_again(frame, scorer) for frame in golden)
    if bundle.manifest.regions is not None:  # by which the gateway knows what of a press is judged
        bank = Bank({REGION_WEIGHTS: bundle.bank[REGION_WEIGHTS]})
        gateway = {"bank": bank, "free_view": bundle.free_view}
    graphs = Graphs(detector=graph)
    return bundle_files(
        facts_of(bundle.manifest), graphs, golden=golden, nominal_pictures=pictures, **gateway
    )


def _largest_difference(bundle: Bundle, graph: bytes) -> float:
    """The largest difference of any map pixel or score on the golden frames, relative to the largest value."""
    single = Bundle.in_memory(*single_graph_bundle(bundle, graph), where=f"{bundle.where} merged")
    pair, merged, worst = Scorer(bundle, is_skipping=False), Scorer(single), 0.0
    grey = np.full((*bundle.manifest.frame, 3), 128, np.uint8)
    for rgb in [grey, *(golden.rgb for golden in bundle.golden)]:
        first, second = pair.score_in_pose(rgb), merged.score_in_pose(rgb)
        scale = max(
            float(np.abs(first.score_map).max()), abs(first.anomaly_score), float(np.finfo(np.float32).tiny)
        )
        apart = max(
            float(np.abs(first.score_map - second.score_map).max()),
            abs(first.anomaly_score - second.anomaly_score),
        )
        worst = max(worst, apart / scale)
    return worst
