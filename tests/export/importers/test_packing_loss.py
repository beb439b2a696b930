"""A bank that is stored too coarsely for its own model is refused with the loss in numbers."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import tiny
from toy_trunk import features_of, toy_trunk

from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk
from edge.core.detector import Packing
from edge.core.errors import BundleCorrupt
from export.finish import WrapConfig
from export.importers.contract import Settings
from export.importers.memory_scripts import spade_features
from export.importers.packing_loss import Losses, import_files
from plugins.reading.files import read_here
from plugins.reading.foreign import Foreign

CONFIG = WrapConfig("bolt", "crest", tiny.PROFILE, tiny.REGION, "spade")


def losses(folder: Path, packing: Packing) -> Losses:
    """SPADE on presses that differ by a few grey levels: its distances are far smaller than its features."""
    rng = np.random.default_rng(0)
    base = rng.integers(60, 190, (32, 32, 3))
    frames = np.stack([base + rng.integers(-2, 3, base.shape) for _ in range(12)]).astype(np.uint8)
    trunk = toy_trunk({"layer1": (6, 4), "avgpool": (12, 1)})
    path = folder / "spade.pkl"
    path.write_bytes(pickle.dumps(features_of(trunk, frames[:6])))
    settings = Settings(
        (32, 32), 15.77, Trunk("toy", trunk), packing=packing, values={"is_normalised": False}
    )
    model = spade_features.imported(Foreign(path, *read_here(path)), settings)
    presses = NominalPresses(frames[6:], tuple(map(str, range(6))))
    return import_files(model, presses, CONFIG, path, created="")[1]


def test_a_loss_above_a_twentieth_is_refused(tmp_path: Path) -> None:
    """Features in steps of a 127th of the largest give other scores; the stage is named."""
    with pytest.raises(BundleCorrupt, match=r"spade\.pkl .* stage 'map': .* store it with --packing"):
        losses(tmp_path, "int8")


def test_a_small_loss_is_stated(tmp_path: Path) -> None:
    """The same bank in half precision: maps change a little, and SPADE's scores do not read the packed features."""
    found = losses(tmp_path, "float16")

    assert 0 < found.packing_map < 0.05
    assert found.packing == 0
    assert found.bytes_stored < found.bytes_unpacked
    assert "packing changes scores by at most" in found.words()
