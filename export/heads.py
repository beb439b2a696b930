"""`make heads`: the heads that ship with the product, written by the detectors' own authors.

Each detector is fitted with its default settings on invented features of the shipped trunk's sizes, once with every
cell touched and once with some, and whatever different graphs result are stored. `plugins/detectors/shipped.py` finds
them again.
"""

import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge import registry
from edge.core.detector import Bank, Detector, Features, Grid, Nominal
from edge.core.profiles import LR_PIXELS_PER_MM
from edge.runtime import open_session
from plugins.backbones.tactile import tactile_resnet18
from plugins.detectors.shipped import FORMAT, INDEX, identity, written_grid, written_parameters

__all__ = ["FRAMES", "METHODS", "Authored", "authored", "invented", "main", "shipped_grid"]

METHODS = ("padim", "spade", "fapm", "inreach", "subspace", "patchcore")
# The default region at low resolution, and the whole picture: (h, w).
FRAMES = ((224, 224), (240, 320))
HOME = Path(__file__).resolve().parents[1] / "plugins" / "detectors" / "heads"
# Enough that no number of presses limits anything that a graph could fix.
_PRESSES = 4

Authored = tuple[dict[str, Any], bytes]
"""An entry of the index without its file, and the graph."""


def shipped_grid(frame: tuple[int, int], taps: tuple[str, ...]) -> Grid:
    """The grid of the shipped trunk for a frame at low resolution, by running it once."""
    session = open_session(tactile_resnet18.trunk(), 1, "tactile_resnet18")
    maps = session.run(list(taps), {"frames": np.zeros((1, *frame, 3), np.uint8)})
    return Grid(frame, {tap: m.shape[1:] for tap, m in zip(taps, maps, strict=True)}, LR_PIXELS_PER_MM)


def invented(grid: Grid, presses: int, is_touched: bool) -> Nominal:
    """Nominal features of noise. is_touched: a disc in the middle is touched, otherwise nothing is known of it."""
    rng = np.random.default_rng(0)
    features: Features = {
        tap: np.abs(rng.normal(1, 0.3, (presses, *shape))).astype(np.float32)
        for tap, shape in grid.taps.items()
    }
    return Nominal(features, _disc(grid.frame) if is_touched else None)


def _disc(frame: tuple[int, int]) -> NDArray[np.bool_]:
    rows, columns = np.indices(frame)
    disc: NDArray[np.bool_] = np.hypot(rows - frame[0] / 2, columns - frame[1] / 2) < frame[0] / 4
    return disc


def authored(method: str, frame: tuple[int, int]) -> Iterator[Authored]:
    """The different heads of one method's default settings on one frame."""
    detector: Detector = registry.load("detectors", method)
    parameters = detector.parameters()
    grid = shipped_grid(frame, detector.taps(parameters))
    seen: set[bytes] = set()
    for is_touched in (False, True):
        nominal = invented(grid, _PRESSES, is_touched)
        bank = detector.fit(nominal, grid, parameters, np.random.default_rng(0), lambda fraction: None)
        graph = detector.head(grid, bank, parameters)
        if graph in seen:
            continue
        seen.add(graph)
        yield (
            {
                "detector": identity(detector),
                "parameters": written_parameters(parameters),
                "grid": written_grid(grid),
                "arrays": _arrays(graph, bank),
            },
            graph,
        )


def _arrays(graph: bytes, bank: Bank) -> dict[str, Any]:
    """Name to dtype and shape of every bank array; sizes that the graph leaves open are names."""
    import onnx

    declared = {
        value.name: [dim.dim_param or dim.dim_value for dim in value.type.tensor_type.shape.dim]
        for value in onnx.load_from_string(graph).graph.input
    }
    return {
        name: [
            str(array.dtype),
            declared.get(name, [f"{name}_{axis}" for axis in range(array.ndim)]),
        ]
        for name, array in bank.arrays.items()
    }


def main(home: Path = HOME) -> None:
    """Write every head and the index, and remove heads that are no longer any."""
    entries = []
    home.mkdir(exist_ok=True)
    for method in METHODS:
        for frame in FRAMES:
            for number, (entry, graph) in enumerate(authored(method, frame)):
                name = f"{method}_{frame[1]}x{frame[0]}{'_some_touched' if number else ''}.onnx"
                (home / name).write_bytes(graph)
                sha256 = hashlib.sha256(graph).hexdigest()
                entries.append({"file": name, "sha256": sha256, **entry})
                print(f"{name}: {len(graph)} bytes", file=sys.stderr, flush=True)
    (home / INDEX).write_text(json.dumps({"format": FORMAT, "heads": entries}, indent=1) + "\n")
    for path in home.glob("*.onnx"):
        if path.name not in {entry["file"] for entry in entries}:
            path.unlink()


if __name__ == "__main__":
    main()
