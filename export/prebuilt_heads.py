"""`make heads`: the heads that ship with the product, written by the detectors themselves.

Each detector is fitted with its default settings on synthetic features of the shipped trunks' sizes: with all or some
cells touched, with and without frames of the untouched gel. Every different graph is stored, and
`plugins/detectors/prebuilt_heads` finds it.
"""

import hashlib
import itertools
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge import registry
from edge.core.detector import Bank, Features, Grid, HasPrebuiltHeads, Nominal
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.model.session import open_session
from plugins.detectors.prebuilt_heads import FORMAT, INDEX, identity, written_grid, written_parameters

__all__ = [
    "TRUNKS",
    "NewHead",
    "Situation",
    "main",
    "new_heads",
    "prebuilt",
    "prebuilt_grid",
    "synthetic_features",
]

HOME = Path(__file__).resolve().parents[1] / "plugins" / "detectors" / "prebuilt_heads"
TRUNKS = ("tactile_resnet18", "tactile_lite0")
"""The trunks whose heads ship: those that a fit chooses from."""

# Enough presses that their number limits no size in a graph.
_PRESSES = 4

NewHead = tuple[dict[str, Any], bytes]
"""An entry of the index without its file, and the graph."""


def prebuilt() -> dict[str, tuple[tuple[int, int], ...]]:
    """The installed detectors whose heads ship, each with its frame sizes (h, w)."""
    detectors = {name: registry.detector(name) for name in registry.names("detectors")}
    return {name: one.prebuilt_frames for name, one in detectors.items() if isinstance(one, HasPrebuiltHeads)}


def prebuilt_grid(frame: tuple[int, int], taps: tuple[str, ...], trunk: str = TRUNKS[0]) -> Grid:
    """The grid of a shipped trunk for a frame at low resolution, by running it once."""
    session = open_session(registry.backbone(trunk).trunk(), 1, trunk)
    maps = session.run(list(taps), {"frames": np.zeros((1, *frame, 3), np.uint8)})
    return Grid(frame, {tap: m.shape[1:] for tap, m in zip(taps, maps, strict=True)}, LR_PIXELS_PER_MM)


@dataclass(frozen=True)
class Situation:
    """What is known of the gel. touched: radius of the disc in the middle that presses touch, as a part of the frame's
    height; None if unknown. has_free_gel: whether there are frames of the untouched gel."""

    touched: float | None
    has_free_gel: bool


SITUATIONS = (Situation(None, False), Situation(0.25, False), Situation(0.25, True), Situation(None, True))


def synthetic_features(grid: Grid, presses: int, situation: Situation) -> Nominal:
    """Nominal features of noise."""
    rng = np.random.default_rng(0)

    def noise(n: int) -> Features:
        return {
            tap: np.abs(rng.normal(1, 0.3, (n, *shape))).astype(np.float32)
            for tap, shape in grid.taps.items()
        }

    touched = None if situation.touched is None else _disc(grid.frame, situation.touched)
    return Nominal(noise(presses), touched, noise(2) if situation.has_free_gel else None)


def _disc(frame: tuple[int, int], part: float) -> NDArray[np.bool_]:
    rows, columns = np.indices(frame)
    disc: NDArray[np.bool_] = np.hypot(rows - frame[0] / 2, columns - frame[1] / 2) < part * frame[0]
    return disc


def new_heads(method: str, frame: tuple[int, int], trunk: str) -> Iterator[NewHead]:
    """The different heads of one method's default settings on one frame and trunk."""
    detector = registry.detector(method)
    parameters = detector.parameters()
    grid = prebuilt_grid(frame, detector.taps(parameters), trunk)
    seen: list[NewHead] = []
    for situation in SITUATIONS:
        nominal = synthetic_features(grid, _PRESSES, situation)
        bank = detector.fit(nominal, grid, parameters, np.random.default_rng(0), lambda fraction: None)
        graph = detector.head(grid, bank, parameters)
        entry = {
            "detector": identity(detector),
            "parameters": written_parameters(parameters),
            "grid": written_grid(grid),
            "arrays": _arrays(graph, bank),
        }
        if (entry, graph) not in seen:
            seen.append((entry, graph))
            yield entry, graph


def _arrays(graph: bytes, bank: Bank) -> dict[str, Any]:
    """Name to dtype and shape of every bank array; sizes that are free in the graph are names."""
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
    """Write every different head once, and the index, and remove heads that are not in it."""
    entries, files = [], dict[str, str]()
    home.mkdir(exist_ok=True)
    for method, frames in prebuilt().items():
        for frame, trunk in itertools.product(frames, TRUNKS):
            for entry, graph in new_heads(method, frame, trunk):
                sha256 = hashlib.sha256(graph).hexdigest()
                if sha256 not in files:
                    stem = f"{method}_{frame[1]}x{frame[0]}_"
                    files[sha256] = f"{stem}{1 + sum(one.startswith(stem) for one in files.values())}.onnx"
                    (home / files[sha256]).write_bytes(graph)
                    print(f"{files[sha256]}: {len(graph)} bytes", file=sys.stderr, flush=True)
                entries.append({"file": files[sha256], "sha256": sha256, **entry})
    (home / INDEX).write_text(json.dumps({"format": FORMAT, "heads": entries}, indent=1) + "\n")
    for path in home.glob("*.onnx"):
        if path.name not in {entry["file"] for entry in entries}:
            path.unlink()


if __name__ == "__main__":
    main()
