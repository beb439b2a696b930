"""What the repairs are worth: each method as published and as corrected, on the analogues PZ1 to PZ5.

Both read the shipped backbone at 224x224, so the layers and channels of the published settings are its own. InReaCh's
thirteen taps are not among them; it reads layer1 to layer3 instead.
"""

import numpy as np
import pytest
from fixed_parameters import FixedParameters

from calibration.benchmark.evaluation import scored_columns
from calibration.benchmark.presses import PARTS, part_trial
from calibration.fitting.trunks import open_trunk
from edge import registry

pytestmark = pytest.mark.bench

POINTS = (
    ("spade", {}),
    ("padim", {}),
    ("fapm", {}),
    ("inreach", {"taps": ("layer1", "layer2", "layer3"), "grid_tap": "layer2"}),
    ("patchcore", {}),
)


def test_published_and_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prints mean AU-PRO up to 1 % and image AUROC of the five parts for either mode."""
    trunks = {"shipped": open_trunk("tactile_resnet18").graph}
    trials = [part_trial(part) for part in PARTS]
    load = registry.load
    for method, changes in POINTS:
        for mode in ("paper", "corrected"):
            detector = load("detectors", method)
            chosen = FixedParameters(detector, "paper", changes) if mode == "paper" else detector
            with monkeypatch.context() as patch:
                patch.setattr(registry, "detector", lambda name, chosen=chosen: chosen)
                rows = [scored_columns(trunks, trial, [method], 0)["shipped", method] for trial in trials]
            pro, auroc = (np.mean([row[name][0] for row in rows]) for name in ("aupro_fpr01", "image_auroc"))
            print(f"\n{method:10s} {mode:10s} AU-PRO {pro:.3f}  image AUROC {auroc:.3f}", end="")
            assert np.isfinite(pro)
