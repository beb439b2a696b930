"""From a trained checkpoint to the shipped files: the trunk stored as float16, the trunk in int8, and their facts.

The ranges of the int8 trunk are those of simulated frames that neither training nor evaluation draws. The difference of
its features from the float trunk's is measured on other such frames and stored.
"""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.folders import write_atomically
from calibration.quantise import quantise_graph
from calibration.training.train_config import STAGES
from edge.core.arrays import U8
from edge.core.errors import GelgateError
from edge.model.session import open_session
from plugins.backbones.resnet import build_trunk
from plugins.backbones.topology import State

if TYPE_CHECKING:
    from calibration.training.checkpoint import Tensors

__all__ = ["MOST_BYTES", "NAME", "package"]

NAME = "tactile_resnet18"
# The largest size of one shipped variant.
MOST_BYTES = 6 * 1024 * 1024
_CALIBRATION_SIDE = 224
_CALIBRATION_BATCHES = 8
_CALIBRATION_PAIRS = 8
_FORMAT = 1


def package(run: Path, out: Path) -> dict[str, Any]:
    """Write `<name>.onnx` (float16 weights), `<name>_int8.onnx` and `<name>.json` into `out`; returns the facts.

    Errors: ConfigError for a run without a complete checkpoint, GelgateError for a variant that is too large or a disk
    that refuses.
    """
    from calibration.training import checkpoint

    saved = checkpoint.load(run)
    state = trunk_state(saved.weights)
    plain = build_trunk(state, "resnet18", STAGES)
    variants = {
        NAME: build_trunk(state, "resnet18", STAGES, weights="float16"),
        f"{NAME}_int8": quantise_graph(
            plain, np.concatenate([*calibration_frames("calibrate", _CALIBRATION_BATCHES)])
        ),
    }
    for name, graph in variants.items():
        if len(graph) > MOST_BYTES:
            raise GelgateError(f"{name}.onnx has {len(graph)} bytes, expected at most {MOST_BYTES}")
    log = run / "log.jsonl"
    lines = log.read_text().splitlines() if log.is_file() else []
    facts = {
        "format": _FORMAT,
        "name": NAME,
        "topology": "resnet18",
        "taps": list(STAGES),
        "trained_steps": sum(run["steps"] for run in saved.history),
        "recipe": json.loads(saved.recipe.to_json()),
        "before": list(saved.before),
        "pairs_seen": sum(run["steps"] * run["recipe"]["pairs"] for run in saved.history),
        "last_entry": json.loads(lines[-1]) if lines else {},
        "variants": {name: _facts(graph, plain) for name, graph in variants.items()},
    }
    for name, graph in variants.items():
        write_atomically(out / f"{name}.onnx", graph)
    write_atomically(out / f"{NAME}.json", (json.dumps(facts, indent=2) + "\n").encode())
    return facts


def trunk_state(weights: "Tensors") -> State:
    """The trunk's arrays under torchvision's names, out of a checkpoint's weights."""
    return {
        name.removeprefix("trunk."): value.float().numpy()
        for name, value in weights.items()
        if name.startswith("trunk.") and not name.endswith("num_batches_tracked")
    }


def _facts(graph: bytes, plain: bytes) -> dict[str, Any]:
    return {
        "sha256": hashlib.sha256(graph).hexdigest(),
        "bytes": len(graph),
        "relative_error": {tap: round(error, 5) for tap, error in feature_errors(graph, plain).items()},
    }


def calibration_frames(purpose: str, batches: int) -> Iterator[U8]:
    """Batches of frames uint8 (n, 224, 224, 3) from separate streams, every fourth at high resolution."""
    from calibration.training.training_pairs import draw_pairs

    for number in range(batches):
        fine = 1.0 if number % 4 == 3 else 0.0
        drawn = draw_pairs(
            0, purpose, number, pairs=_CALIBRATION_PAIRS, side=_CALIBRATION_SIDE, high_resolution=fine
        )
        yield drawn.frames.permute(0, 2, 3, 1).contiguous().byte().numpy()


def feature_errors(graph: bytes, plain: bytes) -> dict[str, float]:
    """Per tap, the norm of the difference over the norm of the float trunk's features, on separate frames."""
    sessions = [open_session(g, 0, "trunk") for g in (graph, plain)]
    squares = {tap: np.zeros(2) for tap in STAGES}
    for frames in calibration_frames("compare", 2):
        features, expected = (s.run(list(STAGES), {"frames": frames}) for s in sessions)
        for tap, a, b in zip(STAGES, features, expected, strict=True):
            squares[tap] += [
                float(((a - b).astype(np.float64) ** 2).sum()),
                float((b.astype(np.float64) ** 2).sum()),
            ]
    return {tap: float(np.sqrt(s[0] / max(s[1], 1e-30))) for tap, s in squares.items()}
