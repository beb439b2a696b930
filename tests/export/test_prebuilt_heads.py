"""The heads that ship are those that the detectors write, and a fit with the usual settings needs no onnx package."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from calibration.fitting.heads import head_of
from calibration.fitting.trunks import DEFAULT_BACKBONE, OTHER_BACKBONES
from edge import registry
from edge.core.detector import Bank, Grid, Nominal
from edge.core.errors import FitError
from edge.core.imaging.tiles import tiling
from export.prebuilt_heads import (
    TRUNKS,
    Situation,
    new_heads,
    prebuilt,
    prebuilt_grid,
    synthetic_features,
)
from plugins.detectors import prebuilt_heads
from plugins.detectors.prebuilt_heads import PREBUILT_FRAMES, load_index, prebuilt_head


def described(graph: bytes) -> tuple[list[str], list[np.ndarray]]:
    """A head's nodes, inputs and outputs as text, and its constants."""
    content = onnx.load_from_string(graph).graph
    words = [str(part) for part in (*content.node, *content.input, *content.output)]
    return words, [numpy_helper.to_array(tensor) for tensor in content.initializer]


def assert_same_head(found: bytes, expected: bytes) -> None:
    """Equal but for the last bits of its constants, which differ between processors."""
    (words, constants), (wanted, numbers) = described(found), described(expected)
    assert words == wanted
    for constant, number in zip(constants, numbers, strict=True):
        np.testing.assert_allclose(constant, number, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("method", prebuilt())
def test_what_ships_is_what_the_detector_writes(method: str) -> None:
    """File for file and entry for entry; after a change to a detector `make heads` writes them again."""
    stored = [head for head in load_index() if head.file.startswith(method)]
    written = [
        found for frame in PREBUILT_FRAMES for trunk in TRUNKS for found in new_heads(method, frame, trunk)
    ]
    assert len(stored) == len(written), "run `make heads`"
    for head, (entry, graph) in zip(stored, written, strict=True):
        assert dict(head.parameters) == entry["parameters"], "run `make heads`"
        assert dict(head.grid) == entry["grid"]
        assert {n: (d, list(s)) for n, (d, s) in head.arrays.items()} == {
            n: tuple(array) for n, array in entry["arrays"].items()
        }
        assert_same_head(head.graph(), graph)


def bank_of(method: str, nominal: Nominal, grid: Grid) -> Bank:
    detector = registry.detector(method)
    bank: Bank = detector.fit(
        nominal, grid, detector.parameters(), np.random.default_rng(3), lambda fraction: None
    )
    return bank


def test_heads_ship_for_every_trunk_that_a_fit_chooses_from() -> None:
    """Else an installation without the onnx package would leave one out."""
    assert (DEFAULT_BACKBONE, *OTHER_BACKBONES) == TRUNKS


@pytest.mark.parametrize("method", prebuilt())
@pytest.mark.parametrize(
    ("presses", "touched", "has_free_gel"),
    [(1, None, False), (2, 0.4, False), (3, 0.1, True), (7, 0.3, True), (4, 9.0, True)],
)
def test_a_head_that_fits_is_the_head_of_that_bank(
    method: str, presses: int, touched: float | None, has_free_gel: bool
) -> None:
    """For any presses a shipped head is found, equal to the head that the detector writes for this bank."""
    detector = registry.detector(method)
    grid = prebuilt_grid(PREBUILT_FRAMES[0], detector.taps(detector.parameters()))
    bank = bank_of(method, synthetic_features(grid, presses, Situation(touched, has_free_gel)), grid)
    found = prebuilt_head(detector, grid, bank, detector.parameters())
    assert found is not None
    assert_same_head(found, detector.head(grid, bank, detector.parameters()))


def test_another_frame_setting_trunk_or_plugin_has_no_prebuilt_head() -> None:
    """Everything that a graph depends on is compared: parameters, grid, the bank's arrays and the class itself."""
    padim = registry.detector("padim")
    p = padim.parameters()
    grid = prebuilt_grid(PREBUILT_FRAMES[0], padim.taps(p))
    bank = bank_of("padim", synthetic_features(grid, 4, Situation(0.25, True)), grid)
    assert prebuilt_head(padim, grid, bank, p) is not None
    assert prebuilt_head(padim, grid, bank, p.model_copy(update={"ridge": 2 * p.ridge})) is None
    assert prebuilt_head(padim, replace(grid, pixels_per_mm=63.0), bank, p) is None
    assert prebuilt_head(padim, replace(grid, tiles=tiling((224, 224), 112, 0)), bank, p) is None
    assert prebuilt_head(padim, replace(grid, taps={**grid.taps, "more": (1, 1, 1)}), bank, p) is None
    assert prebuilt_head(padim, grid, replace(bank, arrays={**bank.arrays, "more": np.ones(1)}), p) is None
    narrower = {**bank.arrays, "mean": bank.arrays["mean"][:, :-1]}
    assert prebuilt_head(padim, grid, replace(bank, arrays=narrower), p) is None
    uneven = {**bank.arrays, "weights": bank.arrays["weights"][:-1]}
    assert prebuilt_head(padim, grid, replace(bank, arrays=uneven), p) is None

    class Other(type(padim)):  # type: ignore[misc]
        pass

    assert prebuilt_head(Other(), grid, bank, p) is None


def test_without_an_index_every_head_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """An installation without the files works as before, where onnx is installed."""
    monkeypatch.setattr(prebuilt_heads, "INDEX", "nothing.json")
    load_index.cache_clear()
    try:
        subspace = registry.detector("subspace")
        p = subspace.parameters()
        grid = prebuilt_grid((64, 64), subspace.taps(p))
        bank = bank_of("subspace", synthetic_features(grid, 2, Situation(None, False)), grid)
        assert load_index() == ()
        assert head_of(subspace, grid, bank, p) == subspace.head(grid, bank, p)
    finally:
        load_index.cache_clear()


WITHOUT_ONNX = """
import sys
from importlib.abc import MetaPathFinder

class Blocked(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("onnx", "onnxscript"):
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)

sys.meta_path.insert(0, Blocked())
import numpy as np
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.nominal_presses import NominalPresses
from edge import registry
from edge.core.errors import FitError
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.scorer import Scorer

rng = np.random.default_rng(0)
common = rng.integers(60, 200, (1, 28, 28, 3))
frames = np.clip(common + rng.normal(0, 4, (4, 28, 28, 3)), 0, 255).astype(np.uint8).repeat(8, 1).repeat(8, 2)
rows, columns = np.indices((224, 224))
touched = np.hypot(rows - 112, columns - 112) < 60
presses = NominalPresses(frames, tuple("abcd"), touched=touched, no_contact=frames[:1])
sensor = profile("mini_lr")

def fit(method, backbone=DEFAULT_BACKBONE, **overrides):
    detector = registry.detector(method)
    trunk = open_trunk(backbone, detector.taps(detector.parameters(**overrides)))
    region = Region.centre(sensor.size)
    config = FitConfig("bolt", "top", sensor, region, detector, trunk, overrides=overrides, alpha=0.5, folds=2)
    return Scorer(fit_files(presses, config, created="today").bundle()).score(frames[0])

for method in registry.names("detectors"):
    print(method, fit(method).anomaly_score >= 0)
print("lite0", fit("padim", backbone="tactile_lite0").anomaly_score >= 0)
try:
    fit("padim", ridge=0.3)
except FitError as error:
    print("refused:", error)
assert "onnx" not in sys.modules
"""


def test_every_method_is_fitted_where_onnx_is_missing() -> None:
    """With its own settings each method is learnt and scores; with others the missing extra is named."""
    done = subprocess.run([sys.executable, "-c", WITHOUT_ONNX], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:-1] == [f"{name} True" for name in (*registry.names("detectors"), "lite0")]
    assert lines[-1].startswith("refused: no head ships for padim with these settings on 224x224")
    assert "pip install 'gelgate[export]'" in lines[-1]


def test_a_missing_package_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra to install, and what needs none."""
    subspace = registry.detector("subspace")
    p = subspace.parameters(sigma=1.0)
    grid = prebuilt_grid((64, 64), subspace.taps(p))
    bank = bank_of("subspace", synthetic_features(grid, 2, Situation(None, False)), grid)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(FitError, match=r"the package onnx is missing; pip install 'gelgate\[export\]'"):
        head_of(subspace, grid, bank, p)
