"""What single settings of SPADE and FAPM are worth, on the six development parts: the tables of docs/detectors.md.

Run with `pytest tests/bench/test_operating_points.py -m bench -s`. A line per setting: mean AU-PRO up to 1 % false
positives and image AUROC with the shipped backbone, and with random weights.
"""

from typing import Any

import numpy as np
import pytest
from fixed_parameters import FixedParameters

from calibration.benchmark.evaluation import random_trunk, scored_columns
from calibration.benchmark.presses import development_trial
from calibration.benchmark.trial import Trial
from calibration.fitting.trunks import open_trunk
from edge import registry

pytestmark = pytest.mark.bench

PARTS = 6
WHOLE: dict[str, Any] = {"is_touched_only": False, "packing": "none", "bank_mb": None}
TWO: dict[str, Any] = {"layers": ("layer1", "layer2")}
POINTS: dict[str, tuple[str, dict[str, Any]]] = {
    "spade": ("spade", {}),
    "spade: every direction in float32, nothing left out": ("spade", {"dims": (), **WHOLE}),
    "spade: gallery by means over the whole picture": ("spade", {"regions": 1}),
    "spade: by means in 8x8 regions": ("spade", {"regions": 8}),
    "spade: 4 presses in the gallery": ("spade", {"pixel_neighbours": 4}),
    "spade: 6": ("spade", {"pixel_neighbours": 6}),
    "spade: 8": ("spade", {"pixel_neighbours": 8}),
    "spade: 31 directions": ("spade", {"dims": (31,)}),
    "spade: 55 directions": ("spade", {"dims": (55,)}),
    "spade: window of 0.25 mm": ("spade", {"window_mm": 0.25}),
    "spade: unit length": ("spade", {"is_normalised": True}),
    "spade: layer1 and layer2 of unit length": ("spade", {**TWO, "dims": (47, 47), "is_normalised": True}),
    "fapm": ("fapm", {}),
    "fapm: in float32, prototypes everywhere": ("fapm", {"is_touched_only": False, "packing": "none"}),
    "fapm: 5 %": ("fapm", {"near_fraction": 0.05}),
    "fapm: 20 %": ("fapm", {"near_fraction": 0.2}),
    "fapm: is_calibrated": ("fapm", {"is_calibrated": True}),
    "fapm: calibrated, averaged over 3x3": ("fapm", {"is_calibrated": True, "pooling": 3}),
    "fapm: layer1 and layer2, averaged and calibrated": (
        "fapm",
        {**TWO, "is_calibrated": True, "pooling": 3},
    ),
}


@pytest.fixture(scope="module")
def trials() -> list[Trial]:
    return [development_trial(number) for number in range(PARTS)]


@pytest.fixture(scope="module")
def trunks() -> dict[str, bytes]:
    return {"shipped": open_trunk("tactile_resnet18").graph, "random": random_trunk()}


@pytest.mark.parametrize("name", POINTS)
def test_operating_point(
    name: str, trials: list[Trial], trunks: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Prints the line of one setting."""
    method, changes = POINTS[name]
    chosen = FixedParameters(registry.detector(method), "corrected", changes)
    monkeypatch.setattr(registry, "detector", lambda name: chosen)
    rows = [scored_columns(trunks, trial, [method], 0) for trial in trials]
    found = []
    for trunk in trunks:
        pro, auroc = (
            np.mean([row[trunk, method][measure][0] for row in rows])
            for measure in ("aupro_fpr01", "image_auroc")
        )
        found.append(f"{trunk} {pro:.3f} / {auroc:.3f}")
        assert np.isfinite(pro)
    print(f"\n{name:55s} {'  '.join(found)}", end="")
