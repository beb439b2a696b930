"""Rows of a trade-off without a measurement: plausible numbers for every usual point."""

import zlib
from typing import Any

import numpy as np

from calibration.experiments.harness.rows import ROW_FORMAT
from calibration.experiments.tradeoff.accuracy import MEASURES
from calibration.experiments.tradeoff.plan import BACKBONES, usual_points
from calibration.experiments.tradeoff.point import OperatingPoint

METHODS = ("padim", "spade", "fapm", "inreach", "patchcore", "subspace")

MACHINE = {
    "processor": "Test processor",
    "flags": ["avx2", "fma"],
    "cores": 2,
    "threads": 2,
    "governor": "performance",
    "memory_bytes": 1 << 33,
    "system": "Linux x86_64",
    "python": "3.11.7",
    "libraries": {"numpy": "2.0"},
    "load_at_start": 0.1,
}


def row(
    key: str = "padim.tactile_resnet18.lr.20",
    accuracy: float | None = 0.7,
    ms: float = 20.0,
    bank_bytes: int = 1_000_000,
    presses: int = 20,
    **changes: Any,
) -> dict[str, Any]:
    """One complete row; ms: to the verdict."""
    interval = {"value": None, "low": None, "high": None}
    if accuracy is not None:
        interval = {"value": accuracy, "low": max(0.0, accuracy - 0.04), "high": min(1.0, accuracy + 0.03)}
    return {
        "format": ROW_FORMAT,
        "key": key,
        "method": key.split(".")[0],
        "mode": "corrected",
        "backbone": "tactile_resnet18",
        "view": "lr",
        "settings": {},
        "presses": presses,
        "gel_share": presses / 1000,
        "accuracy": {name: dict(interval) for name in MEASURES},
        "bank_bytes": bank_bytes,
        "bank_bytes_unpacked": 3 * bank_bytes,
        "trunk_bytes": 300_000,
        "trunk_sha256": "ab" * 32,
        "content_sha256": "cd" * 32,
        "fit_s": {"features": 0.2, "bank": 0.4},
        "work": {"float32": 1.2e9, "int8": 0.0, "bytes": 5e6},
        "part": "PZ3",
        "position": "pos1",
        "seed": 0,
        "scored": {"good": 40, "defective": 12},
        "stages": {
            name: {"median": ms * share, "p95": ms * share * 1.2}
            for name, share in (("decode", 0.4), ("trunk", 0.4), ("head", 0.2))
        },
        "floor": {"ms": ms / 5, "binds": "arithmetic"},
        "peak_memory_bytes": 100_000_000,
        "dataset_sha256": "ef" * 32,
        "machine": MACHINE,
        "peak": {"float32_per_s": 2e11, "int8_per_s": 6e11, "bytes_per_s": 1e10},
        "rounds": 25,
    } | changes


def rows_of_a_run() -> list[dict[str, Any]]:
    """One row for every usual point, the same ones on every call."""
    points = usual_points(BACKBONES, METHODS)
    return [_row_of(point) for point in points]


def _row_of(point: OperatingPoint) -> dict[str, Any]:
    chance = np.random.default_rng(zlib.crc32(point.key.encode()))
    is_int8 = point.backbone.endswith("int8")
    trunk = (18 if point.view == "lr" else 150 + 40 * len(point.view)) * (0.93 if is_int8 else 1)
    ms = trunk + chance.uniform(0.5, 4) * (8 if point.mode == "paper" else 1)
    accuracy = 0.62 + 0.05 * np.log2(point.presses / 5) + chance.normal(0, 0.02) + 0.05 * (point.view != "lr")
    made = row(point.key, float(accuracy), float(ms), int(chance.uniform(1e5, 9e6)), point.presses)
    return made | {
        "mode": point.mode,
        "backbone": point.backbone,
        "view": point.view,
        "settings": dict(point.settings),
        "work": {"float32": 0.0 if is_int8 else 1.2e9, "int8": 1.2e9 if is_int8 else 0.0, "bytes": 5e6},
    }
