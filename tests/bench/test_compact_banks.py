"""What compact storage costs: AU-PRO up to 1 % false positives with the bank as stored, as computed, and whole.

Run with `pytest tests/bench/test_compact_banks.py -m bench -s`; GELGATE_BENCH_BACKBONE names another backbone than
the default, installed or a trunk's file. Budget: within 0.005 of the whole bank, 16 MB at 224.
`whole` is the same method without what makes its bank small: full rank, all channels, all rows, float32. Two simulated
parts are pressed by hand-like jitter; the maps are the oracle's, so that nothing but the bank differs.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from presses import stored as stored_bank

from calibration.backbones import DEFAULT_BACKBONE, open_trunk
from calibration.dataset import Press, open_dataset
from calibration.features import extract, trunk_grid
from calibration.metrics import aupro
from calibration.scene import SCENES, load_scene
from calibration.simulate import simulate_dataset
from edge.core.detector import Bank, Features, Grid, Nominal
from edge.core.region import Region
from edge.packing import pack
from edge.runtime import open_session
from plugins.detectors.fapm import fapm
from plugins.detectors.inreach import inreach
from plugins.detectors.padim import padim
from plugins.detectors.patchcore import patchcore
from plugins.detectors.spade import spade
from plugins.detectors.subspace import subspace

pytestmark = pytest.mark.bench

BACKBONE = os.environ.get("GELGATE_BENCH_BACKBONE", DEFAULT_BACKBONE)
TAPS = ("layer1", "layer2", "layer3")
REGION = Region(48, 8, 224, 224)
SOUND, DEFECTIVE, HELD_OUT = 30, 12, 10
SPECIMENS = 4

WHOLE: dict[Any, dict[str, object]] = {
    padim: {"rank": None, "packing": "none"},
    spade: {"dims": (), "packing": "none", "bank_mb": None},
    fapm: {"packing": "none"},
    inreach: {"dims": None, "most_rows": None, "packing": "none"},
    patchcore: {"dims": None, "packing": "none"},
    subspace: {"most_rank": 4096},
}


@pytest.fixture(scope="module")
def pressed(
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[str], tuple[Features, Grid, list[np.ndarray]]]:
    """Features of the nominal, the held-out and the defective presses, in this order; masks of all but the nominal."""
    session = open_session(open_trunk(BACKBONE, TAPS).graph, 1, BACKBONE)
    grid = trunk_grid(session, TAPS, (224, 224), 15.77)
    known: dict[str, tuple[Features, Grid, list[np.ndarray]]] = {}

    def of(part: str) -> tuple[Features, Grid, list[np.ndarray]]:
        if part not in known:
            presses = simulated(part, tmp_path_factory.mktemp(part))
            frames = np.stack([REGION.crop(press.rgb()) for press in presses])
            masks = [REGION.crop(press.mask()) for press in presses[SOUND:]]
            known[part] = extract(session, frames, grid, lambda done: None), grid, masks
        return known[part]

    return of


def simulated(part: str, folder: Path) -> list[Press]:
    """SOUND presses to fit, HELD_OUT sound ones of a specimen that is not among them, DEFECTIVE damaged ones."""
    scene = load_scene(SCENES / "paper" / f"{part}.toml")
    small = {
        "positions": ("pos1",),
        "camera": scene.camera.model_copy(update={"modes": ("lr",)}),
        "nominal": scene.nominal.model_copy(update={"specimens": SPECIMENS, "presses": 10}),  # type: ignore[union-attr]
        "defects": scene.defects.model_copy(update={"images": DEFECTIVE}),
    }
    dataset = open_dataset(simulate_dataset(scene.model_copy(update=small), folder))
    assert len(dataset.good) == SOUND + HELD_OUT
    assert len(dataset.defective) == DEFECTIVE
    return [*dataset.good, *dataset.defective]


@pytest.mark.parametrize("part", ["pz1", "pz3"])
@pytest.mark.parametrize("detector", WHOLE, ids=lambda detector: detector.name)
def test_accuracy_of_stored_banks(detector: Any, part: str, pressed: Callable[[str], Any]) -> None:
    """Prints AU-PRO of the three banks, their differences, and bytes; the stored one is never beyond 16 MB."""
    features, grid, masks = pressed(part)
    train, query = (
        {tap: maps[rows] for tap, maps in features.items()} for rows in (slice(SOUND), slice(SOUND, None))
    )

    def fitted(**overrides: object) -> tuple[Any, Bank]:
        parameters = detector.parameters(**overrides)
        bank = detector.fit(Nominal(train), grid, parameters, np.random.default_rng(0), lambda done: None)
        return parameters, bank

    def accuracy(parameters: Any, bank: Bank) -> float:
        maps = [
            detector.reference_score({tap: m[k : k + 1] for tap, m in query.items()}, grid, bank, parameters)
            for k in range(len(masks))
        ]
        area = aupro([m.score_map[0] for m in maps], masks)
        assert area is not None
        return area

    parameters, bank = fitted()
    whole_parameters, whole_bank = fitted(**WHOLE[detector])
    stored, computed = accuracy(parameters, stored_bank(bank)), accuracy(parameters, bank)
    whole = accuracy(whole_parameters, whole_bank)
    size, whole_size = stored_bytes(bank), stored_bytes(whole_bank)
    print(
        f"\n{detector.name:10s}{part}  stored {stored:.4f}  float32 {computed:.4f} ({stored - computed:+.4f})  "
        f"whole {whole:.4f} ({stored - whole:+.4f})  {size / 1e6:6.2f} MB, whole {whole_size / 1e6:7.2f} MB"
    )
    assert size <= 16e6


def stored_bytes(bank: Bank) -> int:
    total = 0
    for name, array in bank.arrays.items():
        packed = pack(array, bank.packing.get(name, "none"))
        total += packed.data.nbytes + (0 if packed.scale is None else packed.scale.nbytes)
    return total
